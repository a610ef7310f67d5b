"""A filter's workspace: buffers and clock, which die with it. It holds nothing of the state."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Hashable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.particles import Particles
from gridslam.inference.state.path_messages import PathMessages
from gridslam.inference.workspace.cell_buffers import CellBuffers
from gridslam.world.filter_model import FilterModel

Made = TypeVar("Made")
P = ParamSpec("P")
R = TypeVar("R")
Rows = TypeVar("Rows", bound=NDArray[Any])
Model = TypeVar("Model", bound=FilterModel)
NONE = np.zeros(0)
OTHER = "bookkeeping"
"""Stage of whatever isn't timed by itself."""
SHARED = 64
"""Things that hypotheses share, at most."""
VIEWS = 64
"""Views of buffers that are kept, at most."""
SHAPES = 4
"""Shapes of which buffers last at the same time: hypotheses differ by some paths."""
SLOTS = 48
"""Slots beyond which, as with many anchors, buffers of one shape last: those of four took gigabytes."""


class StageClock:
    """Where the time of a filter's latest step goes, by stage.

    Attributes
    ----------
    seconds : dict of str to float
        Time of the latest step, by stage.
    stage : str
        For which time counts now.
    """

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.stage = OTHER
        self._since = time.perf_counter()

    def begin(self) -> None:
        """A new step."""
        self.seconds = defaultdict(float)
        self.stage = OTHER
        self._since = time.perf_counter()

    def turn_to(self, stage: str) -> str:
        """Count time for this stage from now on; the stage for which it counted."""
        now, before = time.perf_counter(), self.stage
        self.seconds[before] += now - self._since
        self._since, self.stage = now, stage
        return before

    def times(self) -> dict[str, float]:
        """Seconds of the step so far, by stage."""
        self.turn_to(self.stage)
        return dict(self.seconds)


class Workspace(StageClock):
    """What the steps of one filter write to and may forget.

    Attributes
    ----------
    particles : Particles
        Normal points from which beliefs are sampled; they follow from seed and number.
    messages : PathMessages
        Messages of all paths to coefficients and cells, within a step.
    recovers : bool
        Whether a step may look for a lost agent by itself.

    Parameters
    ----------
    model : FilterModel
    seed : int
    grid : bool
        Whether the system maps cells.
    cells : CellBuffers, optional
        Of another workspace, with which this one shares its grid.

    Raises
    ------
    InputError
        The machine has no memory for so many cells.
    """

    def __init__(
        self, model: FilterModel, seed: int, grid: bool = False, cells: CellBuffers | None = None
    ) -> None:
        super().__init__()
        settings = model.settings
        self.seed = seed
        self.recovers = True
        self._cells = CellBuffers(model) if grid and cells is None else cells
        self.particles = Particles(settings.particles, seed, settings.adapt_particles)
        self.messages = PathMessages(self._cells is not None)
        self._buffers: dict[tuple[Callable[..., Any], Hashable], list[tuple[tuple[Any, ...], Any]]] = {}
        self._shared: dict[tuple[Any, ...], tuple[tuple[Any, ...], Any]] = {}
        self._views: dict[tuple[int, int], tuple[NDArray[Any], Any]] = {}
        self._turned: tuple[FilterModel, bytes, Any] | None = None

    def begin(self) -> None:
        """A new step: whatever an earlier one left, should it have been interrupted, is dropped."""
        self.messages.clear()
        if self._cells is not None:
            self._cells.settle()
        super().begin()

    def buffers(self, make: Callable[..., Made], slot: Hashable, *shape: Any) -> Made:
        """What `make` made of this shape for the slot, made anew if the latest ones were of other shapes.

        The slot tells apart what is in use at the same time, as the anchors' arrays are.
        """
        known = self._buffers.setdefault((make, slot), [])
        for one in known:
            if one[0] == shape:
                break
        else:
            one = shape, make(*shape)
            others = known[1 - SHAPES :] if len(self._buffers) <= SLOTS else []
            self._buffers[make, slot] = [*others, one]
        made: Made = one[1]
        return made

    def first_rows(self, whole: Rows, count: int) -> Rows:
        """The first rows of a buffer as one and the same view, which kernels needn't be handed anew."""
        key = id(whole), count
        if key not in self._views:
            if len(self._views) == VIEWS:
                self._views.clear()
            self._views[key] = whole, whole[:count]  # which keeps it: no other has its number
        rows: Rows = self._views[key][1]
        return rows

    def once(self, make: Callable[..., Made], *of: Any) -> Made:
        """What `make` makes of these very objects: made once, for hypotheses share it.

        Nobody may change it in place, nor what it was made of.
        """
        key = make, *map(id, of)
        known = self._shared.get(key)
        if known is None:
            if len(self._shared) == SHARED:
                self._shared.clear()
            known = self._shared[key] = of, make(*of)  # which keeps them, so that others have other numbers
        made: Made = known[1]
        return made

    def require_cells(self) -> CellBuffers:
        """Arrays of the cells, of a system that maps them.

        Raises
        ------
        ValueError
            This system maps none.
        """
        if self._cells is None:
            raise ValueError("this system has no grid")
        return self._cells

    def calibrated(
        self, model: Model, turns: Array, higher: Array = NONE, aside: Array | None = None
    ) -> Model:
        """The model with its anchors turned by (J,) rad, higher by rises of (G,) m and standing `aside` of
        where they are told to; the same object while nothing changes. See `FilterModel.calibrated`."""
        key = turns.tobytes() + higher.tobytes() + (b"" if aside is None else aside.tobytes())
        if self._turned is None or self._turned[0] is not model or self._turned[1] != key:
            self._turned = model, key, model.calibrated(turns, higher, aside)
        calibrated: Model = self._turned[2]
        return calibrated


def timed(stage: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Count a function's time for a stage, in the workspace that it is handed as `work`."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def run(*arguments: P.args, **named: P.kwargs) -> R:
            work: Any = named["work"]
            before = work.turn_to(stage)
            try:
                return function(*arguments, **named)
            finally:
                work.turn_to(before)

        return run

    return decorate
