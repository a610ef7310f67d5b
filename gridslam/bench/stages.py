"""Where a step's time goes: by stage, as its `StepInfo` tells, and in kernels, whose launches are watched."""

from __future__ import annotations

import importlib
import pkgutil
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from types import MappingProxyType
from typing import Any, Protocol

from gridslam.inference.workspace.workspace import OTHER, Workspace
from gridslam.kernels.primitives.watching import watched

LAUNCHES = "launches"
KERNEL = "kernel "
"""Before the name of a kernel."""

Function = Callable[..., Any]


class Kernel(Protocol):
    """A kernel as `kernels.primitives.launching.quick` makes it.

    Attributes
    ----------
    names : list of str
        Of all numbers and arrays, those in blocks last.
    """

    names: list[str]

    def __call__(self, *arguments: Any) -> None:
        """Launch it."""

    def named(self, **flat: Any) -> None:
        """Launch it with numbers and arrays by name."""


@cache
def kernels() -> Mapping[str, Kernel]:
    """All Taichi kernels by name, looked for once; Taichi has to run."""
    import gridslam.kernels as package

    found: dict[str, Kernel] = {}
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        space = vars(importlib.import_module(module.name))
        found |= {name: f for name, f in space.items() if getattr(f, "_is_wrapped_kernel", False)}
    return MappingProxyType(found)


class Stopwatch:
    """Seconds by stage and kernel, and how often each kernel was launched.

    Parameters
    ----------
    work : Workspace
        Of the filter that is watched.

    Attributes
    ----------
    seconds : dict
        By stage, without the kernels launched in it, and by kernel under ``"kernel NAME"``, launch included.
    launches : Counter
        By kernel.
    """

    def __init__(self, work: Workspace) -> None:
        self.seconds: dict[str, float] = {OTHER: 0.0}
        self.launches: Counter[str] = Counter()
        self._work = work

    @contextmanager
    def watching(self) -> Iterator[Stopwatch]:
        """Time the kernels of whatever runs meanwhile."""
        with watched(self._time):
            yield self

    def count(self, seconds: Mapping[str, float]) -> None:
        """Take in a step's time by stage, kernels included, as its `StepInfo` tells."""
        for stage, took in seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + took

    def of_step(self, whole: float, steps: int, launch: Mapping[str, float]) -> dict[str, float]:
        """Seconds per step by stage; their sum is the whole.

        Parameters
        ----------
        whole : float
            Seconds that all `steps` took.
        launch : mapping
            Seconds that a launch of each kernel takes when there is nothing to do: they count for `LAUNCHES`.
        """
        stages = {name: seconds / steps for name, seconds in self.seconds.items()}
        stages[LAUNCHES] = 0.0
        for name, count in self.launches.items():
            cost = min(count * launch.get(name, 0.0) / steps, stages[KERNEL + name])
            stages[KERNEL + name] -= cost
            stages[LAUNCHES] += cost
        stages[OTHER] += max(whole / steps - sum(stages.values()), 0.0)
        return stages

    def _time(self, name: str, launch: Function, arguments: tuple[Any, ...]) -> Any:
        import taichi as ti

        from gridslam.kernels.primitives.device import ON_CPU

        began, stage = time.perf_counter(), self._work.stage
        try:
            result = launch(*arguments)
            if not ON_CPU:
                ti.sync()
            return result
        finally:
            took = time.perf_counter() - began
            self.launches[name] += 1
            self.count({KERNEL + name: took, stage: -took})
