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
from gridslam.world.start import assumed_start

ROOM = raised(shortened(gs.Scene.load("room"), 30), 1.5, agent_m=1.1)
TRUE = with_levels(ROOM, (0.0, 0.5), (3.0, 0.4))


def with_prior(floor, ceiling, std):
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
    slam, estimates = followed(method, with_prior(0.2, 0.7, (0.2, 0.2)))
    for name, true in (("floor", 0.5), ("ceiling", 0.4)):
        mean, std = estimates[-1].coefficients[name]
        assert abs(mean - true) < max(4 * std, 0.05)
        assert std < 0.05
    assert slam.state.calibration.gain == 1.0  # amplitudes over unknown levels tell nothing of the radio


@pytest.mark.slow
def test_one_that_is_known_stays_and_steps_and_checkpoints_hold_the_other(tmp_path):
    slam, estimates = followed(GridSlam, with_prior(0.5, 0.7, (0.0, 0.2)))
    assert list(estimates[-1].coefficients) == ["ceiling"]
    assert believed(slam.model, slam.state.levels).radio.image_gains[1] == 0.5
    write_steps(tmp_path / "steps.h5", estimates)
    assert [e.coefficients for e in read_steps(tmp_path / "steps.h5")] == [e.coefficients for e in estimates]
    slam.save(tmp_path / "c.h5")
    again = GridSlam.resume(tmp_path / "c.h5")
    np.testing.assert_array_equal(again.state.levels, slam.state.levels)


@pytest.mark.slow
def test_what_was_learned_of_levels_goes_on_with_the_map(tmp_path):
    scene = with_prior(0.2, 0.7, (0.2, 0.2))
    slam, estimates = followed(GridSlam, scene)
    slam.map().save(tmp_path / "map.h5")
    kept = gs.Map.load(tmp_path / "map.h5")
    assert sorted(kept.levels) == ["ceiling", "floor"]
    later = GridSlam(scene, prior_map=kept)
    np.testing.assert_array_equal(later.state.levels, slam.state.levels)
    for method in (GridSlam, AdaptiveSlam):  # what the scene is sure of, it says itself
        state = method(with_prior(0.5, 0.7, (0.0, 0.2)), prior_map=kept).state
        assert not state.levels[0].any()
        np.testing.assert_array_equal(state.levels[1], kept.levels["ceiling"])
    mean, _ = estimates[-1].coefficients["floor"]
    blank = gs.Map.blank(kept.origin_m, kept.cell_m, kept.shape, kept.prior)
    other = replace(blank, levels={"floor": _coefficients([(0.9, 0.3)])[0]})
    for maps in ([kept, other], [other, kept]):
        fused = gs.fuse(maps, same_frame=True)
        np.testing.assert_array_equal(fused.levels["floor"], kept.levels["floor"])
    assert level_means(np.array([fused.levels["floor"]]))[0] == pytest.approx(mean)
    assert fused.resample([0.0, 0.0], 0.2, (9, 9)).levels.keys() == kept.levels.keys()
    for wrong in ({"roof": np.full(50, 0.02)}, {"floor": np.ones(50)}, {"floor": np.ones(20) / 20}):
        with pytest.raises(gs.InputError, match="levels"):
            replace(kept, levels=wrong)


def test_simulated_agents_are_told_coefficients_that_are_drawn():
    scene, known = with_prior(0.5, 0.4, (0.1, 0.0)), with_prior(0.5, 0.4, (0.0, 0.0))
    drawn = [assumed_start(scene, "agent1", seed).coefficients["floor"] for seed in range(200)]
    assert abs(np.mean(drawn) - 0.5) < 0.03
    assert 0.08 < np.std(drawn) < 0.12
    one = assumed_start(scene, "agent1", 3)
    assert list(one.coefficients) == ["floor"]
    assert scene.at_coefficients(one.coefficients).floor.coefficient == one.coefficients["floor"]
    assert assumed_start(known, "agent1", 3).coefficients == {}
    assert assumed_start(scene, "agent1", 3, "exact").coefficients == {}
    np.testing.assert_array_equal(assumed_start(known, "agent1", 3).position_m, one.position_m)


@pytest.mark.slow
def test_a_run_is_told_what_was_drawn_and_scored_by_the_truth():
    scene = with_prior(0.5, 0.4, (0.2, 0.0))
    scan = gs.simulate(scene, "agent1", seed=4)
    start = assumed_start(scene, "agent1", 4)
    run = gs.map_scene(scene, scan, seed=4, start=start)
    first = run.estimates[0].coefficients["floor"][0]
    exact = GridSlam(scene, seed=4).step(scan.scan(0)).coefficients["floor"][0]
    assert start.coefficients["floor"] > 0.8
    assert first > exact + 0.05
    assert run._coefficients(True)["floor"]["error"] == pytest.approx(
        run.estimates[-1].coefficients["floor"][0] - 0.5
    )


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
    model = with_prior(0.5, 0.4, (0.2, 0.0)).filter_model("agent1")
    state, length = replace(State.start(model), levels=model.level_prior), 6.0
    rays = SimpleNamespace(anchor=np.array([model.senders]), table=np.zeros((1, 4), int))
    paths = SimpleNamespace(rays=rays, prediction=SimpleNamespace(length=np.array([length])))
    odds = np.zeros((12, 1))
    odds[tables.CHANCE] = 0.9
    missed = SimpleNamespace(responsible=np.zeros((1, 0)), odds=odds)
    scan = SimpleNamespace(value=np.zeros((0, 3)), amplitude=np.zeros(0))
    after = learn_levels(state, scan, paths, missed, model.radio, model).levels[0]
    chance = model.radio.detection_probability(model.radio.amplitude_at_1m * COEFFICIENTS / length)
    wanted = state.levels[0] * (1 - 0.9 * chance)
    assert chance[0] < 0.1 < 0.8 < chance[-1]
    np.testing.assert_allclose(after, wanted / wanted.sum(), atol=1e-3)
