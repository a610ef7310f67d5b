"""How wide the modes of a scan are, by importance samples about the best poses."""

from types import SimpleNamespace

import numpy as np
import pytest

from gridslam.inference.management.poses.pose_search import Bounds, _refined
from gridslam.world.geometry import unit, wrap


@pytest.mark.parametrize("seed", range(4))
def test_a_mode_is_as_wide_as_an_exact_scan_leaves_it(seed):
    """60 m from an anchor, lengths to 2 mm, directions to 0.1 degrees: the place lies on 0.1 m of a circle.

    Half of the log likelihood is covered, so variances are twice those of the scan.
    """
    draw = np.random.default_rng(seed)
    bearing, angle_std = draw.uniform(-np.pi, np.pi), np.radians(0.1)
    place, along = 60.0 * unit(bearing), unit(bearing + 0.5 * np.pi)
    heading = draw.uniform(-np.pi, np.pi)

    def score(poses, widen=1.0):
        gap = np.hypot(*poses[:, :2].T) - 60.0
        departs = wrap(np.arctan2(*poses[:, 1::-1].T) - bearing)
        arrives = wrap(departs - wrap(poses[:, 2] - heading))
        std = widen * np.array([0.002, angle_std, angle_std])
        return -0.5 * np.square(np.column_stack([gap, departs, arrives]) / std).sum(1)

    started = np.array([[*(place + 0.15 * along), heading + 0.02]])
    within = Bounds(np.array([-90.0, -90.0, heading - np.pi]), np.array([90.0, 90.0, heading + np.pi]))
    pose, covariance, best = _refined(SimpleNamespace(score=score), within, started, draw)
    assert best[0] > -2
    spread = float(along @ covariance[0, :2, :2] @ along)
    assert 0.6 < spread / (2 * (60.0 * angle_std) ** 2) < 1.6
    gap = np.array([*(pose[0, :2] - place), wrap(pose[0, 2] - heading)])
    assert gap @ np.linalg.solve(covariance[0], gap) < 2


@pytest.mark.parametrize("seed", range(4))
def test_a_narrow_mode_is_not_lost_in_what_all_poses_about_it_share(seed):
    """1 cm and 0.3 degrees wide, 30 nats above a plateau of 0.4 m, as where measurements may be clutter.

    Powers of it, about which a Gaussian of the plateau has samples enough, ended 0.2 m off and as wide.
    """
    true, std = np.array([3.0, 2.0, 0.5]), np.array([0.01, 0.01, 0.005])

    def score(poses, widen=1.0):
        gap = (poses - true) / (widen * std)
        gap[:, 2] = wrap(poses[:, 2] - true[2]) / (widen * std[2])
        peak = -0.5 * np.square(gap).sum(1)
        return np.logaddexp(peak, -30.0 - 0.5 * np.square(gap / 40).sum(1))

    started = true[None] + np.array([[0.03, -0.02, 0.01]])
    within = Bounds(np.array([-9.0, -9.0, -np.pi]), np.array([9.0, 9.0, np.pi]))
    pose, covariance, best = _refined(
        SimpleNamespace(score=score), within, started, np.random.default_rng(seed)
    )
    assert best[0] > -3
    np.testing.assert_allclose(pose[0], true, atol=0.01)
    assert np.trace(covariance[0, :2, :2]) < 2 * 2 * (2 * std[0] ** 2 + 1e-4)
