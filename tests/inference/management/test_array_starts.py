"""Starts known badly, of arrays: the one pose that explains a snapshot is taken, or none, which is said."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.health.reasons import NOT_FOUND
from gridslam.inference.management.poses.pose_search import Modes
from gridslam.inference.management.samples.array_starts import is_clear


def scene_of(half_m, heading_deg=180.0, anchors=2):
    """`chamber`, with a start known to so many metres and degrees either way."""
    data = gs.Scene.load("chamber").model_dump(exclude_none=True)
    data["anchors"], agent = data["anchors"][:anchors], data["agents"][0]
    agent["steps"], agent["prior"] = 3, {"position_m": half_m, "heading_deg": heading_deg}
    return gs.Scene.checked(data, "chamber")


def slam_of(scene, recording, turn=2.0):
    """Direct grid SLAM that is told a start 4 m off, and turned."""
    slam = gs.DirectGridSlam(scene, seed=1, waveform=recording.waveform)
    slam.start_at(np.array([1.0, 0.5]), turn)
    return slam


def modes_of(count, complete=True):
    return Modes(np.zeros((count, 3)), np.zeros((count, 3, 3)), np.zeros(count), np.zeros(count), complete)


def test_one_pose_alone_is_clear():
    assert is_clear(modes_of(1))
    assert not is_clear(modes_of(2))
    assert not is_clear(modes_of(1, complete=False))
    assert not is_clear(modes_of(0))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12])
def test_a_start_known_to_metres_is_found_and_followed(seed):
    scene = scene_of(8.0)
    recording = gs.simulate(scene, "agent1", seed=seed, what="signal")
    slam, good = slam_of(scene, recording), []
    for scan, place in zip(recording, recording.truth.position_m, strict=True):
        estimate = slam.step(scan)
        off = np.linalg.norm(estimate.position_m - place)
        assert off < 0.15 or NOT_FOUND in estimate.health.why
        good.append(estimate.health.ok)
    assert good[-1]
    assert off < 0.1


@pytest.mark.slow
def test_until_it_is_found_nothing_is_mapped_and_health_says_so(tmp_path):
    """One anchor: any of its paths may be the line of sight. Silence tells nothing at all."""
    scene = scene_of(8.0, anchors=1)
    recording = gs.simulate(scene, "agent1", seed=11, what="signal")
    slam = slam_of(scene, recording)
    first, second, third = recording
    quiet = replace(first, samples=np.zeros_like(first.samples), heard=np.zeros_like(first.heard))
    assert slam.step(quiet).health.why == NOT_FOUND
    assert slam.population.waited == 0
    estimate = slam.step(second)
    assert estimate.health.why == NOT_FOUND
    assert not len(estimate.surfaces)
    assert slam.population.waited == 1
    slam.save(tmp_path / "now.h5")
    again = gs.DirectGridSlam.resume(tmp_path / "now.h5")
    assert again.population.searching
    np.testing.assert_array_equal(again.step(third).covariance, slam.step(third).covariance)


def test_a_start_that_is_known_is_not_searched():
    scene = gs.Scene.load("chamber")
    assert not gs.DirectGridSlam(scene).population.searching
    assert gs.DirectGridSlam(scene_of(3.0)).population.searching
    assert gs.DirectGridSlam(scene_of(0.1)).population.searching
    assert not gs.DirectGridSlam(scene_of(0.1, heading_deg=5.0)).population.searching
