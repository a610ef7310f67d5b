"""How far clocks walk: what a scene says, or less if they are moved by less; docs/model.md, (M331)."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.state.network.state import NetworkState
from gridslam.world.clocks import ClockModel
from gridslam.world.network_model import NetworkModel

GAIN = 0.025
"""Of the logarithm by a step, for each clock beyond the first: one step tells that little."""
LEAST_SHARE = 1e-3
"""Of the variance that the scene tells: a walk of 3 % of its own."""
MOST_SURPRISED = 5.0
"""What one step may say at most, in expected squares."""
FIRST_STEP = 10
"""From which on it is learned: before, clocks are moved by what was unknown of them, not by their walk."""


def walking(clocks: ClockModel, share: float) -> ClockModel:
    """Clocks whose walk has a share of the variance that the scene tells."""
    return clocks if share == 1.0 else replace(clocks, walk_m=float(clocks.walk_m * np.sqrt(share)))


def learn_walk(predicted: NetworkState, state: NetworkState, model: NetworkModel) -> NetworkState:
    """The state after a step with the clocks' walk judged by how far the step has moved them; (M331).

    If they walk by less than they are taken to, corrections are smaller than the covariance says. What counts
    are the anchors' clocks and those of agents that are there and not lost. While a clock is searched for
    nothing is learned, and clocks with rates follow by these.

    Parameters
    ----------
    predicted : NetworkState
        At the same time, before what was heard.
    """
    before, after = predicted.belief, state.belief
    astray = np.array([record.monitor.astray for record in state.records])
    heard = np.append(np.ones(model.clocks.anchors, bool), state.here & ~astray)
    free = heard & ~model.clocks.known
    if not after.clocks or after.rates or state.step < FIRST_STEP or free.sum() < 2:
        return state
    if (predicted.clocks.unset | state.clocks.unset).any() or not heard[model.clocks.anchors :].any():
        return state
    own = before.layout.devices[free]
    moved = after.mean[own] - before.mean[own]
    gained = before.covariance[np.ix_(own, own)] - after.covariance[np.ix_(own, own)]
    count = len(moved)
    expected = float(np.trace(gained) - gained.sum() / count)  # without what all have in common
    if not expected > 0:
        return state
    surprise = float(moved @ moved - moved.sum() ** 2 / count) / expected - 1
    log = np.log(state.walk) + GAIN * (count - 1) * min(surprise, MOST_SURPRISED)
    return replace(state, walk=float(np.clip(np.exp(log), LEAST_SHARE, 1.0)))
