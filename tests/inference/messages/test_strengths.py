"""What amplitudes say of lengths where clocks don't: some is left open, and loud lines of sight tell."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of

import gridslam as gs
from gridslam import reference
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.strengths import correct_by_strengths
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.rays import Rays
from gridslam.kernels.primitives import tables


def test_length_given_a_distance_by_hand():
    # a length of 1.34 known to 0.3, a clock to 0.5; a distance 0.16 shorter than predicted, variance 0.02:
    # of 0.34 + 0.02 the length has 0.09, so a quarter of the gap is its own, and 0.09 - 0.25 * 0.09 is left
    predicted = np.zeros((1, 15))
    predicted[0, [0, 3, 12, 13, 14]] = -25.76, 0.34, 1.34, 0.09, 0.09
    ((length, share),) = reference.length_given(predicted, -25.92, np.array([0.02]))
    assert length == pytest.approx(1.30)
    assert share == pytest.approx(np.sqrt(0.0675) / 1.30)
    predicted[0, 13:] = 0.34  # with known clocks the distance tells all
    np.testing.assert_allclose(reference.length_given(predicted, -25.92, np.array([0.02])), [[1.18, 0.0]])


def test_amplitude_of_an_open_length_by_hand():
    # 60 where 40 is expected to a fifth: 0.5 + 40^2 / (4 * 100) + 0.2^2 * 60 * 40 = 100.5, and I_0(x) e^-x
    # of x = 23.9 is 0.0820
    log = reference.log_rician(60.0, np.array(40.0), 100.0, 0.2)
    assert log == pytest.approx(np.log(60 / 100.5) - 20**2 / 201 + np.log(0.0820), abs=2e-3)


def heard(amplitude, place=(1.3, 0.0), std=0.3, responsible=0.9, clocks=1, height=0.0, weakened=False):
    """Belief after one line of sight of an anchor at the origin, so loud, was taken in."""
    model = model_of(anchors=[[0.0, 0.0, 0.0, height]])
    model = replace(model, radio=replace(model.radio, amplitude_at_1m=50.0, samples=100.0, threshold=2.0))
    mean = np.concatenate([place, np.zeros(3 + clocks)])
    covariance = np.diag([std**2, std**2, 0.01, 0.01, 0.01, *[0.25] * clocks])
    if clocks:  # the clock was set by the agent
        covariance[0, 5] = covariance[5, 0] = -(std**2)
    state = state_of(Belief(mean, covariance, clocks), 1)
    value, given = np.array([[9.0, 0.0, 0.0]]), np.full((1, 3), np.nan)
    scan = AnchorScan.of(0, np.zeros(2), 0.0, value, given, np.array([amplitude]))
    message = np.zeros((5, 1, 1))
    message[tables.RESPONSIBLE] = responsible
    rays = Rays(np.array([[0, -1, -1, 0]], np.int32), np.ones(1), np.ones(1), (0, 1))
    measured, odds = np.zeros((tables.MEASURED_ROWS, 1)), np.zeros((tables.ODDS, 1))
    exchange = Exchange(0, rays, odds, message, measured, np.zeros((1, 9)), 8, np.zeros((0, 2)))
    return state.belief, correct_by_strengths(state, scan, exchange, model.radio, model, weakened).belief


def test_a_loud_line_of_sight_tells_how_far_away_its_anchor_is_by_hand():
    # 62.5 of 50 at 1 m: 0.8 m, but for what noise adds; to sqrt(1 / 400 + 0.12^2) of it, 0.104 m
    before, after = heard(np.sqrt((62.5**2 + 0.5) / (1 - 0.25 / 100)))
    variance = 0.8**2 * (0.5 / 62.5**2 + 1 / 400 + 0.12**2)
    gain = 0.09 / (0.09 + variance)
    np.testing.assert_allclose(after.mean[:2], [1.3 - gain * 0.5, 0.0])
    assert after.mean[5] == pytest.approx(gain * 0.5)  # what the agent is nearer, the clock is later
    assert after.covariance[0, 0] == pytest.approx(0.09 * (1 - gain))
    assert after.covariance[1, 1] == before.covariance[1, 1]  # across, nothing


@pytest.mark.parametrize(
    "case",
    [
        {"clocks": 0},  # the distance tells it
        {"amplitude": np.nan},
        {"amplitude": 3.9},  # detection biases it
        {"responsible": 0.5},
        {"std": 0.05},  # known better
        {"amplitude": 10.0},  # 5 m: something weakens it
        {"amplitude": 30.0, "weakened": True},  # 1.67 m: something may
    ],
)
def test_nothing_is_told(case):
    before, after = heard(**{"amplitude": 62.5} | case)
    np.testing.assert_array_equal(after.mean, before.mean)
    np.testing.assert_array_equal(after.covariance, before.covariance)


def test_a_place_on_a_ring_is_not_corrected_along_one_direction():
    """Known to 0.3 m across, too, a length of 0.8 m is bent by 0.06 m, as much as half of 0.104 m."""
    _, narrow = heard(62.5, place=(0.7, 0.0), std=0.26)
    before, wide = heard(62.5, place=(0.7, 0.0), std=0.3)
    assert narrow.mean[0] != 0.7
    np.testing.assert_array_equal(wide.mean, before.mean)


def test_nothing_makes_a_line_of_sight_louder():
    _, free = heard(62.5)
    _, after = heard(62.5, weakened=True)
    np.testing.assert_array_equal(after.mean, free.mean)
    assert heard(30.0)[1].mean[0] > 1.5


def test_length_is_that_of_the_slanted_path():
    _, level = heard(62.5, place=(0.6, 0.0), std=0.2, height=0.53)
    assert abs(level.mean[0] - 0.6) < 0.01  # sqrt(0.6^2 + 0.53^2) = 0.8


@pytest.mark.slow
def test_agents_beside_an_anchor_whose_clock_nobody_set_know_where_they_are_at_once():
    room = gs.Scene.load("room").model_dump(exclude_none=True)
    room["filter"]["particles"] = 1000
    room["clocks"] = {"anchor_prior_ns": 100.0, "agent_prior_ns": 1.75, "walk_ns": 0.05}
    room["radio"] |= {"window_m": (-45.0, 95.0), "max_distance_m": 95.0}
    room["anchors"] = [room["anchors"][0] | {"position_m": (-1.7, 0.3), "clock": {"offset_ns": -89.0}}]
    agent = room["agents"][0] | {"start_m": (-1.9, -0.5), "waypoints_m": ((-1.9, 2.0),), "steps": 40}
    agent["prior"] = agent.get("prior", {}) | {"position_m": 0.5}
    room["agents"] = [agent | {"start_heading_deg": 90.0}]
    scene, squared, off, called = gs.Scene.checked(room, "room"), [], [], 0
    name = scene.agents[0].name
    for seed in range(6):
        heard_by_all = gs.simulate(scene, [name], seed, unlabelled=True)
        whole = gs.map_network(scene, heard_by_all, method="network_grid", seed=seed, starts="drawn")
        run = whole.runs[name]
        error = run.trajectory.position_m[:, :2] - scene.track(name).position_m[:, :2]
        inverse = np.linalg.inv(run.covariance[:, :2, :2])
        squared.append(np.einsum("ni,nij,nj->n", error, inverse, error))
        off.append(np.hypot(*error.T))
        called += sum(not estimate.health.ok for estimate in run.estimates)
    off = np.array(off)
    assert np.sqrt(np.mean(off[:, 0] ** 2)) < 0.2  # of half a metre; 0.4 by the distance alone
    assert off[:, 10:].max() < 0.15
    assert np.mean(squared) < 2.5
    assert called == 0
