"""Coefficients of floor and ceiling: learned from either side, kept where they are known, in all records."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scene_samples import raised, shortened, with_levels

import gridslam as gs
from gridslam.inference.messages.level_coefficients import learn_levels, level_means
from gridslam.inference.messages.level_coefficients import with_levels as believed
from gridslam.inference.state.state import State
from gridslam.kernels.primitives import tables
from gridslam.runs.step_files import read_steps, write_steps
from gridslam.systems.adaptive import AdaptiveSlam
from gridslam.systems.grid import GridSlam
from gridslam.world.levels import COEFFICIENTS, _coefficients

ROOM = raised(shortened(gs.Scene.load("room"), 30), 1.5, agent_m=1.1)
TRUE = with_levels(ROOM, (0.0, 0.5), (3.0, 0.4))


def told(floor, ceiling, std):
    """The scene with other coefficients, each as well known as one of `std` says."""
    data = TRUE.model_dump(exclude_none=True)
    data["floor"] |= {"coefficient": floor, "coefficient_std": std[0]}
    data["ceiling"] |= {"coefficient": ceiling, "coefficient_std": std[1]}
    return gs.Scene.checked(data, "room")


def followed(method, scene, seed=2):
    slam = method(scene, seed=seed)
    return slam, [slam.step(scan) for scan in gs.simulate(TRUE, "agent1", seed=seed)]


@pytest.mark.slow
@pytest.mark.parametrize("method", [GridSlam, AdaptiveSlam])
def test_wrong_coefficients_are_learned_within_their_deviations(method):
    slam, estimates = followed(method, told(0.2, 0.7, (0.2, 0.2)))
    for name, true in (("floor", 0.5), ("ceiling", 0.4)):
        mean, std = estimates[-1].coefficients[name]
        assert abs(mean - true) < max(4 * std, 0.05)
        assert std < 0.05
    assert slam.state.calibration.gain == 1.0  # amplitudes over unknown levels tell nothing of the radio


@pytest.mark.slow
def test_one_that_is_known_stays_and_steps_and_checkpoints_hold_the_other(tmp_path):
    slam, estimates = followed(GridSlam, told(0.5, 0.7, (0.0, 0.2)))
    assert list(estimates[-1].coefficients) == ["ceiling"]
    assert believed(slam.model, slam.state.levels).radio.image_gains[1] == 0.5
    write_steps(tmp_path / "steps.h5", estimates)
    assert [e.coefficients for e in read_steps(tmp_path / "steps.h5")] == [e.coefficients for e in estimates]
    slam.save(tmp_path / "c.h5")
    again = GridSlam.resume(tmp_path / "c.h5")
    np.testing.assert_array_equal(again.state.levels, slam.state.levels)


def test_known_coefficients_ask_for_nothing():
    assert TRUE.filter_model("agent1").level_prior is None
    model = TRUE.filter_model("agent1")
    assert believed(model, None) is model


def test_priors_have_the_moments_that_are_told():
    prior = _coefficients([(0.5, 0.1), (0.4, 0.0)])
    mean, std = level_means(prior)
    np.testing.assert_allclose([mean[0], std[0]], [0.5, 0.1], rtol=0.01)
    assert not prior[1].any()
    model = replace(TRUE.filter_model("agent1"), level_prior=prior)
    assert believed(model, prior) is believed(model, prior.copy())
    assert believed(model, prior).radio.image_gains == (1.0, 0.5, 0.4)
    assert (np.diff(COEFFICIENTS) > 0).all()


def test_a_path_that_is_surely_there_and_not_heard_speaks_against_loud_levels():
    model = told(0.5, 0.4, (0.2, 0.0)).filter_model("agent1")
    state, length = replace(State.start(model), levels=model.level_prior), 6.0
    rays = SimpleNamespace(anchor=np.array([model.senders]), table=np.zeros((1, 4), int))
    paths = SimpleNamespace(rays=rays, prediction=SimpleNamespace(length=np.array([length])))
    odds = np.zeros((12, 1))
    odds[tables.CHANCE] = 0.9
    missed = SimpleNamespace(responsible=np.zeros((1, 0)), odds=odds)
    heard = SimpleNamespace(value=np.zeros((0, 3)), amplitude=np.zeros(0))
    after = learn_levels(state, heard, paths, missed, model.radio, model).levels[0]
    chance = model.radio.detection_probability(model.radio.amplitude_at_1m * COEFFICIENTS / length)
    wanted = state.levels[0] * (1 - 0.9 * chance)
    assert chance[0] < 0.1 < 0.8 < chance[-1]
    np.testing.assert_allclose(after, wanted / wanted.sum(), atol=1e-3)
