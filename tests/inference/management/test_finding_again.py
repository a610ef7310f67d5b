"""The agent found again: poses from measurements and map, and the belief cut from the map at a jump."""

import numpy as np
import pytest
from filter_states import anchor_scans_of

from gridslam.inference.management.poses import pose_fix, pose_recovery
from gridslam.inference.messages.amplitudes import DetectionTable
from gridslam.inference.state.belief import Belief, append
from gridslam.world import geometry
from gridslam.world.geometry import wrap

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def mapped(room, pose, std):
    """Belief at a wrong pose, with the true walls."""
    mean = np.array([pose[0], pose[1], 0.0, 0.0, pose[2]])
    belief = Belief(mean, np.diag([std[0] ** 2, std[0] ** 2, 0.01, 0.01, std[1] ** 2]))
    for line in room.scene.segments().line:
        belief = append(belief, line, np.diag([1e-6, 1e-4]))
    return belief


@pytest.mark.parametrize("off", [(1.5, -0.8, 0.4), (-1.0, 2.0, 3.0)])
def test_the_agent_is_found_wherever_it_was_believed(room, signal, off):
    step = 70
    truth = np.array([*room.track.position_m[step], room.track.heading_rad[step]])
    belief = mapped(room, truth + off, (2.0, 1.5))
    lines = belief.lines
    sources = [
        pose_fix.Sources(
            np.concatenate([estimate.position[None], geometry.mirror(lines, estimate.position)]),
            np.concatenate([np.zeros((1, 2)), lines]), np.array([1, 0.7, 0.7, 0.7, 0.7]), np.full(5, 0.9),
        )
        for estimate in anchor_scans_of(room, step)
    ]  # fmt: skip
    fix = pose_fix.find_pose(
        belief, belief, sources, anchor_scans_of(room, step), DetectionTable(signal), signal, [1, 2]
    )
    assert np.linalg.norm(fix.pose[:2] - truth[:2]) < 0.15
    assert abs(wrap(fix.pose[2] - truth[2])) < 0.1
    assert fix.lead > pose_fix.CLEAR
    assert fix.gain > pose_fix.WORTH
    after = pose_recovery.moved(pose_recovery.freed(belief, 1.0, 0.03), fix, 0.01)
    assert np.linalg.norm(after.mean[:2] - truth[:2]) < 0.3
    assert np.linalg.eigvalsh(after.covariance).min() > -1e-12


def test_no_measurement_gives_no_fix(room, signal):
    belief = mapped(room, (0.0, 0.0, 0.0), (1.0, 1.0))
    assert pose_fix.find_pose(belief, belief, [], [], DetectionTable(signal), signal, [1]) is None


def test_a_jump_cuts_the_agent_from_the_map_and_keeps_the_map(room):
    belief = mapped(room, (0.0, 0.0, 0.0), (0.01, 0.01))
    fix = pose_fix.Fix(np.array([2.0, 1.0, 1.0]), np.diag([1e-3, 1e-3, 1e-3]), 50.0, 50.0)
    after = pose_recovery.moved(belief, fix, 0.04)
    np.testing.assert_allclose(after.mean[[0, 1, 4]], fix.pose)
    np.testing.assert_array_equal(after.mean[5:], belief.mean[5:])
    np.testing.assert_array_equal(after.covariance[5:, 5:], belief.covariance[5:, 5:])
    assert not after.covariance[:5, 5:].any()
