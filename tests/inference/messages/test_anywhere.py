"""Agents of which nothing is left: anywhere in the region, and linked with nothing."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.anywhere import FARTHER, anywhere
from gridslam.inference.messages.motion import predict
from gridslam.inference.state.state import State

SCENE = gs.Scene.load("room")
MODEL = SCENE.filter_model("agent1")


def belief_of(spread_m):
    """An agent with one line, position known to so much, all correlated."""
    root = np.random.default_rng(3).normal(size=(7, 7))
    joint = root @ root.T
    scale = spread_m / np.sqrt(np.trace(joint[:2, :2]))
    size = np.array([scale, scale, 1, 1, 0.1, 0.1, 0.1])
    mean = np.array([1.0, 2, 0.3, -0.4, 0.5, 1.0, 4.0])
    return Belief(mean, joint * np.outer(size, size))


def test_a_place_that_may_be_far_beyond_the_region_is_anywhere_in_it():
    """By hand: a uniform region's variances, the start's speed and that of before, a uniform angle's."""
    side = np.array(MODEL.grid.shape[::-1]) * MODEL.grid.cell_m
    within, beyond = (belief_of(share * FARTHER * np.hypot(*side)) for share in (0.999, 1.001))
    assert anywhere(within, MODEL) is within
    after = anywhere(beyond, MODEL)
    np.testing.assert_allclose(after.mean[:5], [*MODEL.middle, 0, 0, 0.5])
    np.testing.assert_array_equal(after.mean[5:], beyond.mean[5:])
    own = np.array([*side**2 / 12, *np.add(MODEL.start_variance[2:4], [0.09, 0.16]), np.pi**2 / 3])
    np.testing.assert_allclose(after.covariance[:5, :5], np.diag(own))
    assert not after.covariance[:5, 5:].any()
    np.testing.assert_array_equal(after.covariance[5:, 5:], beyond.covariance[5:, 5:])


def test_steps_that_follow_one_another_change_nothing_of_it():
    state = replace(State.start(MODEL), time_s=0.0)
    after = predict(state, 1.0, 3, MODEL)
    assert after.belief.mean[0] == pytest.approx(state.belief.mean[0] + state.belief.mean[2])


@pytest.mark.parametrize("gap_s", [1e5, 1.8e9, 1e15])
def test_time_may_leap_as_far_as_it_likes(gap_s):
    """From boot to the clock of the net, and from there to nonsense: what is believed stays sound."""
    state = predict(replace(State.start(MODEL), time_s=0.0), gap_s, 0, MODEL)
    state = predict(state, 2 * gap_s, 0, MODEL)
    scale = np.sqrt(np.diag(state.belief.covariance))
    assert np.linalg.eigvalsh(state.belief.covariance / np.outer(scale, scale)).min() > 0.9
    np.testing.assert_allclose(state.belief.mean[:2], MODEL.middle)
