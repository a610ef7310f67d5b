"""The joint belief of several agents: views of one agent lose nothing, and clocks move as they should."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gridslam as gs
from gridslam.inference.beliefs.belief import append, give_birth, update
from gridslam.inference.state.network.belief import Loose, NetworkBelief, predict_network
from gridslam.world.clocks import ClockModel
from gridslam.world.network_scene import network_model


def joint(seed, agents=3, anchors=2, surfaces=2, rates=0):
    draw = np.random.default_rng(seed)
    size = agents * 6 + anchors + rates + 2 * surfaces
    root = draw.normal(size=(size, size)) * draw.uniform(0.01, 3, size)[:, None]
    return NetworkBelief(draw.normal(size=size), root @ root.T, anchors, agents, rates), draw


def updated(belief, jacobian, draw):
    """A moment-matched update with two rival measurements of three numbers."""
    return update(belief, jacobian, draw.normal(size=(2, 3)), np.full((2, 3), 0.04), np.array([0.5, 0.3]))


@given(seed=st.integers(0, 10_000), agent=st.integers(0, 2), rates=st.sampled_from([0, 5]))
@settings(max_examples=40, deadline=None)
def test_what_a_view_learns_is_what_the_joint_belief_would_have_learned(seed, agent, rates):
    whole, draw = joint(seed, rates=rates)
    rows = whole.projection(agent)
    slopes = draw.normal(size=(3, len(rows)))
    seen = updated(whole.view(agent), slopes, np.random.default_rng(seed))
    direct = updated(whole, slopes @ rows, np.random.default_rng(seed))
    absorbed = whole.updated(agent, seen)
    scale = np.sqrt(np.diag(whole.covariance))
    heading = whole.layout.pose(agent).start + 4
    off = absorbed.mean - direct.mean
    off[[4, heading]] = np.sin(off[[4, heading]])
    assert np.abs(off / scale).max() < 1e-9
    assert np.abs((absorbed.covariance - direct.covariance) / np.outer(scale, scale)).max() < 1e-9


def test_a_surface_born_in_a_view_is_correlated_with_all_that_bore_it():
    whole, draw = joint(3)
    rows = whole.projection(1)
    by_view, by_number = draw.normal(size=(2, len(rows))), draw.normal(size=(2, 2))
    line, noise = np.array([0.3, 2.0]), np.array([0.1, 0.2])
    absorbed = whole.updated(1, give_birth(whole.view(1), line, by_view, by_number, noise))
    direct = give_birth(whole, line, by_view @ rows, by_number, noise)
    np.testing.assert_allclose(absorbed.mean, direct.mean, atol=1e-12)
    np.testing.assert_allclose(absorbed.covariance, direct.covariance, atol=1e-9)


def test_singular_views_are_absorbed():
    """Where clocks are known, differences are certain: no number of the rest may explode."""
    scene = gs.Scene.load("exchange")
    model = network_model(scene, ["agent1", "agent2"])
    half = model.clocks.half_width_m.copy()
    half[[0, 4]] = 0.0  # of anchor A and of agent1
    belief = NetworkBelief.start(model.agents, replace(model.clocks, half_width_m=half))
    belief = append(belief, np.array([0.1, 4.0]), np.diag([1e-6, 1e-4]))
    slopes, draw = np.zeros((3, len(belief.projection(0)))), np.random.default_rng(1)
    slopes[:, :7] = draw.normal(size=(3, 7))
    after = belief.updated(0, updated(belief.view(0), slopes, draw))
    direct = updated(belief, slopes @ belief.projection(0), np.random.default_rng(1))
    assert np.isfinite(after.mean).all()
    assert np.linalg.eigvalsh(after.covariance).min() > -1e-9
    assert after.covariance[after.layout.devices[0], after.layout.devices[0]] == 0
    assert np.abs(after.covariance).max() <= np.abs(direct.covariance).max() * 1.01 + 400


def test_one_agent_of_known_clocks_is_its_own_view():
    model = network_model(gs.Scene.load("room"), ["agent1"])
    belief = NetworkBelief.start(model.agents, model.clocks)
    assert (belief.clocks, len(belief.mean)) == (0, 5)
    np.testing.assert_array_equal(belief.view(0).covariance, belief.covariance)
    np.testing.assert_array_equal(belief.updated(0, belief.view(0)).mean, belief.mean)


def test_what_all_clocks_have_in_common_moves_no_view():
    whole, _ = joint(5)
    moved = replace(whole, mean=whole.mean.copy())
    moved.mean[whole.layout.devices] += 7.0
    for agent in range(3):
        np.testing.assert_allclose(moved.view(agent).mean, whole.view(agent).mean, atol=1e-12)


def test_scalar_clock_is_a_kalman_filter_of_a_walk():
    """One anchor, pose known: textbook variances of the apparent bias."""
    clocks = ClockModel(1, 1, np.array([20.0, 0.0]), walk_m=0.5)
    model = network_model(gs.Scene.load("room"), ["agent1"])
    belief = NetworkBelief.start(model.agents, clocks)
    variance, noise, dt = 400 / 3, 0.09, 2.0
    slopes = np.zeros((1, 6))
    slopes[0, 5] = 1.0
    for _ in range(6):
        belief = predict_network(
            belief, dt, model.agents, clocks, np.zeros(1, bool), 0.0, np.zeros(0), np.ones((0, 2))
        )
        variance += 0.25 * dt
        seen = update(belief.view(0), slopes, np.zeros((1, 1)), np.full((1, 1), noise), np.ones(1))
        belief = belief.updated(0, seen)
        variance = variance * noise / (variance + noise)
        assert belief.clock_offsets()[1][0, 0] == pytest.approx(variance, rel=1e-9)


def test_clocks_with_rates_move_by_them():
    clocks = ClockModel(1, 1, np.array([9.0, 0.0]), walk_m=0.3, drift_m=0.2, drift_walk_m=0.1)
    model = network_model(gs.Scene.load("room"), ["agent1"])
    belief, dt = NetworkBelief.start(model.agents, clocks), 3.0
    clock, rate = belief.layout.devices[0], belief.layout.clock_rates.start
    belief.mean[rate] = 0.5
    after = predict_network(
        belief, dt, model.agents, clocks, np.ones(1, bool), 0.0, np.zeros(0), np.ones((0, 2))
    )
    assert after.mean[clock] == pytest.approx(1.5)
    own = np.ix_([clock, rate], [clock, rate])
    forward = np.array([[1, dt], [0, 1]])
    walk, drift = (
        0.09 * np.array([[dt, 0], [0, 0]]),
        0.01 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]),
    )
    expected = forward @ np.diag([27.0, 0.04]) @ forward.T + walk + drift
    np.testing.assert_allclose(after.covariance[own], expected, rtol=1e-12)
    known = belief.layout.devices[1]  # a known clock stays so
    assert after.covariance[known, known] == 0


@given(seed=st.integers(0, 10_000), agent=st.integers(0, 2))
@settings(max_examples=40, deadline=None)
def test_what_is_heard_of_an_open_clock_tells_nothing_of_anything_else(seed, agent):
    """The joint update by the rest of the view alone is what is left of it."""
    whole, draw = joint(seed)
    rows = whole.projection(agent)
    loose = Loose(np.array([6]), np.array([3.0]), np.array([70.0]))
    seen = whole.view(agent, loose)
    assert seen.covariance[6, 6] == 70
    assert not np.delete(seen.covariance[6], 6).any()
    slopes = draw.normal(size=(3, len(rows)))
    slopes[:, 6] = 0.0
    after = updated(seen, slopes, np.random.default_rng(seed))
    heard = after.covariance.copy()
    heard[6], heard[:, 6] = 0.0, 0.0  # distances over the open clock move its difference, and only that
    moved = replace(after, mean=after.mean + 9.0 * (np.arange(len(rows)) == 6), covariance=heard)
    absorbed = whole.updated(agent, moved, loose)
    direct = updated(whole, slopes @ rows, np.random.default_rng(seed))
    scale = np.sqrt(np.diag(whole.covariance))
    off = absorbed.mean - direct.mean
    headings = [whole.layout.pose(number).start + 4 for number in range(3)]
    off[headings] = np.sin(off[headings])
    assert np.abs(off / scale).max() < 1e-6
    assert np.abs((absorbed.covariance - direct.covariance) / np.outer(scale, scale)).max() < 1e-6


@given(seed=st.integers(0, 10_000), alone=st.booleans())
@settings(max_examples=30, deadline=None)
def test_a_measured_difference_of_clocks_is_the_textbook_s(seed, alone):
    whole, draw = joint(seed)
    plus, minus = whole.layout.devices[[1, 3]].tolist()
    slope = np.zeros(len(whole.mean))
    slope[plus], slope[minus] = 1.0, 0.0 if alone else -1.0
    offset, variance = draw.normal(), draw.uniform(0.1, 4)
    found = whole.measured(plus, None if alone else minus, offset, variance)
    gain = whole.covariance @ slope / (slope @ whole.covariance @ slope + variance)
    np.testing.assert_allclose(found.mean, whole.mean + gain * (offset - slope @ whole.mean))
    wanted = whole.covariance - np.outer(gain, slope @ whole.covariance)
    np.testing.assert_allclose(found.covariance, wanted, atol=1e-9 * np.abs(wanted).max())
