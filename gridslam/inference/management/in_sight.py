"""Which walls may be seen at all from where the agent is: paths over the stretches that were hit.

A surface is an endless line, off which a path is nearly always possible. What was hit of it, and the cells in
between, say more.
"""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.state.grid import Grid
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import mirror, unit

SPREADS = 2.0
"""Deviations of the agent's position by which stretches are longer."""
CLEAR_M = 0.4
"""So near to the ends of a leg cells hide nothing."""


def shortest_path(state: State, lines: Array, bank: SurfaceBank, beyond: float, model: FilterModel) -> Array:
    """Length of the shortest single bounce over each wall that the agent may receive, (S,) m; else infinity.

    Parameters
    ----------
    lines : (S, 2), bank : SurfaceBank
        Of the walls that are asked for.
    beyond : float, m
        By how much a wall may reach beyond the stretch that was hit.
    """
    agent, spread = state.belief.mean[:2], np.sqrt(max(state.belief.covariance[:2, :2].trace(), 0.0))
    low, high = np.sort(np.where(np.isnan(bank.extent), bank.foot[:, None], bank.extent), axis=1).T
    reach = beyond + SPREADS * float(spread)
    best = np.full(len(lines), np.inf)
    normal, along = unit(lines[:, 0]), unit(lines[:, 0] + 0.5 * np.pi)
    height = lines[:, 1] - normal @ agent  # signed distance of the wall from the agent
    for number, anchor in enumerate(model.anchor_positions):
        image = mirror(lines, anchor)
        other = lines[:, 1] - normal @ anchor
        length = np.hypot(*(image - agent).T)
        with np.errstate(divide="ignore", invalid="ignore"):
            hit = agent + (height / (height + other))[:, None] * (image - agent)
        place = (along * hit).sum(1)
        possible = (height * other > 0) & (place > low - reach) & (place < high + reach)
        possible &= length < np.minimum(best, model.radio.max_distance_m)
        possible &= (bank.owner < 0) | (bank.owner == number)
        for row in np.flatnonzero(possible).tolist():
            legs = (agent, anchor) if state.grid is not None else ()
            if not any(is_blocked(state.require_grid(), hit[row], end, model) for end in legs):
                best[row] = length[row]
    return best


def is_blocked(grid: Grid, start: Array, end: Array, model: FilterModel) -> bool:
    """Whether an occupied cell lies between two points (2,), away from both."""
    step = 0.5 * model.grid.cell_m
    length = float(np.hypot(*(end - start)))
    if length <= 2 * CLEAR_M:
        return False
    along = np.arange(CLEAR_M, length - CLEAR_M, step) / length
    cell = np.floor((start + along[:, None] * (end - start) - model.grid.origin_m) / model.grid.cell_m)
    column, row = cell.astype(np.int64).T
    inside = (row >= 0) & (row < grid.shape[0]) & (column >= 0) & (column < grid.shape[1])
    evidence = grid.evidence[row[inside], column[inside]]
    return bool((evidence > occupied_above(model)).any())


def occupied_above(model: FilterModel) -> float:
    """Evidence from which on a cell is more likely occupied than not, given the prior of the papers."""
    share = model.grid.cell_m / model.settings.mean_free_path_m
    return float(-np.log(np.expm1(share)))
