"""Proposals of births: how well a new surface would explain each measurement; owner of that kernel."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.particles import Cloud
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.likelihood_ratios import PORTION
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels.primitives.blocks import Anchors, BirthRows, Sketch
from gridslam.kernels.primitives.tables import (
    BORN_ANCHOR,
    BORN_FIRST,
    BORN_LAST,
    BORN_OF,
    LINE_ANGLE,
    LINE_OFFSET,
    OVER_CLUTTER,
)
from gridslam.world.filter_model import FilterModel
from gridslam.world.radio import RadioModel

CONVERGED_STD_M, CONVERGED, CONVERGED_SEEN = 0.3, 0.9, 3
"""Deviation of the offset below which, existence above which, and times seen from which on a surface may be
a double bounce's other wall: docs/model.md, "Births"."""
SAMPLES = 256
"""Draws per measurement and hypothesis, K of (M32)."""


class Measured(Protocol):
    """A dataclass with what known paths say of M measurements."""

    @property
    def measured(self) -> Array:
        """Rows by measurement, (5, M), as in `tables`."""
        ...


Ratios = TypeVar("Ratios", bound=Measured)


def partners(bank: SurfaceBank, belief: Belief, most_bounces: int) -> NDArray[np.int32]:
    """Pairs (last, first) of known surfaces with which a new one may form a path, -1 for the new, (H, 2)."""
    if most_bounces < 2:
        return _known((), most_bounces)
    variances = belief.covariance.diagonal()[belief.layout.offsets]
    rows = zip(variances.tolist(), bank.existence.tolist(), bank.seen.tolist(), strict=True)
    sure = (
        variance < CONVERGED_STD_M**2 and exists > CONVERGED and seen >= CONVERGED_SEEN
        for variance, exists, seen in rows
    )
    return _known(tuple(sure), most_bounces)


@lru_cache(64)
def _known(sure: tuple[bool, ...], most_bounces: int) -> NDArray[np.int32]:
    surfaces = [s for s, is_sure in enumerate(sure) if is_sure]
    pairs = [(-1, -1)] if most_bounces >= 1 else []
    pairs += [pair for s in surfaces for pair in ((-1, s), (s, -1))]
    known = np.array(pairs, np.int32).reshape(-1, 2)
    known.setflags(write=False)
    return known


def _rows(measurements: int, hypotheses: int) -> BirthRows:
    """Reusable buffers: births of so many measurements and hypotheses."""
    most = measurements * hypotheses
    ratio = np.empty((measurements, hypotheses))
    return BirthRows(ratio, np.empty((1 + most, 4), np.int32), np.empty((most, 3)))


@timed("births")
def propose_births(
    state: State,
    scan: AnchorScan,
    cloud: Cloud,
    ratios: Ratios,
    radio: RadioModel,
    model: FilterModel,
    senders: NDArray[np.int32] | None = None,
    *,
    work: Workspace,
) -> tuple[Births, Ratios]:
    """All birth hypotheses above a least ratio, of the measurements that carry distance and an angle.

    [Li2026grid], eq. (11), integrated over agent and surface; docs/model.md, (M32).

    If nobody told which anchor sent a measurement, each may have: one hypothesis for each of them.

    Surfaces are born uniformly over all lines (angle and offset) that cross the circle about the region: a
    measure that doesn't depend on the frame. With a grid, births are weighed by V of their paths; without one
    every path is open.

    Parameters
    ----------
    radio : RadioModel
        The calibrated radio.
    senders : (A,) int32, optional
        Anchors whose measurements may bear surfaces; default: all.

    Returns
    -------
    (births, ratios)
        ratios: with 1 and the sum over each measurement's births in row `NEW`.
    """
    belief, bank, anchor = state.belief, state.surfaces, scan.anchor
    known, surfaces = partners(bank, belief, model.max_bounces), belief.layout.surfaces
    if len(bank) != surfaces or cloud.surfaces != surfaces or not -1 <= anchor < len(model.anchors):
        raise ValueError("surfaces or anchors don't belong together")
    able = _senders(anchor, model.senders)
    if senders is None or len(senders) == model.senders:
        senders = able
    else:
        senders = able[np.isin(able, senders)]
    capacity, hypotheses = -(-len(scan) // PORTION) * PORTION, len(known) * len(senders)
    births, measured = work.buffers(_rows, 0, capacity, hypotheses), ratios.measured.copy()
    _proposing()(
        model.birth_rate, belief.layout.head, belief.mean, cloud.state, _noise(len(known)), scan.table,
        known, senders, Anchors(model.places, radio.numbers), measured, births,
    )  # fmt: skip
    born, proposal = births.born, births.proposal
    if state.grid is not None and born[0, 0]:
        _weigh_by_visibility(state, births, measured, model, work)
    found, ratios = int(born[0, 0]), replace(ratios, measured=measured)
    if not found:
        return Births.none(), ratios
    rows, values = born[1 : 1 + found].copy(), proposal[:found].copy()  # the next call reuses the buffers
    hit, line = rows[:, BORN_LAST : BORN_FIRST + 1], values[:, LINE_ANGLE : LINE_OFFSET + 1]
    return Births(rows[:, BORN_OF], hit, line, values[:, OVER_CLUTTER], rows[:, BORN_ANCHOR]), ratios


def _weigh_by_visibility(
    state: State, births: BirthRows, measured: Array, model: FilterModel, work: Workspace
) -> None:  # fmt: skip
    """Weigh births by V of their paths at the mean of the belief, in both buffers."""
    grid, cells, layout = state.require_grid(), work.require_cells(), state.belief.layout
    scratch = cells.scratch
    sketch = Sketch(scratch.line, scratch.place, *work.buffers(_sketch, 0, layout.surfaces + 1))
    _weighing()(
        layout.head, grid.shape[1], state.belief.mean, model.places, cells.occupancy(grid), cells.frame,
        sketch, births, measured,
    )  # fmt: skip


def _sketch(surfaces: int) -> tuple[Array, NDArray[np.int32], Array]:
    """Scratch for one path at a time, over so many surfaces."""
    return np.empty((3 + 3 * surfaces, 1)), np.empty((1, 4), np.int32), np.empty((1, 14))


@cache
def _senders(anchor: int, anchors: int) -> NDArray[np.int32]:
    """Anchors that may have sent what is known to come from one of them, or from any."""
    return np.arange(anchors, dtype=np.int32) if anchor < 0 else np.array([anchor], np.int32)


@cache
def _noise(seed: int) -> Array:
    """Standard normal noise of distance and angle, (2, SAMPLES)."""
    return np.random.default_rng(seed).standard_normal((2, SAMPLES))


@runtime.once_started
def _proposing() -> Any:
    """The kernel that proposes births."""
    from gridslam.kernels.management.births import propose

    return propose


@runtime.once_started
def _weighing() -> Any:
    """The kernel that weighs births by V of their paths."""
    from gridslam.kernels.management.birth_visibility import weigh_by_visibility

    return weigh_by_visibility
