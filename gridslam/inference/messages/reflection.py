"""Reflection coefficients: beliefs about products of them along paths, and what amplitudes say of each; owner
of that kernel. [Li2026grid], eq. (2); docs/model.md, (M41), (M42)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.messages.amplitudes import detection_table
from gridslam.inference.messages.cells import RAYS
from gridslam.inference.state.polylines import Polylines
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels.primitives.blocks import Coefficients, Drawn, Hits
from gridslam.world.filter_model import FilterModel
from gridslam.world.levels import COEFFICIENTS
from gridslam.world.radio import BINS, RadioModel

PRODUCTS: Array = np.arange(1, 2 * BINS + 1) / (2 * BINS)
"""Nodes for products of coefficients; they hold every bin's centre, and 1 for the line of sight."""
PORTION = 4096
"""Room for cells that are hit comes in portions."""


@dataclass(frozen=True)
class Reflected:
    """Amplitudes by reflection: node c of a path of length d stands for ``c u_1m / d``.

    Attributes
    ----------
    probability : (L, K)
        Belief over `PRODUCTS`.
    """

    probability: Array
    radio: RadioModel

    spreading = True

    @property
    def nodes(self) -> Array:
        """Amplitudes of the nodes at 1 m, (K,)."""
        return _nodes(self.radio.amplitude_at_1m)


def reflected(products: Array, rays: Rays, radio: RadioModel, levels: Array | None = None) -> Reflected:
    """Amplitudes by beliefs over products of walls' coefficients (L, K), and by floor and ceiling.

    [Li2026grid], eq. (2), of uncertain coefficients.

    Parameters
    ----------
    levels : (W, 50), optional
        Beliefs about coefficients of floor and ceiling, 0 for a known one.
    """
    if len(radio.image_gains) == 1:
        return Reflected(products, radio)
    weaker = products.copy()
    for image, gain in enumerate(radio.image_gains):
        own = rays.anchor // radio.senders == image
        belief = levels[image - 1] if image and levels is not None else None
        unsure = belief is not None and belief.any()
        weaker[own] = products[own] @ (_mixed(belief) if unsure else _times(gain))
    return Reflected(weaker, radio)


def _mixed(belief: Array | None) -> Array:
    """What a factor makes of it of which there is a belief over `COEFFICIENTS`, (K, K)."""
    return np.asarray(np.tensordot(np.asarray(belief), _all_times(), 1))


@lru_cache(1)
def _all_times() -> Array:
    """What each of `COEFFICIENTS` makes of a belief over `PRODUCTS`, (50, K, K)."""
    return np.array([_times(float(factor)) for factor in COEFFICIENTS])


@lru_cache(16)
def _times(gain: float) -> Array:
    """What a factor makes of a belief over `PRODUCTS`, (K, K): means are kept where nodes are near enough."""
    place = np.clip(gain * PRODUCTS * len(PRODUCTS) - 1, 0, len(PRODUCTS) - 1)
    low = np.minimum(place.astype(np.intp), len(PRODUCTS) - 2)
    moved, node = np.zeros((len(PRODUCTS), len(PRODUCTS))), np.arange(len(PRODUCTS))
    moved[node, low], moved[node, low + 1] = low + 1 - place, place - low
    moved.setflags(write=False)
    return moved


@lru_cache(16)
def _nodes(amplitude_at_1m: float) -> Array:
    nodes = amplitude_at_1m * PRODUCTS
    nodes.setflags(write=False)
    return nodes


@timed("cells")
def update_coefficients(state: State, drawn: Polylines, model: FilterModel, *, work: Workspace) -> State:
    """Learn coefficients of surfaces and cells from a step's amplitudes, (M42), and where surfaces were hit.

    Detections are counted, too, and the stretches that were hit moved and made longer, (M391).

    Parameters
    ----------
    drawn : Polylines
        The paths of the step's messages, as cast at sampled states.
    """
    messages, bank, belief, grid = work.messages, state.surfaces, state.belief, state.require_grid()
    surfaces, before = len(bank), len(grid.hit)
    if messages.among[0] > surfaces or belief.layout.surfaces != surfaces:
        raise ValueError("messages or belief aren't of these surfaces")
    detection, tuned = detection_table(model.radio), state.calibration.tuned(model.radio, 0).numbers
    most = -(-(before + 2 * drawn.count * RAYS) // PORTION) * PORTION
    # the kernel learns in copies in the workspace, which last: to hand over new arrays takes longer
    where, held, count = work.buffers(_cells, 0, grid.shape, most)
    surface, usual, latest, hits = work.buffers(_surfaces, 0, surfaces)
    learned = Coefficients(surface, where, held, count, usual, latest)
    copies: list[NDArray[Any]] = [surface, where, *hits]
    given = bank.reflection, grid.row, bank.foot, bank.extent, bank.seen, bank.outermost
    for copy, known in zip(copies, given, strict=True):
        copy[...] = known
    held[:before], count[0] = grid.hit, before
    _learning()(
        belief.layout.head, detection.step, belief.mean, detection.chance, tuned,
        work.require_cells().frame_of_messages, model.places, Drawn(drawn.drawn, drawn.seen),
        messages.block(), learned, hits,
    )  # fmt: skip
    used = int(count[0])
    row = grid.row if used == before else where.copy()  # it names no other cells
    foot, extent, seen, outermost = (copy.copy() for copy in hits)
    bank = replace(bank, reflection=surface.copy(), foot=foot, extent=extent, seen=seen, outermost=outermost)
    return replace(state, surfaces=bank, grid=replace(grid, row=row, hit=held[:used].copy()))


def _cells(shape: tuple[int, int], most: int) -> tuple[NDArray[np.int32], NDArray[np.float32], Any]:
    """Room for every cell's row, for what so many cells learn that are hit, and for how many are."""
    return np.empty(shape, np.int32), np.empty((most, BINS), np.float32), np.empty(1, np.int32)


def _surfaces(surfaces: int) -> tuple[Array, Array, NDArray[np.int32], Hits]:
    """Room for what so many surfaces learn, for scratch, and for where they were hit."""
    hits = Hits(
        np.empty(surfaces), np.empty((surfaces, 2)), np.empty(surfaces, np.int64), np.empty((surfaces, 8))
    )
    return np.empty((surfaces, BINS)), np.empty(surfaces), np.empty(surfaces, np.int32), hits


@runtime.once_started
def _learning() -> Any:
    """The kernel that learns coefficients."""
    from gridslam.kernels.propagation.coefficients import learn

    return learn
