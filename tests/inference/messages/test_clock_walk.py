"""How far clocks walk, by how far steps move them: docs/model.md, (M331)."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.messages.network.walk import (
    FIRST_STEP,
    GAIN,
    LEAST_SHARE,
    MOST_SURPRISED,
    learn_walk,
    walking,
)
from gridslam.inference.state.network.state import NetworkState
from gridslam.world.clocks import NS
from gridslam.world.network_scene import network_model

AGENTS = ["agent1", "agent2", "agent3"]
FREE = 7


@pytest.fixture(scope="module")
def world():
    """Model and state of `exchange`, all clocks set."""
    model = network_model(gs.Scene.load("exchange"), AGENTS)
    state = NetworkState.start(model)
    clocks = replace(state.clocks, unset=np.zeros(4, bool))
    return model, replace(state, clocks=clocks, step=FIRST_STEP, here=np.ones(3, bool))


def with_clocks(state, mean, covariance):
    """The state with the clocks' mean (D,) and covariance (D, D)."""
    own, belief = state.belief.layout.devices, state.belief
    centre, whole = belief.mean.copy(), belief.covariance.copy()
    centre[own], whole[np.ix_(own, own)] = mean, covariance
    return replace(state, belief=replace(belief, mean=centre, covariance=whole))


def learned(world, moved, step=FIRST_STEP, walk=0.5, **changes):
    """Share of the walk after clocks of variance 2 were moved, and variance 1 is left."""
    model, state = world
    before = with_clocks(replace(state, walk=walk, step=step), np.zeros(FREE), 2 * np.eye(FREE))
    after = replace(with_clocks(before, moved, np.eye(FREE)), **changes)
    return learn_walk(before, after, model).walk


def test_clocks_that_are_moved_less_than_expected_walk_less(world):
    contrast = np.array([1.0, -1, 1, -1, 1, -1, 0])  # 6 squares: as many as the 6 that are expected
    assert learned(world, contrast) == pytest.approx(0.5)
    assert learned(world, 0 * contrast) == pytest.approx(0.5 * np.exp(-6 * GAIN))
    assert learned(world, np.sqrt(2) * contrast) == pytest.approx(0.5 * np.exp(6 * GAIN))
    assert learned(world, contrast + 30.0) == pytest.approx(0.5)  # what all have in common isn't observed
    most = 0.1 * np.exp(6 * GAIN * MOST_SURPRISED)
    assert learned(world, 100 * contrast, walk=0.1) == pytest.approx(most)
    assert learned(world, 100 * contrast, walk=0.9) == 1.0  # the scene says the most
    assert learned(world, 0 * contrast, walk=LEAST_SHARE) == LEAST_SHARE


def test_steps_that_say_nothing_of_the_walk_leave_it_alone(world):
    model, state = world
    open_one = replace(state.clocks, unset=np.array([False, True, False, False]))
    astray = replace(state.records[0], monitor=replace(state.records[0].monitor, lost=1))
    only_lost = np.append(np.zeros(4), [30.0, 0, 0])
    assert learned(world, np.zeros(FREE), step=FIRST_STEP - 1) == 0.5
    assert learned(world, np.zeros(FREE), clocks=open_one) == 0.5
    assert learned(world, np.zeros(FREE), records=(astray,) * 3) == 0.5
    others = learned(world, only_lost, records=(astray, *state.records[1:]))
    assert others == learned(world, only_lost, here=np.array([False, True, True]))
    assert others == pytest.approx(0.5 * np.exp(-5 * GAIN))  # one clock fewer, and where it went is no matter
    before = with_clocks(state, np.zeros(FREE), np.eye(FREE))  # nothing was heard
    assert learn_walk(before, before, model) is before


@pytest.mark.parametrize("true", [1.0, 0.3])
def test_the_walk_of_simulated_clocks_is_found(world, true):
    """Clocks alone, all pairs of anchors and agents measured at each step, by a textbook Kalman filter."""
    model, state = world
    told, noise, draw = model.clocks.walk_m, 3 * NS * 0.1, np.random.default_rng(5)
    rows = np.array([np.eye(FREE)[j] - np.eye(FREE)[i] for i in (4, 5, 6) for j in range(4)])
    offset, state = np.zeros(FREE), with_clocks(state, np.zeros(FREE), np.eye(FREE))
    own, shares = state.belief.layout.devices, []
    for _ in range(600):
        offset = offset + true * told * draw.standard_normal(FREE)
        mean, covariance = state.belief.mean[own], state.belief.covariance[np.ix_(own, own)]
        covariance = covariance + walking(model.clocks, state.walk).walk_m ** 2 * np.eye(FREE)
        before = with_clocks(state, mean, covariance)
        size = rows @ covariance @ rows.T + noise**2 * np.eye(len(rows))
        gain = np.linalg.solve(size, rows @ covariance).T
        heard = rows @ offset + noise * draw.standard_normal(len(rows))
        after = with_clocks(
            before, mean + gain @ (heard - rows @ mean), covariance - gain @ rows @ covariance
        )
        state = learn_walk(before, after, model)
        shares.append(state.walk)
    found = np.exp(np.log(shares[300:]).mean())
    assert found == pytest.approx(true**2, rel=0.25)
