"""Walls of an earlier map that paths went through since: they have moved, or are gone.

Nothing else tells. Once the cells of such a wall are free no path is expected off it, so that none is missed;
and that none is heard off a wall that stands tells little where the world has changed: what hides it is in no
map.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.management.in_sight import LASTING
from gridslam.inference.state.grid import Grid
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import unit

WALL_NAT = -1.0
"""Evidence below which cells were crossed, rather than hit."""
LEFT = 0.05
"""Share of a stretch that may be left: what nothing crosses, as beside another wall."""
EVERY, DOUBT_NAT = 4, 1.0
"""Steps from look to look; by how much the existence of such a wall falls at each step, in log odds."""
BESIDE_CELLS = np.array([-1.0, 0.0, 1.0])
"""Where cells are asked, beside the line."""


def doubt_passed(earlier: State, state: State, model: FilterModel) -> State:
    """The state with walls less likely that paths went through all along; docs/model.md, (M502).

    Parameters
    ----------
    earlier : State
        As predicted, of which the first surfaces of the state are.
    """
    grid = state.grid
    if grid is None or grid.withheld is None or state.step % EVERY:
        return state
    bank, count = state.surfaces, len(earlier.surfaces)
    asked = bank.seen >= LASTING
    asked[:count] &= bank.seen[:count] == earlier.surfaces.seen  # what is heard off it, it sends
    asked[count:] = False
    # those out of sight are parked, and come back before anything is heard through where they stood
    return replace(state, surfaces=_doubted(bank, state.belief.lines, asked, grid, model))


def _doubted(
    bank: SurfaceBank, lines: Array, asked: NDArray[np.bool_], grid: Grid, model: FilterModel
) -> SurfaceBank:
    """The bank with those of the surfaces that are asked for (S,) less likely whose stretch was crossed."""
    rows = [row for row in np.flatnonzero(asked) if passed(lines[row], bank.extent[row], grid, model)]
    if not rows:
        return bank
    existence = bank.existence.copy()
    existence[rows] = 1 / (1 + np.exp(EVERY * DOUBT_NAT) * (1 / existence[rows] - 1))
    return replace(bank, existence=existence)


def passed(line: Array, extent: Array, grid: Grid, model: FilterModel) -> bool:
    """Whether paths went through nearly all of the stretch of a line, (2,) m along it, that was hit."""
    low, high = np.sort(extent)
    side, origin = model.grid.cell_m, model.grid.origin_m
    if not np.isfinite(high - low):
        return False
    count = max(round((high - low) / side), 1)
    along = low + (high - low) * (np.arange(count) + 0.5) / count
    across = (line[1] + BESIDE_CELLS * side)[:, None] * unit(line[0])
    place = across + along[:, None, None] * unit(line[0] + 0.5 * np.pi)
    column, row = np.moveaxis(np.floor((place - origin) / side).astype(np.int64), -1, 0)
    inside = (row >= 0) & (row < grid.shape[0]) & (column >= 0) & (column < grid.shape[1])
    evidence = grid.whole_evidence((np.where(inside, row, 0), np.where(inside, column, 0)))
    wall = (inside & (evidence >= WALL_NAT)).any(1) | ~inside.any(1)
    return bool(wall.mean() < LEFT)
