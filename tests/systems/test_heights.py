"""Filters under anchors at heights: as near to the bound as without, the same bits where all are level."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import raised, shortened

import gridslam as gs
from gridslam.checks.verdicts.diagnose import suspicions
from gridslam.evaluation.bounds import unknown_map_bound
from gridslam.evaluation.consistency import nees
from gridslam.runs.map_scene import check_anchors

ROOM = gs.Scene.load("room")


def followed(scene, method, seed, measurements=None):
    """Squared errors (N,), NEES per dimension (N,), and the last estimate."""
    measurements = gs.simulate(scene, "agent1", seed=seed) if measurements is None else measurements
    slam, track = method(scene, seed=seed), ROOM.track("agent1")
    square, ratio = np.zeros(len(measurements)), np.zeros(len(measurements))
    for step in range(len(measurements)):
        estimate = slam.step(measurements.scan(step))
        gap = estimate.position_m - track.position_m[step]
        square[step], ratio[step] = gap @ gap, nees(gap, estimate.covariance[:2, :2]) / 2
    return square, ratio, estimate


@pytest.mark.slow
@pytest.mark.parametrize("method", [gs.GridSlam, gs.AdaptiveSlam, gs.VirtualAnchorSlam])
def test_devices_at_one_height_give_the_bits_of_a_plane(method):
    flat = shortened(ROOM, 8)
    ours = [method(scene, seed=1) for scene in (flat, raised(flat, 0.0, agent_m=1.3))]
    measurements = [gs.simulate(scene, "agent1", seed=1) for scene in (flat, raised(flat, 0.0, agent_m=1.3))]
    for step in range(8):
        one, other = (slam.step(h.scan(step)) for slam, h in zip(ours, measurements, strict=True))
        np.testing.assert_array_equal(one.covariance, other.covariance)
        np.testing.assert_array_equal(one.paths.distance_m, other.paths.distance_m)
        np.testing.assert_array_equal(one.surfaces.line, other.surfaces.line)


@pytest.mark.slow
@pytest.mark.parametrize("method", [gs.GridSlam, gs.AdaptiveSlam, gs.VirtualAnchorSlam])
def test_anchors_on_a_ceiling_are_followed_as_near_to_the_bound_as_any(method):
    scene = raised(shortened(ROOM, 60), [1.5, 1.9])
    bound = unknown_map_bound(scene, "agent1")
    square, ratio, last = followed(scene, method, 5)
    assert np.sqrt(square.mean() / np.square(bound.position_m).mean()) < 1.3  # one run
    assert 0.3 < ratio.mean() < 2.0
    assert last.health.ok
    found = last.paths.surfaces[:, 0] < 0
    expected = np.hypot(np.linalg.norm(last.position_m - scene.anchor_positions, axis=1), [1.5, 1.9])
    np.testing.assert_allclose(np.sort(last.paths.distance_m[found]), np.sort(expected), atol=1e-6)


@pytest.mark.slow
def test_the_point_right_under_an_anchor_is_passed_as_near_to_the_bound_as_any():
    """A way that was drawn for this, not for tuning: see docs/notebook.md, Heights, for eight seeds."""
    scene = shortened(gs.Scene.load("ceiling"), 140)  # it is passed at steps 112 to 127
    bound = unknown_map_bound(scene, "agent1").position_m
    measurements, track, slam = (
        gs.simulate(scene, "agent1", seed=31),
        scene.track("agent1"),
        gs.GridSlam(scene, seed=31),
    )
    gap = (
        np.array([slam.step(measurements.scan(k)).position_m for k in range(len(measurements))])
        - track.position_m
    )
    assert np.sqrt((gap**2).sum(1).mean() / np.square(bound).mean()) < 1.2
    under = np.linalg.norm(track.position_m - scene.anchor_positions[0], axis=1) < 0.5
    assert np.sqrt((gap[under] ** 2).sum(1).mean()) < 0.05


def test_measurements_hold_heights_and_are_refused_by_scenes_of_others(tmp_path):
    scene = raised(shortened(ROOM, 3), 1.5)
    measurements = gs.simulate(scene, "agent1", seed=1)
    measurements.to_h5(tmp_path / "heard.h5")
    read = gs.Measurements.load(tmp_path / "heard.h5")
    np.testing.assert_array_equal(read.anchor_position_m, scene.anchor_places)
    check_anchors(scene, read)
    check_anchors(scene, replace(read, anchor_position_m=scene.anchor_positions))
    for other in (ROOM, raised(ROOM, 1.6)):
        with pytest.raises(gs.InputError, match="as in the scene"):
            check_anchors(other, read)


@pytest.mark.slow
def test_heights_that_a_scene_leaves_out_cost_decimetres():
    """What heights are for: the same distances in a planar scene."""
    scene = shortened(ROOM, 50)
    measurements = gs.simulate(raised(scene, 1.5), "agent1", seed=5)
    planar, _, _ = followed(scene, gs.GridSlam, 5, measurements)
    assert np.sqrt(planar.mean()) > 0.1


@pytest.mark.slow
def test_check_finds_nothing_wrong_with_heights_and_names_other_ones():
    scene = raised(ROOM, 1.5)
    measurements = gs.simulate(scene, "agent1", seed=2)
    columns = {
        n: getattr(measurements, n)
        for n in ("step", "anchor", "time_s", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    }
    assert not suspicions(columns, scene.anchor_names, scene, "agent1")
    (found,) = suspicions(columns, ROOM.anchor_names, ROOM, "agent1")
    assert found.kind == "slant"
    assert "position_m" in found.text
    assert "height_m" in found.text
