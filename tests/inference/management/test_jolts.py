"""Steps with a jolt: evidence against densities, what is tried, and robots on sharp bends followed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scene_samples import short
from scipy.stats import multivariate_normal, norm

import gridslam as gs
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.health.monitor import SWAMPED
from gridslam.inference.management import hypotheses, jolts
from gridslam.inference.messages.motion import predict_agent
from gridslam.inference.state.state import State
from gridslam.world import waypoints


@pytest.fixture(scope="module")
def robot():
    """The room, with a robot of 0.3 m a step that turns on 0.6 m at its corners."""
    scene = gs.Scene.load("room").with_filter(particles=256)
    way = ((1.5, -1.4), (1.5, 1.4), (-1.5, 1.4), (-1.5, -1.0), (1.5, -1.0), (1.5, 1.0), (-1.0, 1.0))
    agent = scene.agents[0].model_copy(
        update={"waypoints_m": way, "step_m": 0.3, "acceleration_mps2": 0.15, "steps": None}
    )
    return scene.model_copy(update={"agents": (agent,)})


@pytest.fixture
def sharp_bends(monkeypatch):
    """Corners are rounded as sharply as the robot can."""
    monkeypatch.setattr(waypoints, "TURN_STEPS", 2)
    monkeypatch.setattr(waypoints, "TIGHTEST_STEPS", 1)


@given(st.floats(-5, 5), st.floats(0.01, 4), st.floats(0.01, 4), st.floats(0.05, 2))
def test_of_a_heading_it_is_the_ratio_of_two_normal_densities(error, predicted, noise, told):
    total = predicted + noise
    log = jolts.evidence(np.array([error / total]), np.array([[1 / total]]), told)
    wider = np.sqrt(total + (jolts.FACTORS**2 - 1) * told**2)
    want = norm.logpdf(error, 0, wider) - norm.logpdf(error, 0, np.sqrt(total))
    np.testing.assert_allclose(log, want, rtol=1e-9, atol=1e-9)


@given(st.integers(0, 10**6), st.integers(1, 2), st.floats(0.01, 100))
def test_no_factor_explains_more_than_is_said_without_trying_any(seed, size, told):
    """Else a jolt that a step shows would pass unseen."""
    draw = np.random.default_rng(seed)
    root = draw.normal(size=(size, size))
    score, information = draw.normal(0, 3, size), root @ root.T
    most = jolts.explained_at_most(score, information)
    log = jolts.evidence(score, information, told)
    assert log.max() <= most + 1e-6
    likeliest = jolts.FACTORS[log.argmax()] if log.max() > jolts.LIKELIER else 1.0
    assert jolts._factor(score, information, told) == likeliest


def test_where_a_step_tells_nothing_in_some_direction_every_factor_is_tried():
    nothing = np.zeros((1, 1)), np.zeros((2, 2)), np.ones((2, 2)), -np.eye(2), np.diag([np.nan, 1])
    for information in nothing:
        assert jolts.explained_at_most(np.ones(len(information)), information) == np.inf


@pytest.mark.parametrize("seed", range(5))
def test_of_a_step_it_is_what_filters_with_wider_noise_make_of_its_measurement(robot, seed):
    draw, model = np.random.default_rng(seed), robot.filter_model("agent1")
    root = draw.normal(size=(5, 5))
    before = State.start(model)
    before = replace(
        before, time_s=0.0, belief=replace(before.belief, covariance=0.01 * root @ root.T + 1e-4 * np.eye(5))
    )
    seen, noise, off = draw.normal(size=(3, 5)), 0.01 * np.eye(3), draw.normal(size=3)

    def density(factor):
        settings = jolts.Jolt(factor, 1.0).allowed(model).settings
        spread = seen @ predict_agent(before.belief, 2.0, settings).covariance @ seen.T + noise
        return multivariate_normal.logpdf(off, np.zeros(3), spread)

    predicted = predict_agent(before.belief, 2.0, model.settings)
    gain = predicted.covariance @ seen.T @ np.linalg.inv(seen @ predicted.covariance @ seen.T + noise)
    after = replace(
        before, time_s=2.0,
        belief=replace(
            predicted, mean=predicted.mean + gain @ off,
            covariance=predicted.covariance - gain @ seen @ predicted.covariance,
        ),
    )  # fmt: skip
    want = np.array([density(factor) for factor in jolts.FACTORS])
    best = jolts.FACTORS[want.argmax()] if want.max() - want[0] > jolts.LIKELIER else 1.0
    assert jolts.likeliest(before, after, model).acceleration == pytest.approx(best)


def test_a_heading_that_is_corrected_by_much_is_a_jolt_of_the_heading_alone(robot):
    model = robot.filter_model("agent1")
    before = State.start(model)
    steady = replace(before.belief, covariance=1e-4 * np.eye(5))
    before = replace(before, time_s=0.0, belief=steady)
    after = replace(before, time_s=1.0, belief=predict_agent(steady, 1.0, model.settings))
    assert jolts.likeliest(before, after, model) == jolts.NONE
    mean, spread = after.belief.mean.copy(), after.belief.covariance.copy()
    mean[HEADING] -= np.radians(40) - 2 * np.pi  # a turn more or less is the same heading
    spread[HEADING, HEADING] = 1e-4
    turned = replace(after, belief=replace(after.belief, mean=mean, covariance=spread))
    push, swing = jolts.likeliest(before, turned, model)
    assert push == 1
    assert swing == pytest.approx(4 * np.sqrt(2))


def test_at_the_first_step_nothing_has_moved(robot):
    model = robot.filter_model("agent1")
    state = State.start(model)
    assert jolts.likeliest(state, replace(state, time_s=1.0), model) == jolts.NONE


@pytest.mark.slow
@pytest.mark.parametrize("method", ["grid", "adaptive"])
def test_a_robot_on_sharp_bends_is_followed_and_health_is_well(robot, sharp_bends, monkeypatch, method):
    squared, well, sharp = [], [], []
    heard = gs.simulate(robot, "agent1", 1)
    heard = replace(heard, aod_rad=np.full_like(heard.aod_rad, np.nan))
    for alone in (False, True):
        if alone:
            monkeypatch.setattr(hypotheses, "stepped", lambda state, *given: given[-1](state, *given[:-1]))
        run = gs.map_scene(robot, heard, method=method, seed=1)
        off = run.trajectory.position_m - robot.track("agent1").position_m
        squared.append(np.mean(off[1:] ** 2))
        well.append(np.mean([one.health.ok for one in run.estimates]))
        sharp.append(np.mean([max(one.health.jolt) > 1 for one in run.estimates]))
    assert squared[0] < 0.9 * squared[1]
    assert well[0] > 0.95
    assert well[1] < 0.6
    assert sharp[0] > 0.2
    assert sharp[1] == 0


@pytest.mark.slow
def test_an_agent_that_moves_as_told_takes_no_step_again(monkeypatch):
    scene, taken = short("room", 60, particles=256), []
    monkeypatch.setattr(jolts.Jolt, "allowed", lambda self, model: taken.append(self) or model)
    for seed in (1, 2):
        gs.map_scene(scene, gs.simulate(scene, "agent1", seed), seed=seed)
    assert not taken


@pytest.mark.parametrize(("loud", "steps"), [(SWAMPED, 2), (SWAMPED + 1, 1)])
def test_where_an_anchor_is_heard_by_too_many_loud_paths_no_jolt_is_tried(robot, monkeypatch, loud, steps):
    """By chance, any motion fits some of them."""
    slam, draw, taken = gs.AdaptiveSlam(robot, seed=1), np.random.default_rng(1), []
    monkeypatch.setattr(jolts, "likeliest", lambda *_: jolts.Jolt(16.0, 1.0))
    angles = draw.uniform(-3, 3, (2, loud))
    scan = gs.Scan(0, 0.0, np.zeros(loud, int), draw.uniform(1, 20, loud), *angles, np.full(loud, 20.0))

    def step(state, scan, model, work):
        taken.append(model.settings.acceleration_mps2)
        return slam.advance(state, scan, model, work)

    jolts.stepped(slam.state, scan, slam.model, slam.work, step)
    assert len(taken) == steps
