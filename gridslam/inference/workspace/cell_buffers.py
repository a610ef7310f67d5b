"""Arrays of all cells that belong to a filter's workspace; owner of the kernel that folds messages in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.state.grid import Grid
from gridslam.kernels import CELL_SLABS
from gridslam.kernels.primitives.blocks import Slabs
from gridslam.world.filter_model import FilterModel
from gridslam.world.grid_memory import check_room, slabs_for

MOSTLY_POSSIBLE = 0.8
"""Share of a path's samples that must be possible before it sends messages to cells."""
EVIDENCE_CLIP = 12.0
CLEAR_ANCHOR_M = 0.35
OUTSIDE = 0.1
"""Factor of a hit outside the grid."""
OTHER_MATERIAL = 0.05
"""Share of the belief that a wall is of another material where it is hit next."""


class CellBuffers:
    """Arrays of all cells that belong to a workspace: occupancy in both roles, and casting's scratch.

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
        self.frame = np.array([*origin, cell, OUTSIDE, EVIDENCE_CLIP, 0.0, OTHER_MATERIAL])
        self.frame_of_messages = self.frame.copy()
        self.frame_of_messages[5] = MOSTLY_POSSIBLE
        self.occupied = runtime.room((2, self.count))
        self.occupied_by: Array | None = None
        """Evidence that the occupancy follows from; None for none."""
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
        """Occupancy in both roles, crossed and met, (2, ny nx) float32."""
        if self.occupied_by is not grid.evidence:
            empty = np.empty((0, self.count), np.float32), np.empty((0, self.scratch.news.shape[1]), np.uint8)
            self.fold(grid, *empty, every=True)  # messages stay
        return self.occupied

    def fold(
        self, grid: Grid, message: runtime.Resident, news: runtime.Resident, every: bool = False
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Evidence of the cells with messages folded in, and which are observed; messages are 0 then."""
        from gridslam.kernels.propagation.occupancy import fold_messages

        fresh, observed = np.empty(grid.shape), grid.observed.copy()
        self.occupied_by = None  # until all of it is done
        fold_messages(
            message, news, grid.evidence.reshape(-1), self.clear, int(every), self.prior_odds, EVIDENCE_CLIP,
            fresh.reshape(-1), observed.view(np.uint8).reshape(-1), self.occupied,
        )  # fmt: skip
        self.occupied_by = grid.evidence if every else fresh
        return fresh, observed


def _clear(origin: Array, cell: float, shape: tuple[int, int], anchors: Array) -> NDArray[np.bool_]:
    """Which cells (ny, nx) have their centre next to one of the anchors (J, 2), without room for all J."""
    clear = np.zeros(shape, dtype=bool)
    for place in anchors:
        x, y = (
            (origin[axis] + cell * (np.arange(shape[1 - axis]) + 0.5) - place[axis]) ** 2 for axis in (0, 1)
        )
        near_x, near_y = np.flatnonzero(x < CLEAR_ANCHOR_M**2), np.flatnonzero(y < CLEAR_ANCHOR_M**2)
        near = np.sqrt(x[near_x] + y[near_y, None]) < CLEAR_ANCHOR_M
        clear[np.ix_(near_y, near_x)] |= near
    return clear
