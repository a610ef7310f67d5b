"""The agent found again: poses from measurements and map, and the belief cut from the map at a jump."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import anchor_scans_of

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief, append
from gridslam.inference.beliefs.calibration import Calibration
from gridslam.inference.health.monitor import DISTRUSTED, HealthMonitor
from gridslam.inference.health.reasons import LEAPT
from gridslam.inference.management.poses import pose_fix, pose_recovery
from gridslam.inference.messages.amplitudes import DetectionTable
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


@pytest.mark.parametrize(("gap", "metres"), [((0.3, 0.2), 0.0), ((3.0, 4.0), 5.0)])
def test_a_leap_is_what_no_motion_leads_to(gap, metres):
    still = Belief(np.zeros(5), np.diag([0.01, 0.01, 0.04, 0.04, 0.01]))
    belief, pose = pose_recovery.freed(still, 0.5, 0.5), np.array([*gap, 0.0])
    assert pose_recovery.leap(belief, pose, 1e-4 * np.eye(3)) == metres
    long = pose_recovery.freed(still, 5.0, 0.5)  # in which it may have been carried there
    assert pose_recovery.leap(long, pose, 1e-4 * np.eye(3)) == 0


def test_an_agent_that_was_well_and_leaps_is_distrusted_for_long():
    model = gs.Scene.load("room").filter_model("agent1")
    well = HealthMonitor().judged(well=True)
    assert not HealthMonitor().next_step(4).leapt(3.0).distrusted  # where it was nobody knew
    assert not well.next_step(4).leapt(0.0).distrusted
    monitor, said = well.next_step(4).judged(well=False).next_step(4).leapt(13.2), []
    assert monitor.next_step(4).leapt(2.0).leap_m == 13.2
    for _ in range(DISTRUSTED + 1):
        health, monitor = monitor.assess(Calibration.start(2), np.array([0.0, 0.1]), model, 0.02, np.inf)
        said.append(health.why)
        monitor = monitor.next_step(4)
    assert said[0] == "moved 13.2 m at once 0 steps ago, as no motion does: it may be elsewhere"
    assert all(LEAPT in why and "turned" not in why for why in said[:DISTRUSTED])
    assert said[DISTRUSTED] == "anchor B seems turned by 5.7 degrees"


@pytest.mark.slow
def test_names_that_are_exchanged_in_mid_run_are_a_leap_and_accuse_nobody():
    """The world that fits them is another one: sure of itself, and metres off."""
    scene, said, off = gs.Scene.load("room").with_filter(particles=200), [], []
    slam, track = gs.AdaptiveSlam(scene, seed=1), scene.track("agent1").position_m
    for scan in list(gs.simulate(scene, "agent1", 43))[:45]:
        after = scan if scan.step < 35 else replace(scan, anchor=1 - scan.anchor)
        estimate = slam.step(after)
        said.append(estimate.health.why)
        off.append(np.linalg.norm(estimate.position_m - track[scan.step]))
    assert max(off[:35]) < 0.5 < 2 < min(off[35:])
    assert not any(said[20:35])
    assert all(LEAPT in why and "anchor" not in why for why in said[35:])
    assert slam.population.sights is None
