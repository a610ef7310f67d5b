"""Which surfaces aren't mirrors, by where their paths depart; docs/model.md, (M517). Ours.

What is heard over a corner of two walls, of which one isn't known, arrives as if from behind one wall, from a
place that stays. Born there, such a wall is confirmed at every step by distance and arrival, and pulls the
agent about its anchor by the only thing that doesn't fit: where paths depart.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import replace
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.kernels import LIKELIER_THAN_NOT, UNMEASURED
from gridslam.kernels.primitives.tables import BOUNCES, LAST
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import mirror

AOD = 1
"""Column of what is measured: distance, AoD, AoA."""
MOST_SURPRISED = 2.5
"""What one departure may say at most, in deviations: it may be another path's."""
SURE, SYSTEMATIC_RAD = 5.0, np.radians(0.5)
"""Deviations by which the mean departure has to miss, and how far it may for what the radio doesn't know of
itself, as an anchor that is turned."""
MOST_CORNERS = 64
"""Corners that are kept: the latest."""


def weigh_departures(
    state: State, paths: PredictedPaths, ratios: LikelihoodRatios, exchange: Exchange
) -> State:
    """The state with the departures of its single bounces weighed, as they were predicted; (M517).

    Where the agent is lost, or was until lately, departures tell of its place.

    Parameters
    ----------
    paths : PredictedPaths
        L paths over the surfaces of `state`.
    ratios : LikelihoodRatios
        Of these, with the pairs that may belong together.
    exchange : Exchange
        Which of them did.
    """
    if state.monitor.astray:
        return state
    index, pair = ratios.pairs.index[: len(ratios.pairs)], ratios.pairs.pair
    sure = np.flatnonzero(exchange.responsible[index[:, 0], index[:, 1]] > LIKELIER_THAN_NOT).tolist()
    table, value, spread = paths.rays.table, paths.prediction.value, paths.prediction.spread
    told = [
        (n, row) for n in sure if table[row := index[n, 0], BOUNCES] == 1 and pair[n, 3 + AOD] < UNMEASURED
    ]
    if not told:
        return state
    departures = state.surfaces.departures.copy()
    for n, row in told:  # a handful: quicker one by one
        std = math.sqrt(spread[row, AOD, AOD] + pair[n, 3 + AOD])
        missed = math.remainder(pair[n, AOD] - value[row, AOD], math.tau) / std
        missed = min(max(missed, -MOST_SURPRISED), MOST_SURPRISED)
        departures[table[row, LAST]] += std**-2, missed / std
    return replace(state, surfaces=replace(state.surfaces, departures=departures))


def no_mirrors(bank: SurfaceBank) -> NDArray[np.bool_]:
    """Which surfaces send paths elsewhere than a mirror does, (S,) bool; (M517)."""
    weight, missed = bank.departures.T
    return missed**2 > SURE**2 * (weight + SYSTEMATIC_RAD**2 * weight**2)


def drop_no_mirrors(state: State, model: FilterModel) -> State:
    """The state without them; where their paths arrive from is kept, for births there to be doubted."""
    bank = state.surfaces
    wrong = no_mirrors(bank)
    if not wrong.any():
        return state
    images = [
        [anchor, *mirror(state.belief.lines[row], model.places[anchor, :2])]
        for row in np.flatnonzero(wrong)
        for anchor in np.flatnonzero(bank.single[: model.senders, row] > LIKELIER_THAN_NOT)
    ]
    corners = np.concatenate([state.corners, np.reshape(images, (-1, 3))])[-MOST_CORNERS:]
    existence = np.where(wrong, 0.0, bank.existence)
    return replace(state, corners=corners, surfaces=replace(bank, existence=existence))


def drop_shared_no_mirrors(state: NetworkState) -> NetworkState:
    """As `drop_no_mirrors`, of surfaces that all agents share; births there aren't doubted."""
    wrong = no_mirrors(state.surfaces)
    if not wrong.any():
        return state
    existence = np.where(wrong, 0.0, state.surfaces.existence)
    return replace(state, surfaces=replace(state.surfaces, existence=existence))


def unweighed(state: State) -> State:
    """The state as if no departure had been weighed: its agent was elsewhere than believed."""
    return replace(state, corners=state.corners[:0], surfaces=unweighed_bank(state.surfaces))


def unweighed_bank(bank: SurfaceBank) -> SurfaceBank:
    """The surfaces of such a state."""
    return replace(bank, departures=np.zeros_like(bank.departures))
