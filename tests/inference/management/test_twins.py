"""Two hypotheses that nothing can tell apart: a room that looks alike from both ends, and turned samples."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from filter_states import state_of
from hypothesis import given, settings
from hypothesis import strategies as st

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.particles import Particles
from gridslam.inference.state.population import Population
from gridslam.systems.adaptive import AdaptiveSlam
from gridslam.systems.grid import GridSlam
from gridslam.world.geometry import wrap

LIMITED = Particles(128, seed=1)
LIMITED.limit = 64


def turned(state, angle):
    """The state in a world turned about the origin."""
    belief, lines = state.belief, state.belief.layout.angles
    turn = np.eye(len(belief.mean))
    for first in (0, 2):
        turn[first : first + 2, first : first + 2] = [
            [np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)],
        ]  # fmt: skip
    mean = turn @ belief.mean
    mean[4], mean[lines] = wrap(mean[4] + angle), wrap(mean[lines] + angle)
    return replace(state, belief=replace(belief, mean=mean, covariance=turn @ belief.covariance @ turn.T))


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.floats(-3.1, 3.1))
@settings(max_examples=40, deadline=None)
def test_samples_of_several_hypotheses_turn_with_the_agent(seed, angle):
    draw = np.random.default_rng(seed)
    root = draw.normal(size=(9, 9))
    state = state_of(Belief(draw.normal(size=9), root @ root.T + 1e-3 * np.eye(9)))
    found = []
    for each in (state, turned(state, angle)):
        points = LIMITED.points(each.belief)
        assert points.shape[1] == 64
        plain = Particles(128, seed=1).points(each.belief)[:, :64]
        for first in (0, 2):  # turned, and nothing else
            np.testing.assert_allclose(*(np.hypot(*p[first : first + 2]) for p in (points, plain)), rtol=1e-5)
        np.testing.assert_array_equal(points[4:9], plain[4:9])
        found.append(each.belief.root @ points[:9])
    cosine, sine = np.cos(angle), np.sin(angle)
    for first in (0, 2):
        x, y = found[0][first : first + 2]
        np.testing.assert_allclose(
            found[1][first : first + 2], [cosine * x - sine * y, sine * x + cosine * y], atol=1e-4
        )
    np.testing.assert_allclose(found[1][4:], found[0][4:], atol=1e-4)


def test_one_hypothesis_draws_by_the_points_as_they_are_and_a_singular_one_too():
    particles, belief = Particles(64, seed=1), Belief(np.zeros(5), np.eye(5))
    whole = particles.points(belief)
    assert particles.points(replace(belief, mean=np.ones(5))) is whole
    particles.limit = 64
    sure = Belief(np.ones(5), np.zeros((5, 5)))
    np.testing.assert_array_equal(particles.points(sure), whole)


@pytest.fixture(scope="module")
def alike():
    """A room with one anchor in its middle that tells no angle of departure: half a turn changes nothing."""
    data = tomllib.loads(gs.Scene.load("room").to_toml())
    data["grid"] = {"x_m": [-4.5, 4.5], "y_m": [-3.5, 3.5], "cell_m": 0.1}
    corners = [[-4, -3], [4, -3], [4, 3], [-4, 3]]
    data["walls"] = [{"material": "concrete", "points_m": corners, "closed": True}]
    data["anchors"] = [{**data["anchors"][0], "position_m": [0.0, 0.0]}]
    data["radio"]["measures"] = ["distance", "aoa", "amplitude"]
    track = {"start_m": [1.5, -1.0], "start_heading_deg": 58.0, "steps": 16}
    track["waypoints_m"] = [[2.5, 0.6], [1.0, 1.6], [-1.4, 1.2], [-2.0, -1.0]]
    data["agents"] = [{**data["agents"][0], **track}]
    return gs.Scene.from_toml(tomli_w.dumps(data), "alike").with_filter(particles=512)


@pytest.mark.slow
@pytest.mark.parametrize("system", [GridSlam, AdaptiveSlam])
def test_two_poses_that_nothing_tells_apart_stay_at_equal_weight(system, alike):
    slam = system(alike, seed=1)
    twin = turned(slam.state, np.pi)
    slam.now = slam.now._replace(believed=Population((slam.state, twin), (np.log(0.5),) * 2, since=0))
    for scan in gs.simulate(alike, "agent1", seed=1):
        slam.step(scan)
        one, other = slam.population.log_weight[:2]
        assert abs(one - other) < 0.05
    here, there = slam.population.states[:2]
    assert np.linalg.norm(here.belief.mean[:2] + there.belief.mean[:2]) < 1e-3
    assert len(here.surfaces) >= 4
