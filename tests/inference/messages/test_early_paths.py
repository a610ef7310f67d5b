"""Direct SLAM doubts a place from which a line of sight would be longer than what is heard of an anchor."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.health.signal_watch import EARLY
from gridslam.inference.messages.samples.early_paths import EVERY, watch_arrivals

OVERLAP = gs.Scene.load("overlap")
STEPS = 40 * EVERY


@pytest.fixture(scope="module")
def heard():
    recording = gs.simulate(OVERLAP, "agent1", seed=5, what="signal")
    return [recording.scan(step) for step in range(STEPS)]


def watched(heard, away_m):
    """What is known after some steps of an agent that is believed so much farther from the first anchor."""
    slam = gs.DirectSlam(OVERLAP, seed=5)
    state, anchor = slam.state, slam.model.anchors[0, :2]
    state = getattr(state, "best", state)
    for step, scan in enumerate(heard):
        place = OVERLAP.track("agent1").position_m[step]
        way = place - anchor
        mean = state.belief.mean.copy()
        mean[:2] = place + away_m * way / np.hypot(*way)
        covariance = 1e-4 * np.eye(len(mean))
        state = replace(state, belief=replace(state.belief, mean=mean, covariance=covariance), step=step)
        state = watch_arrivals(state, scan, slam.model)
    return state


def test_where_the_agent_is_nothing_arrives_too_early(heard):
    assert watched(heard, 0.0).watch.early < 0.2


def test_from_too_far_off_it_does_and_health_says_so(heard):
    state = watched(heard, 4.0)
    assert state.watch.early > EARLY
    said = state.watch.assess(0.01, 2)
    assert not said.ok
    assert "paths arrive before the line of sight" in said.why


def test_what_a_place_may_be_off_counts_for_nothing(heard):
    slam = gs.DirectSlam(OVERLAP, seed=5)
    state = getattr(slam.state, "best", slam.state)
    mean, wide = state.belief.mean.copy(), 4.0 * np.eye(len(state.belief.mean))
    mean[:2] = OVERLAP.track("agent1").position_m[0] + [2.0, 2.0]
    vague = replace(state, belief=replace(state.belief, mean=mean, covariance=wide))
    assert watch_arrivals(vague, heard[0], slam.model).watch.early == 0
    later = replace(vague, step=1)
    assert watch_arrivals(later, heard[1], slam.model) is later, "each third step is looked at"
