"""What rings tell of the agent before they join (M538), and where no path may be born a folding range on."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from delay_snapshots import BAND, received

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief, append
from gridslam.inference.messages.samples.distance_mode import PathPrior
from gridslam.inference.messages.samples.image_births import find_births
from gridslam.inference.messages.samples.ring_motion import tell_motion
from gridslam.inference.state.rings import rings_about
from gridslam.inference.state.samples.images import DirectState, Tentative
from gridslam.systems import direct

AGENT = np.diag([0.04, 0.09, 0.01, 0.02])


def with_rings(bearings, visible):
    """A state with a settled image and rings, each with hypotheses at some bearings (of 72) alone."""
    state = DirectState.start(np.array([3.0, 2.0, 0.05, 0.0]), np.diag(AGENT), 2, np.ones(2))
    belief = append(state.belief, np.array([0.3, 5.0]), 0.01 * np.eye(2))
    covariance = belief.covariance.copy()
    covariance[:2, 4:] = covariance[4:, :2] = 0.005  # what the image is told follows from the agent
    belief = replace(belief, covariance=covariance)
    count = len(bearings)
    weight = np.zeros((count, 72))
    for row, ones in enumerate(bearings):
        weight[row, ones] = 1 / len(ones)
    rings = rings_about(
        Belief(belief.mean, belief.covariance), 0, np.full(count, 6.0), np.full(count, 1e-4),
        np.full(count, 0.99), weight,
    )  # fmt: skip
    rings = replace(rings, age=np.full(count, 4))
    links = replace(state.links, visible=np.array(visible), intensity=np.full(2, 100.0))
    tentative = Tentative(rings, np.full(count, 100.0), np.full(count, 9.0))
    return replace(state, belief=belief, links=links, tentative=tentative)


def learned(state, slope, value, variance):
    """The same after each hypothesis has measured a linear form of its agent and image; they don't agree."""
    rings = state.tentative.rings
    mean, covariance = rings.mean.copy(), rings.covariance.copy()
    slope = np.asarray(slope, float)
    for row, k in np.argwhere(rings.weight > 0):
        cross = covariance[row, k] @ slope
        whole = slope @ cross + variance
        mean[row, k] += cross * (value if k < 36 else 0.2 * value) / whole
        covariance[row, k] -= np.outer(cross, cross) / whole
    return replace(
        state, tentative=replace(state.tentative, rings=replace(rings, mean=mean, covariance=covariance))
    )


def told(state, *measured):
    after = learned(state, *measured)
    count = len(state.tentative)
    return tell_motion(state, after, SimpleNamespace(tentative=np.arange(count))), after


VELOCITY = [0.0, 0.0, 1.0, 0.3, 0.0, 0.0]


@pytest.mark.parametrize("slope", [VELOCITY, [0.6, -0.8, 0.0, 0.0, 0.0, 0.0]])
def test_what_one_ring_knows_of_the_agent_is_told_whole(slope):
    state = with_rings([[4, 40]], [0.0, 0.0])
    after, ring = told(state, slope, 0.07, 0.003)
    mean, covariance = ring.tentative.rings.matched
    np.testing.assert_allclose(after.belief.mean[:4], mean[0, :4], atol=1e-9)
    np.testing.assert_allclose(after.belief.covariance[:4, :4], covariance[0, :4, :4], atol=1e-9)
    # the image hangs together with the agent's place
    moved = after.belief.mean[4:] - state.belief.mean[4:]
    lean = state.belief.covariance[4:, :4] @ np.linalg.inv(AGENT)
    np.testing.assert_allclose(moved, lean @ (after.belief.mean[:4] - state.belief.mean[:4]), atol=1e-9)


def test_several_rings_tell_no_more_than_one():
    information = {}
    for count, visible in ((1, 0.0), (3, 0.0), (3, 1.0)):
        state = with_rings([[4 + 9 * row] for row in range(count)], [1.0, visible])
        after, _ = told(state, VELOCITY, 0.05, 0.01)
        of_velocity = [np.linalg.inv(each.belief.covariance[2:4, 2:4]) for each in (state, after)]
        information[count, visible] = (of_velocity[1] - of_velocity[0])[0, 0]
    assert information[1, 0.0] == pytest.approx(100, rel=1e-6)
    assert information[3, 0.0] == pytest.approx(100, rel=1e-6)
    assert information[3, 1.0] == pytest.approx(100, rel=1e-6)


