"""Agents that may be anywhere: of which so long nothing was heard that nothing is left of where they were."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import AGENT, HEADING
from gridslam.inference.state.network.belief import NetworkBelief
from gridslam.world.filter_model import FilterModel

FARTHER, BLIND = 10.0, 1e4
"""Spread of a position, in diagonals of the region, beyond which it says nothing of a place in there; of
radios that measure no angles, with which an agent isn't found anew: as far as covariances stay sound."""

Joint = TypeVar("Joint", Belief, NetworkBelief)


def anywhere(belief: Joint, model: FilterModel, agent: int = 0) -> Joint:
    """The belief; with an agent anywhere in the region, linked with nothing, if it says no more: (M570).

    As fast as it started or as it was, and turned anyhow. The motion of (M16), left to itself, spreads by the
    square of time: after a day covariances hold nothing else.
    """
    own = belief.layout.pose(agent)
    side = np.array(model.grid.shape[::-1]) * model.grid.cell_m
    most = FARTHER if {"aod", "aoa"} & set(model.radio.measures) else BLIND
    if np.trace(belief.covariance[own, own][:2, :2]) < most**2 * (side @ side):
        return belief
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    place, speed = slice(own.start, own.start + 2), slice(own.start + 2, own.start + 4)
    variance = np.empty(AGENT)
    variance[:2] = side**2 / 12
    variance[2:4] = model.start_variance[2:4] + mean[speed] ** 2
    variance[HEADING] = np.pi**2 / 3
    mean[place], mean[speed] = model.middle, 0.0
    covariance[own], covariance[:, own] = 0.0, 0.0
    covariance[own, own] = np.diag(variance)
    return replace(belief, mean=mean, covariance=covariance)
