"""Arrays of all cells that belong to a filter's workspace; owner of the kernel that folds messages in."""

from __future__ import annotations

import weakref

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.state.grid import EVIDENCE_CLIP, Grid
from gridslam.kernels import CELL_SLABS
from gridslam.kernels.primitives.blocks import Slabs
from gridslam.kernels.primitives.tables import LEAST
from gridslam.world.filter_model import FilterModel
from gridslam.world.grid_memory import check_room, slabs_for

MOSTLY_POSSIBLE = 0.8
"""Share of a path's samples that must be possible before it sends messages to cells."""
CLEAR_ANCHOR_CELLS = 1.0
"""So near to an anchor, in cells, the centres of cells are surely free: what it stands in. Anything wider is
a hole in the wall that an anchor hangs on."""
OCCUPANCY_BYTES = 64_000_000
"""What occupancies of several hypotheses' grids may take; that of one is kept anyway."""
OUTSIDE = 0.1
"""Factor of a hit outside the grid."""
SPARED_CELLS = 1.5
"""How many cells along its normal a wall is spared by the rays that it reflects, (M520): a bounce meets the
cells in front of a wall, at it and behind it, all of which may hold it."""
OTHER_MATERIAL = 0.05
"""Share of the belief that a wall is of another material where it is hit next."""


class CellBuffers:
    """Arrays of all cells that belong to a workspace: occupancies in both roles, and casting's scratch.

    Parameters
    ----------
    model : FilterModel

    Raises
    ------
    InputError
        The machine has no memory for so many cells.
    """

    def __init__(self, model: FilterModel) -> None:
        shape = model.grid.shape
        self.count = shape[0] * shape[1]
        check_room(self.count)
        slabs = slabs_for(CELL_SLABS[runtime.start()], self.count)
        from gridslam.kernels.propagation.bundles import LANES, LINES, PLACES
        from gridslam.kernels.propagation.occupancy import CELLS

        origin = np.array(model.grid.origin_m)
        cell, free_path = model.grid.cell_m, model.settings.mean_free_path_m
        prior = 1 - np.exp(-cell / free_path)
        self.prior_odds = float(np.log(prior / (1 - prior)))
        self.clear = _clear(origin, cell, shape, model.anchor_positions).view(np.uint8).reshape(-1)
        spared_m = SPARED_CELLS * cell
        self.frame = np.array([*origin, cell, OUTSIDE, EVIDENCE_CLIP, 0.0, OTHER_MATERIAL, spared_m])
        self.frame_of_messages = self.frame.copy()
        self.frame_of_messages[LEAST] = MOSTLY_POSSIBLE
        self._most = max(1, OCCUPANCY_BYTES // (8 * self.count))
        self._known: list[tuple[weakref.ref[Array], runtime.Resident]] = []
        """Occupancies, with the evidence that each follows from; the one asked for last is the last."""
        self.unsettled = False
        """Whether messages may wait that no step has taken in."""
        self.scratch = Slabs(
            runtime.room((slabs, LINES, LANES), np.float64),
            runtime.room((slabs, PLACES, LANES), np.int32),
            runtime.resident(np.zeros((3 * slabs, self.count), np.float32)),
            runtime.resident(np.zeros((2 * slabs, self.count + 1), np.int32)),
            runtime.resident(np.zeros((slabs, self.count), np.uint8)),
            runtime.resident(np.zeros((slabs, self.count), np.float32)),
            runtime.resident(np.zeros((slabs, -(-self.count // CELLS)), np.uint8)),
        )

    def settle(self) -> None:
        """Drop messages that were never taken in, since a step was interrupted."""
        if self.unsettled:
            self.scratch.message.fill(0)
            self.scratch.news.fill(0)
            self.unsettled = False

    def occupancy(self, grid: Grid) -> runtime.Resident:
        """Occupancy in both roles, crossed and met, (2, ny nx) float32: [Li2026grid], eq. (13).

        It is kept by its evidence, so that hypotheses with grids of their own may be stepped in turn.
        """
        known = self._taken(grid.evidence)
        if known is None:
            empty = np.empty((0, self.count), np.float32), np.empty((0, self.scratch.news.shape[1]), np.uint8)
            known = self._spare()
            self._fold(grid, *empty, known, every=True)  # messages stay
        self._known.append((weakref.ref(grid.evidence), known))
        return known

    def fold(self, grid: Grid) -> tuple[Array, NDArray[np.bool_]]:
        """Evidence of the cells with messages folded in, and which are observed: [Li2026grid], eq. (46).

        Messages are 0 then, and the occupancy becomes that of the new evidence.
        """
        self.occupancy(grid)
        known = self._taken(grid.evidence)  # until all of it is done
        fresh, observed = self._fold(grid, self.scratch.message, self.scratch.news, known)
        still = [other for other in self._known if other[0]() is not None]
        self._known = [*still, (weakref.ref(fresh), known)]
        self.unsettled = False
        return fresh, observed

    def _fold(
        self, grid: Grid, message: runtime.Resident, news: runtime.Resident, occupied: runtime.Resident,
        every: bool = False,
    ) -> tuple[Array, NDArray[np.bool_]]:  # fmt: skip
        from gridslam.kernels.propagation.occupancy import fold_messages

        fresh, observed = np.empty(grid.shape), grid.observed.copy()
        fold_messages(
            message, news, grid.evidence.reshape(-1), self.clear, int(every), self.prior_odds, EVIDENCE_CLIP,
            fresh.reshape(-1), observed.view(np.uint8).reshape(-1), occupied,
        )  # fmt: skip
        return fresh, observed

    def _taken(self, evidence: Array) -> runtime.Resident | None:
        """The occupancy that follows from this evidence, if it is kept; it is no longer."""
        for number in reversed(range(len(self._known))):
            if self._known[number][0]() is evidence:
                return self._known.pop(number)[1]
        return None

    def _spare(self) -> runtime.Resident:
        """Room for one more occupancy, or that of the one asked for longest ago."""
        full = len(self._known) >= self._most
        return self._known.pop(0)[1] if full else runtime.room((2, self.count))


def _clear(origin: Array, cell: float, shape: tuple[int, int], anchors: Array) -> NDArray[np.bool_]:
    """Which cells (ny, nx) have their centre next to one of the anchors (J, 2), without room for all J."""
    clear = np.zeros(shape, dtype=bool)
    for place in anchors:
        x, y = (
            (origin[axis] + cell * (np.arange(shape[1 - axis]) + 0.5) - place[axis]) ** 2 for axis in (0, 1)
        )
        reach = CLEAR_ANCHOR_CELLS * cell
        near_x, near_y = np.flatnonzero(x < reach**2), np.flatnonzero(y < reach**2)
        near = np.sqrt(x[near_x] + y[near_y, None]) < reach
        clear[np.ix_(near_y, near_x)] |= near
    return clear
