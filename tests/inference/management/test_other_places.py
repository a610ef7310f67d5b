"""What is another place than the believed one, and what a belief allows for."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs
from gridslam.inference.health.doubt import ALIKE
from gridslam.inference.management.challenge import compare_poses, pose_likelihood
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.systems.grid import GridSlam

SURE = np.diag([1e-4, 1e-4, 1e-4])
"""Covariance of a pose that is known to a centimetre and half a degree."""


@pytest.fixture(scope="module")
def scene():
    return shortened(gs.Scene.load("room"), 31).with_filter(particles=256)


@pytest.fixture(scope="module")
def scans(scene):
    return list(gs.simulate(scene, "agent1", seed=2))


@pytest.fixture(scope="module")
def mapped(scene, scans):
    """A filter after twenty steps."""
    slam = GridSlam(scene, seed=3)
    for scan in scans[:20]:
        slam.step(scan)
    return slam


def test_what_the_belief_allows_for_is_no_other_place(mapped, scene, scans):
    """0.8 m along the circle about an anchor that hears the agent alone, and as much as that claimed.

    Along more of it, the circle bends away from what a covariance allows for.
    """
    slam = mapped
    one = split_by_anchor(scans[20], slam.model)[:1]
    likelihood, track = pose_likelihood(one, slam.state, slam.model), scene.track("agent1")
    place, true = one[0].position, track.position_m[20]
    away, turn = true - place, 0.8 / np.hypot(*(true - place))
    along = 0.8 * np.array([-away[1], away[0]]) / np.hypot(*away)
    root = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    believed = np.array([*(place + root @ away), track.heading_rad[20] + turn])
    wide = SURE + np.outer([*along, turn], [*along, turn])
    for seed in range(4):
        best, here, _ = compare_poses(likelihood, believed, SURE, np.random.default_rng(seed))
        assert best - here > ALIKE
        best, here, _ = compare_poses(likelihood, believed, wide, np.random.default_rng(seed))
        assert best - here < ALIKE


def test_what_no_scan_tells_the_heading_of_is_no_other_place_by_its_heading(mapped, scene, scans):
    """0.8 m about an anchor, where turns go with metres along the circle, of scans without arrivals."""
    slam = mapped
    deaf = replace(scans[20], aoa_rad=np.full(len(scans[20]), np.nan))
    one = split_by_anchor(deaf, slam.model)[:1]
    likelihood, true = pose_likelihood(one, slam.state, slam.model), scene.track("agent1").position_m[20]
    away = true - one[0].position
    turn = 1.0 / np.hypot(*away)
    along = np.array([-away[1], away[0]]) * turn
    believed = np.array([*(true + 0.8 * along), 0.3])
    wide = SURE + 9 * np.outer([*along, turn], [*along, turn])
    assert not likelihood.tells_heading
    for seed in range(4):
        best, here, _ = compare_poses(likelihood, believed, SURE, np.random.default_rng(seed))
        assert best > here
        best, here, _ = compare_poses(likelihood, believed, wide, np.random.default_rng(seed))
        assert best == here


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "covariance",
    [
        np.outer([1e8, 1e8, 1.0], [1e8, 1e8, 1.0]) + np.diag([1.0, 1.0, 0.0]),
        np.outer([1e3, 1e3, 1.0], [1e3, 1e3, 1.0]) - 1e-5 * np.eye(3),
        np.zeros((3, 3)),
    ],
)
def test_a_covariance_may_be_vast_singular_or_not_quite_positive(mapped, scene, scans, covariance):
    slam = mapped
    likelihood = pose_likelihood(split_by_anchor(scans[20], slam.model), slam.state, slam.model)
    track = scene.track("agent1")
    true = np.array([*track.position_m[20], track.heading_rad[20]])
    for off in (np.zeros(3), np.array([2.0, -1.0, 1.0])):
        best, here, mirrored = compare_poses(likelihood, true + off, covariance, np.random.default_rng(1))
        assert np.isfinite([best, here, mirrored]).all()
        assert best - here < 1 if not off.any() else best - here > 5
