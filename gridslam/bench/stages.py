"""Where a step's time goes: by stage, as its `StepInfo` tells, and in which kernels.

While a filter is watched, its kernels are replaced by timed ones wherever a module holds them; afterwards
everything is as it was.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any, Protocol

from gridslam.inference.workspace.workspace import OTHER, Workspace

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


def kernels() -> dict[str, Kernel]:
    """All Taichi kernels by name; Taichi has to run."""
    import gridslam.kernels as package

    found: dict[str, Kernel] = {}
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        space = vars(importlib.import_module(module.name))
        found |= {name: f for name, f in space.items() if getattr(f, "_is_wrapped_kernel", False)}
    return found


@contextmanager
def replaced(others: Mapping[int, tuple[Function, Function]], homes: Sequence[Any]) -> Iterator[None]:
    """Put other functions in the place of some.

    Parameters
    ----------
    others : mapping
        Identity of a function -> (the function itself, what stands for it meanwhile).
    homes : sequence
        Modules and classes that have them.
    """
    undo: list[tuple[Any, str, Any]] = []
    try:
        for home in homes:
            for name, value in list(vars(home).items()):
                if id(value) in others:
                    undo.append((home, name, value))
                    setattr(home, name, others[id(value)][1])
        yield
    finally:
        for home, name, value in undo:
            setattr(home, name, value)


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
        launches = {id(kernel): (kernel, self._kernel(name, kernel)) for name, kernel in kernels().items()}
        with replaced(launches, modules("gridslam.")):
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

    def _kernel(self, name: str, kernel: Function) -> Function:
        import taichi as ti

        from gridslam.kernels.primitives.device import ON_CPU

        def timed(*arguments: Any) -> Any:
            began, stage = time.perf_counter(), self._work.stage
            try:
                result = kernel(*arguments)
                if not ON_CPU:
                    ti.sync()
                return result
            finally:
                took = time.perf_counter() - began
                self.launches[name] += 1
                self.count({KERNEL + name: took, stage: -took})

        return timed


def modules(prefix: str) -> list[ModuleType]:
    """Modules that are loaded, by the beginning of their names."""
    return [module for name, module in sorted(sys.modules.items()) if name.startswith(prefix)]
