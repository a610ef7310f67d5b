"""Filters in rooms whose floor and ceiling reflect: at the bound if told, phantom walls if not."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import raised, shortened, with_levels

import gridslam as gs
from gridslam.evaluation.bounds import unknown_map_bound
from gridslam.evaluation.consistency import nees
from gridslam.inference.messages.reflection import PRODUCTS, reflected
from gridslam.inference.messages.updates import _with_images
from gridslam.inference.state.rays import Rays
from gridslam.systems.soundness import require_sound

ROOM = gs.Scene.load("room")


def followed(scene, method, measurements, track):
    """Squared errors and NEES per dimension of all steps, and the last estimate."""
    slam, square, ratio = method(scene, seed=1), [], []
    for step in range(len(measurements)):
        estimate = slam.step(measurements.scan(step))
        gap = estimate.position_m - track.position_m[step]
        square.append(gap @ gap)
        ratio.append(nees(gap, estimate.covariance[:2, :2]) / 2)
    return np.mean(square), np.mean(ratio), estimate


@pytest.mark.parametrize("method", [gs.GridSlam, gs.AdaptiveSlam])
def test_paths_over_levels_are_told_as_their_anchors(method):
    scene = with_levels(raised(shortened(ROOM, 6), [1.5, 1.1]))
    measurements = gs.simulate(scene, "agent1", seed=3)
    square, _, last = followed(scene, method, measurements, scene.track("agent1"))
    assert np.sqrt(square) < 0.2
    assert last.paths.anchor.max() == 1
    assert len(last.health.clutter) == len(last.health.turned_rad) == 2
    assert last.health.clutter.max() < 4  # what goes over floor and ceiling is none
    away = np.linalg.norm(last.position_m - scene.anchor_positions, axis=1)
    straight = last.paths.surfaces[:, 0] < 0
    expected = np.hypot(away, scene.verticals("agent1").height)
    np.testing.assert_allclose(np.sort(last.paths.distance_m[straight]), np.sort(expected.ravel()), atol=1e-6)


def test_a_run_with_levels_goes_on_from_a_checkpoint(tmp_path):
    scene = with_levels(raised(shortened(ROOM, 4), 1.2))
    measurements = gs.simulate(scene, "agent1", seed=3)
    slam = gs.GridSlam(scene, seed=1)
    for step in range(3):
        slam.step(measurements.scan(step))
    slam.save(tmp_path / "at3.h5")
    again = gs.GridSlam.resume(tmp_path / "at3.h5")
    np.testing.assert_array_equal(
        again.step(measurements.scan(3)).covariance, slam.step(measurements.scan(3)).covariance
    )


@pytest.mark.parametrize(
    "spoil",
    [lambda x: x[:, :3], lambda x: x[:0], lambda x: -x, lambda x: 2 * x, np.ones_like, lambda _: None],
)
def test_coefficients_of_levels_that_cannot_be_are_refused(spoil):
    data = with_levels(raised(shortened(ROOM, 4), 1.2)).model_dump(exclude_none=True)
    data["ceiling"]["coefficient_std"] = 0.2
    slam = gs.GridSlam(gs.Scene.checked(data, "room"), seed=1)
    require_sound(slam.state, slam.model, "file")
    with pytest.raises(gs.InputError, match="file/levels"):
        require_sound(replace(slam.state, levels=spoil(slam.state.levels)), slam.model, "file")


def test_amplitudes_over_a_level_are_weaker_by_its_coefficient():
    scene = with_levels(raised(ROOM, 1.5))
    radio, rays = scene.filter_model("agent1").radio, Rays.of(np.arange(6), 0, -1, -1, np.ones(6), np.ones(6))
    products = np.tile(np.random.default_rng(0).dirichlet(np.ones(len(PRODUCTS))), (6, 1))
    belief = reflected(products, rays, radio).probability
    np.testing.assert_allclose(belief.sum(1), 1)
    means = belief @ PRODUCTS / (products @ PRODUCTS)
    np.testing.assert_allclose(means, np.repeat([1.0, 0.5, 0.4], 2), rtol=0.01)  # the least node is the least
    plain = scene.signal_model("agent1")
    assert reflected(products, rays, plain).probability is products


def test_sums_of_images_count_for_their_anchors():
    fits = np.arange(54.0).reshape(6, 9)
    both = _with_images(fits, 2)
    np.testing.assert_allclose(both[1, :8], (fits[1] + fits[3] + fits[5])[:8])
    np.testing.assert_allclose(both[:, 8], fits[:2, 8])
    assert _with_images(fits, 6) is fits


@pytest.mark.slow
@pytest.mark.parametrize("method", [gs.GridSlam, gs.AdaptiveSlam])
def test_floor_and_ceiling_leave_a_filter_that_knows_them_at_the_bound(method):
    scene = with_levels(shortened(gs.Scene.load("ceiling"), 70))
    track, measurements = scene.track("agent1"), gs.simulate(scene, "agent1", seed=21)
    square, ratio, last = followed(scene, method, measurements, track)
    bound = unknown_map_bound(scene, "agent1").position_m
    assert np.sqrt(square / np.square(bound).mean()) < 1.2  # one run
    assert 0.5 < ratio < 1.7
    assert last.detected.sum() <= 9


@pytest.mark.slow
def test_paths_over_levels_blur_no_others_at_40_db():
    data = with_levels(raised(shortened(ROOM, 40), 1.5)).model_dump(exclude_none=True)
    scene = gs.Scene.checked({**data, "radio": {**data["radio"], "snr_at_1m_db": 40.0}}, "room")
    measurements, track = gs.simulate(scene, "agent1", seed=71), scene.track("agent1")
    square, ratio, last = followed(scene, gs.GridSlam, measurements, track)
    bound = unknown_map_bound(scene, "agent1").position_m
    claimed = np.trace(last.covariance[:2, :2])
    assert np.sqrt(square / np.square(bound).mean()) < 1.3  # one run
    assert 0.5 < ratio < 1.7
    assert claimed < 1.1**2 * bound[-1] ** 2  # 1.5 where level paths count as a crowd
    assert last.detected.sum() <= 5  # 10 where they do


@pytest.mark.slow
def test_floor_and_ceiling_that_a_scene_leaves_out_become_phantom_walls():
    scene = raised(shortened(ROOM, 30), 1.5)
    measurements = gs.simulate(with_levels(scene), "agent1", seed=21)
    _, _, last = followed(scene, gs.GridSlam, measurements, scene.track("agent1"))
    assert last.detected.sum() > 8  # there are four walls
