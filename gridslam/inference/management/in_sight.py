"""Which walls may be seen at all from where the agent is: paths over the stretches that were hit.

A surface is an endless line, off which a path is nearly always possible. What was hit of it, and the cells in
between, say more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.state.grid import Grid
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SETTLED, SurfaceBank
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import mirror, unit

SPREADS = 2.0
"""Deviations of the agent's position by which stretches are longer."""
FARTHER_M = 2.0
"""By how much a wall may reach beyond the stretch that was hit, to be out of sight."""
BELIEVED, DOUBTED = 0.5, 0.35
"""Existence of a ray from which on its surfaces aren't out of sight, and below which its silence says nothing
of surfaces that were seen often: single bounces of a new agent begin at one half, and count until they were
missed; double bounces begin below."""
LASTING = SETTLED
"""Sightings from which on a surface is spared, as many as one of an earlier map counts: ghosts are heard at
some thirty steps, too."""
SUREST = 1 - 1e-7
"""Greatest existence of a surface."""
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


def out_of_reach(state: State, asked: NDArray[np.bool_], model: FilterModel) -> NDArray[np.bool_]:
    """Which of the surfaces that are asked for (S,) no path can be over, (S,)."""
    away, rows = asked.copy(), np.flatnonzero(asked)
    if len(rows):
        bank = state.surfaces.take(rows)
        away[rows] = ~np.isfinite(shortest_path(state, state.belief.lines[rows], bank, FARTHER_M, model))
    return away


def spare_unseen(earlier: State, state: State, model: FilterModel) -> State:
    """The state with surfaces that aren't seen from here as likely as they were; docs/model.md, (M495).

    Else walls of rooms that nobody is in are gone after some hundred steps: by survival, and by dozens of
    rays that are believed in to a hundredth each.

    Parameters
    ----------
    earlier : State
        As predicted, of which the first surfaces of the state are.
    """
    bank, count = state.surfaces, len(earlier.surfaces)
    lasting = bank.seen >= LASTING
    lasting[count:] = False
    if not lasting.any():
        return state
    rays = bank.likeliest_ray
    unseen = lasting & (rays < DOUBTED)
    unseen |= out_of_reach(state, lasting & ~unseen & (rays < BELIEVED), model)
    if not unseen.any():
        return state
    existence, before = bank.existence.copy(), earlier.surfaces.existence / model.settings.survival
    existence[unseen] = np.maximum(existence[unseen], np.minimum(before, SUREST)[unseen[:count]])
    return replace(state, surfaces=replace(bank, existence=existence))


def are_blocked(grid: Grid, start: Array, end: Array, model: FilterModel) -> NDArray[np.bool_]:
    """Whether an occupied cell lies between points (L, 2) and (L, 2), away from both, (L,)."""
    way, cell = end - start, model.grid.cell_m
    length = np.hypot(*way.T)
    along = CLEAR_M + 0.5 * cell * np.arange(int(length.max(initial=0.0) / (0.5 * cell)) + 1)
    between = along < length[:, None] - CLEAR_M
    points = start[:, None] + (along / np.maximum(length, cell)[:, None])[..., None] * way[:, None]
    column, row = np.moveaxis(np.floor((points - model.grid.origin_m) / cell).astype(np.int64), -1, 0)
    between &= (row >= 0) & (row < grid.shape[0]) & (column >= 0) & (column < grid.shape[1])
    evidence = grid.whole_evidence((np.where(between, row, 0), np.where(between, column, 0)))
    return np.asarray((between & (evidence > occupied_above(model))).any(1))


def occupied_above(model: FilterModel) -> float:
    """Evidence from which on a cell is more likely occupied than not, given the prior of the papers."""
    share = model.grid.cell_m / model.settings.mean_free_path_m
    return float(-np.log(np.expm1(share)))
