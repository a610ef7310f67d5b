"""Departures that may not be a mirror's: of surfaces that double bounces may have borne.

A double bounce arrives as if from a virtual anchor, and a surface is born that would put one there. But it
departs in another direction than a mirror's path. While clocks are known that shows at once; where they
aren't, pose, clock and surface yield to it together. docs/model.md, (M461). Beside it, what anchors with open
clocks may not correct, (M496).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import replace
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.network.clock_setting import SURE_RAY, WITNESSES
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.kernels import UNMEASURED
from gridslam.kernels.primitives.tables import AOD, DENSITY, PATH_ROW, VARIANCE
from gridslam.world.filter_model import FilterModel

PROVEN = 10
"""Detections from which on a surface that one anchor alone shows is taken for a wall."""


def without_doubtful_departures(
    ratios: LikelihoodRatios, rays: Rays, state: State, model: FilterModel
) -> LikelihoodRatios:
    """The ratios, with the departures of single bounces that may be double ones left out of what corrects.

    What they say of which measurement is whose stays. Where clocks are known, or no path bounces twice,
    the ratios stay the same object.

    Parameters
    ----------
    rays : Rays
        The paths (L,) of the ratios, over the surfaces of `state`.
    """
    if not (state.belief.clocks and model.max_bounces > 1 and len(state.surfaces)):
        return ratios
    doubtful = np.append(unproven(state.surfaces), False)[rays.last] & (rays.bounces == 1)
    rows = np.flatnonzero(doubtful[ratios.pairs.index[: len(ratios.pairs), PATH_ROW]])
    if not len(rows):
        return ratios
    pair = ratios.pairs.pair.copy()
    pair[rows, VARIANCE + AOD] = UNMEASURED
    return replace(ratios, pairs=replace(ratios.pairs, pair=pair))


def unproven(bank: SurfaceBank) -> NDArray[np.bool_]:
    """Which surfaces (S,) may be images of double bounces: young ones that one anchor alone shows."""
    return np.asarray(((bank.single > SURE_RAY).sum(0) < WITNESSES) & (bank.seen < PROVEN))


def without_open_clocks(
    ratios: LikelihoodRatios, rays: Rays, network: NetworkState, agent: int
) -> LikelihoodRatios:
    """The ratios, with nothing that corrects of anchors whose clocks are open where agents' are wide, (M496).

    While no clock is known, angles alone choose what a line of sight's measurement is, and may choose a
    reflection, which then stands for itself when the clock is set. What the ratios say of which measurement
    is whose stays.
    """
    if not network.clocks.framed:
        return ratios
    rows = np.flatnonzero(
        network.clocks.open_to(agent)[rays.anchor][ratios.pairs.index[: len(ratios.pairs), PATH_ROW]]
    )
    if not len(rows):
        return ratios
    pair = ratios.pairs.pair.copy()
    pair[rows, VARIANCE:DENSITY] = UNMEASURED
    return replace(ratios, pairs=replace(ratios.pairs, pair=pair))
