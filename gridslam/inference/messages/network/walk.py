"""How far clocks walk: what a scene says, or less if they are moved by less; docs/model.md, (M331)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.state.network.clock_walk import SHARES, WAYS, ClockWalk, ways_of
from gridslam.inference.state.network.state import NetworkState
from gridslam.world.network_model import NetworkModel

FORGETTING = 0.998
"""Share of the older evidence that counts after a step: clocks may walk otherwise than 500 steps ago."""
UNEXPLAINED = 25.0
"""Squares, in those that the widest walk expects, from which on a clock jumped, or was set again."""
FIRST_STEP = 10
"""From which on it is learned: before, clocks are moved by what was unknown of them, not by their walk."""
LEAST_GAIN = 1e-9
"""Share of the variance that a step takes away if it says anything of the clocks."""


def walk_covariance(state: NetworkState, model: NetworkModel) -> Array:
    """By how much clocks walk in a second, (D, D) m^2; those that are known don't. (M331)."""
    most, free = model.clocks.walk_m**2, ~model.clocks.known
    if state.walks is None:
        return np.asarray(most * np.diag(free.astype(np.float64)))
    ways = ways_of(model.clocks.anchors, free, common=True)
    return np.asarray(most * np.einsum("w,wij->ij", state.walks.share, ways))


def learn_walk(predicted: NetworkState, state: NetworkState, model: NetworkModel) -> NetworkState:
    """The state after a step with the clocks' walk judged by where the step has moved them; (M331).

    Small filters of the clocks alone, each with another walk, hear what the step has implied of them, and are
    weighed by how well they expected it. What counts are the anchors' clocks and those of agents that are
    there and not lost. Nothing is learned while a clock is searched for, and of clocks with rates.

    Parameters
    ----------
    predicted : NetworkState
        At the same time, before what was heard.
    """
    present = _clocks_that_tell(predicted, state, model)
    if present is None or state.time_s is None:
        return state
    old, free, fixed = state.walks, present & ~model.clocks.known, present & model.clocks.known
    implied = _implied(predicted, state, ways_of(model.clocks.anchors, free, common=bool(fixed.any())))
    if old is None or (old.free != free).any():
        return replace(state, walks=_started(old, implied, free, state.time_s))
    most = model.clocks.walk_m**2 * max(state.time_s - old.time_s, 0.0)
    surprise = implied.value[:, None] - old.mean
    ahead = old.variance + most * SHARES
    expected = ahead + implied.noise[:, None]
    squares = (surprise**2).sum(2) / expected
    if (squares[:, -1] > UNEXPLAINED * implied.directions).any():
        return replace(state, walks=_started(old, implied, free, state.time_s))
    gain = ahead / expected
    log = FORGETTING * old.log
    new = np.isfinite(implied.noise)
    log[new] -= 0.5 * (squares[new] + implied.directions[new, None] * np.log(expected[new]))
    walks = ClockWalk(
        log - log.max(1, keepdims=True), old.mean + gain[..., None] * surprise, (1 - gain) * ahead, free,
        state.time_s,
    )  # fmt: skip
    return replace(state, walks=walks)


class _Implied(NamedTuple):
    """What a step has implied of the clocks in each of W ways, as if they had been measured.

    Attributes
    ----------
    value : (W, D) m
    noise : (W,) m^2
        Infinite where it has implied nothing.
    directions : (W,)
        Of the way.
    mean, variance : (W, D), (W,)
        What is believed after it.
    """

    value: Array
    noise: Array
    directions: Array
    mean: Array
    variance: Array


def _implied(predicted: NetworkState, state: NetworkState, ways: Array) -> _Implied:
    """Measurements of the clocks that would have moved the belief as the step has.

    Their variances are ``1 / noise = 1 / after - 1 / before``.
    """
    own, count = state.belief.layout.devices, np.round(np.trace(ways, axis1=1, axis2=2))
    size = np.maximum(count, 1.0)
    before, after = (
        np.einsum("wij,ji->w", ways, one.covariance[np.ix_(own, own)]) / size
        for one in (predicted.belief, state.belief)
    )
    centre, mean = ways @ predicted.belief.mean[own], ways @ state.belief.mean[own]
    new = (count > 0) & (before - after > LEAST_GAIN * before)
    gain = np.where(new, 1 - after / np.where(new, before, 1.0), 1.0)
    value = centre + (mean - centre) / gain[:, None]
    return _Implied(value, np.where(new, after / gain, np.inf), count, mean, after)


def _clocks_that_tell(
    predicted: NetworkState, state: NetworkState, model: NetworkModel
) -> NDArray[np.bool_] | None:
    """Of whose clocks a step tells, (D,); None where it says nothing of how far clocks walk."""
    clocks, belief = model.clocks, state.belief
    astray = np.array([record.monitor.astray for record in state.records])
    agents = state.here & ~astray
    if not belief.clocks or belief.rates or state.step < FIRST_STEP or not clocks.walk_m > 0:
        return None
    if (predicted.clocks.searched | state.clocks.searched).any() or not agents.any():
        return None
    return np.append(np.ones(clocks.anchors, bool), agents)


def _started(old: ClockWalk | None, implied: _Implied, free: NDArray[np.bool_], time_s: float) -> ClockWalk:
    """Filters that start at what is believed now; what was learned of the walk is kept."""
    walks = len(SHARES)
    mean = np.repeat(implied.mean[:, None], walks, 1)
    variance = np.repeat(implied.variance[:, None], walks, 1)
    log = np.zeros((WAYS, walks)) if old is None else old.log
    return ClockWalk(log, mean, variance, free, time_s)
