"""Where a step's time goes, found from outside: nothing in the filter knows of it, or pays for it.

While a filter is watched, the kernels and the functions of `gridslam.inference` are replaced by timed ones
wherever a module holds them; afterwards everything is as it was.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any

STAGES = {
    "likelihood_ratios": "evaluation",
    "likelihood": "evaluation",
    "particles": "evaluation",
    "rays": "evaluation",
    "prediction": "evaluation",
    "ray_amplitudes": "evaluation",
    "association": "association",
    "updates": "updates",
    "births": "births",
    "birth_proposals": "births",
    "path_messages": "cells",
    "cells": "cells",
    "polylines": "cells",
    "reflection": "cells",
}
"""Modules of `gridslam.inference` and the stage that their functions count for."""
OTHER = "bookkeeping"
"""Everything else: motion, surfaces, estimates, and what joins the stages."""
LAUNCHES = "launches"
KERNEL = "kernel "
"""Before the name of a kernel."""

Function = Callable[..., Any]


def kernels() -> dict[str, Function]:
    """All Taichi kernels by name; Taichi has to run."""
    import gridslam.kernels as package

    found: dict[str, Function] = {}
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

    A stage lasts from its outermost function to that function's return, without the kernels launched on
    the way.

    Attributes
    ----------
    seconds : dict
        By stage, and by kernel under ``"kernel NAME"``, launch included.
    launches : Counter
        By kernel.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = dict.fromkeys([*STAGES.values(), OTHER], 0.0)
        self.launches: Counter[str] = Counter()
        self._in_kernels, self._inside = 0.0, False

    @contextmanager
    def watching(self) -> Iterator[Stopwatch]:
        """Time whatever runs meanwhile."""
        launches = {id(kernel): (kernel, self._kernel(name, kernel)) for name, kernel in kernels().items()}
        stages: dict[int, tuple[Function, Function]] = {}
        classes = []
        for module in modules("gridslam.inference."):
            stage, own = STAGES.get(module.__name__.rpartition(".")[2], OTHER), _classes(module)
            classes += own
            for home in (module, *own):
                for name, function in vars(home).items():
                    here = inspect.isfunction(function) and function.__module__ == module.__name__
                    if here and not name.startswith("_"):
                        stages[id(function)] = function, self._stage(stage, function)
        # a stage is told by its outermost function, and every function that is watched takes longer
        outermost = [*modules("gridslam.systems."), *classes]
        with replaced(launches, modules("gridslam.")), replaced(stages, outermost):
            yield self

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
            began = time.perf_counter()
            try:
                result = kernel(*arguments)
                if not ON_CPU:
                    ti.sync()
                return result
            finally:
                took = time.perf_counter() - began
                self.seconds[KERNEL + name] = self.seconds.get(KERNEL + name, 0.0) + took
                self.launches[name] += 1
                self._in_kernels += took

        return timed

    def _stage(self, stage: str, function: Function) -> Function:
        def timed(*arguments: Any, **named: Any) -> Any:
            if self._inside:
                return function(*arguments, **named)
            self._inside = True
            began, before = time.perf_counter(), self._in_kernels
            try:
                return function(*arguments, **named)
            finally:
                took = time.perf_counter() - began
                self.seconds[stage] += took - (self._in_kernels - before)
                self._inside = False

        return timed


def modules(prefix: str) -> list[ModuleType]:
    """Modules that are loaded, by the beginning of their names."""
    return [module for name, module in sorted(sys.modules.items()) if name.startswith(prefix)]


def _classes(module: ModuleType) -> list[type]:
    return [c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == module.__name__]