def test_the_place_is_told_by_several_rings_where_lines_of_sight_hold_it_alone():
    for visible, kept in ((0.0, True), (1.0, False)):
        state = with_rings([[4], [20]], [1.0, visible])
        after, _ = told(state, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.05, 0.01)
        assert np.array_equal(after.belief.covariance, state.belief.covariance) == kept


def test_doubtful_and_new_rings_tell_nothing_and_all_others_follow():
    state = with_rings([[4], [20], [50]], [1.0, 1.0])
    rings = replace(state.tentative.rings, existence=np.array([0.99, 0.9, 0.99]), age=np.array([4, 4, 0]))
    state = replace(state, tentative=replace(state.tentative, rings=rings))
    after, ring = told(state, VELOCITY, 0.05, 0.01)
    gained = np.linalg.inv(after.belief.covariance[2:4, 2:4]) - np.linalg.inv(AGENT[2:, 2:])
    assert gained[0, 0] == pytest.approx(100, rel=1e-6)  # of one ring
    was, now = ring.tentative.rings.covariance, after.tentative.rings.covariance
    np.testing.assert_array_equal(now[0, 4], was[0, 4])  # its own knowledge isn't told it once more
    assert now[1, 20, 2, 2] < 0.95 * was[1, 20, 2, 2]
    assert now[2, 50, 2, 2] < 0.95 * was[2, 50, 2, 2]


@pytest.mark.parametrize("short", [0.2, 0.4, 0.6])
def test_a_line_of_sight_shorter_than_predicted_is_no_image_a_folding_range_on(short):
    """A start known to 0.3 m: what arrives in front of the prediction folds back to where images may be."""
    rng, sight = np.random.default_rng(3), 2.4
    distance, amplitude = np.array([sight, sight + 1.3, sight + 1.6]), 10 ** (np.array([32, 23, 20]) / 20)
    samples = received(rng, distance, amplitude * np.exp([1j, 2j, 0.3j]))
    prior = PathPrior(np.array([sight + short]), np.array([[0.3**-2]]), np.array([1000.0]))
    found = find_births(BAND, samples, prior, 1.0, 0.5, first=True)
    assert all(new.distance < sight + BAND.folding_m - 1 for new in found.new)
    assert found.mode.distance[0] == pytest.approx(sight, abs=0.1)


@pytest.mark.slow
def test_an_agent_that_crosses_the_line_through_two_anchors_knows_that_it_goes_on(monkeypatch):
    """Lines of sight say nothing across that line; rings, none of which has joined yet, tell of it."""
    scene = gs.Scene.checked(
        {
            "name": "crossing",
            "radio": {"frequencies": 41, "frequency_step_hz": 1e7, "fading": "steady", "snr_at_1m_db": 40.0,
                      "array": {"rows": 1, "columns": 1}},
            "grid": {"x_m": [-1.0, 10.0], "y_m": [-1.0, 8.0], "cell_m": 0.1},
            "materials": {"concrete": 0.7},
            "anchors": [{"name": "A", "position_m": [2.0, 3.6]}, {"name": "B", "position_m": [7.5, 3.2]}],
            "walls": [{"name": "room", "material": "concrete",
                       "points_m": [[0.0, 0.0], [9.0, 0.0], [9.0, 7.0], [0.0, 7.0], [0.0, 0.0]]}],
            "agents": [{"name": "agent1", "start_m": [4.0, 1.4], "start_heading_deg": 70.0,
                        "waypoints_m": [[5.2, 5.8]], "step_m": 0.05, "steps": 50}],
        },
        "crossing",
    )  # fmt: skip
    track = scene.track("agent1").position_m[:, :2]
    heard, wide = gs.simulate(scene, "agent1", 0, what="signal"), []
    for _ in range(2):
        run = gs.map_scene(scene, heard, method="direct", seed=0)
        wide.append(np.sqrt(np.linalg.eigvalsh(run.covariance[30:, :2, :2])[:, 1]).max())
        assert np.hypot(*(run.trajectory.position_m[30:] - track[30:]).T).max() < 0.2
        monkeypatch.setattr(direct, "tell_motion", lambda before, state, paths: state)
    assert wide[0] < 0.9 * wide[1]
