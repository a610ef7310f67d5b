"""Which walls may be seen at all from where the agent is: paths over the stretches that were hit.

A surface is an endless line, off which a path is nearly always possible. What was hit of it, and the cells in
between, say more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
    reach, anchors = beyond + SPREADS * float(spread), model.anchor_positions
    normal, along = unit(lines[:, 0]), unit(lines[:, 0] + 0.5 * np.pi)
    image = mirror(lines, anchors[:, None])  # (J, S, 2)
    here, there = lines[:, 1] - normal @ agent, lines[:, 1] - anchors @ normal.T  # distances from the wall
    length = np.hypot(*np.moveaxis(image - agent, -1, 0))
    share = np.divide(here, here + there, out=np.zeros_like(there), where=here * there > 0)
    hit = agent + share[..., None] * (image - agent)
    place = (along * hit).sum(-1)
    possible = (here * there > 0) & (place > low - reach) & (place < high + reach)
    possible &= length < model.radio.max_distance_m
    possible &= (bank.owner < 0) | (bank.owner == np.arange(len(anchors))[:, None])
    if state.grid is not None and possible.any():
        anchor, _ = np.nonzero(possible)
        legs = np.broadcast_to(agent, (len(anchor), 2)), anchors[anchor]
        hidden = [are_blocked(state.grid, hit[possible], ends, model) for ends in legs]
        possible[possible] = ~np.any(hidden, axis=0)
    return np.asarray(np.where(possible, length, np.inf).min(0, initial=np.inf))


def are_blocked(grid: Grid, start: Array, end: Array, model: FilterModel) -> NDArray[np.bool_]:
    """Whether an occupied cell lies between points (L, 2) and (L, 2), away from both, (L,)."""
    way, cell = end - start, model.grid.cell_m
    length = np.hypot(*way.T)
    along = CLEAR_M + 0.5 * cell * np.arange(int(length.max(initial=0.0) / (0.5 * cell)) + 1)
    between = along < length[:, None] - CLEAR_M
    points = start[:, None] + (along / np.maximum(length, cell)[:, None])[..., None] * way[:, None]
    column, row = np.moveaxis(np.floor((points - model.grid.origin_m) / cell).astype(np.int64), -1, 0)
    between &= (row >= 0) & (row < grid.shape[0]) & (column >= 0) & (column < grid.shape[1])
    evidence = grid.evidence[np.where(between, row, 0), np.where(between, column, 0)]
    return np.asarray((between & (evidence > occupied_above(model))).any(1))


def occupied_above(model: FilterModel) -> float:
    """Evidence from which on a cell is more likely occupied than not, given the prior of the papers."""
    share = model.grid.cell_m / model.settings.mean_free_path_m
    return float(-np.log(np.expm1(share)))
