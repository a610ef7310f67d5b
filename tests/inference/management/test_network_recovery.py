"""Finding an agent of a network again, where clocks are unknown and nothing says whose a measurement is."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.inference.management.network.recovery import Beacons, log_likelihood, placed_at, proposed_poses
from gridslam.inference.management.poses.pose_fix import Fix, _log_likelihood, known_sources
from gridslam.inference.management.poses.pose_recovery import near_any_path, near_paths
from gridslam.inference.messages.amplitudes import detection_table
from gridslam.inference.messages.mirrors import DEPARTED
from gridslam.inference.messages.path_prediction import predict_every_path
from gridslam.inference.scans.anchor_measurements import of_all_anchors, split_by_anchor
from gridslam.simulation.network import simulate_network
from gridslam.systems.network import NetworkSlam
from gridslam.world.scan import Scan

AGENTS = ["agent1", "agent2"]


@pytest.fixture(scope="module")
def room():
    """A network that has mapped the room for some steps, and the next scan, with labels."""
    scene = short("room", 9, particles=500)
    slam = NetworkSlam(scene, agents=["agent1"], seed=1)
    scans = [scan.scans[0] for scan in simulate_network(scene, ["agent1"], 1)[0]]
    for scan in scans[:-1]:
        slam.step(scan)
    return slam, scans[-1]


def test_with_labels_and_known_clocks_a_pose_is_as_likely_as_anchor_by_anchor(room):
    slam, scan = room
    model, part = slam.model.agents[0], slam.state.part(0)
    beacons = Beacons.of(part, np.zeros(2, bool), model, slam.work[0])
    assert len(beacons) >= 4
    poses = part.belief.mean[[0, 1, 4]] + np.random.default_rng(2).normal(0, [0.5, 0.5, 0.2], (40, 3))
    radio, scans = model.radio, of_all_anchors(scan, model.radio.threshold)
    table = detection_table(radio)
    per_anchor = zip(known_sources(part, model, work=slam.work[0]), split_by_anchor(scan, model), strict=True)
    apart = sum(_log_likelihood(poses, own, one, table, radio) for own, one in per_anchor)
    np.testing.assert_allclose(log_likelihood(poses, beacons, scans, table, radio), apart, atol=1e-6)
    nobody = replace(scans, label=np.full(len(scans), -1))
    assert (log_likelihood(poses, beacons, nobody, table, radio) >= apart - 1e-6).all()


def test_an_agent_that_hears_double_bounces_alone_is_not_lost(room):
    """They lie near no line of sight and no single bounce, and were taken for another place."""
    slam, _ = room
    model, part = slam.model.agents[0], slam.state.part(0)
    paths = predict_every_path(part, model, work=slam.work[0])
    twice = np.flatnonzero(paths.rays.bounces == 2)
    value, anchor = paths.prediction.value[twice].copy(), paths.rays.anchor[twice].copy()
    scan = of_all_anchors(Scan(9, 1.0, anchor, *value.T, np.full(len(twice), 9.0)), model.radio.threshold)
    alone, near = near_paths([scan], part, model), near_any_path([scan], part, model, work=slam.work[0])
    assert near == len(twice) > 4 > alone
    assert part.monitor.is_lost(near, alone)
    assert not part.monitor.is_lost(near, near)
    off = replace(scan, value=scan.value + np.array([1.0, 0.5, -0.5]))
    assert near_any_path([off], part, model, work=slam.work[0]) < 0.3 * near


def test_a_clock_ahead_makes_distances_longer_and_nothing_else(room):
    slam, scan = room
    model, part = slam.model.agents[0], slam.state.part(0)
    beacons = Beacons.of(part, np.zeros(2, bool), model, slam.work[0])
    late = np.array([7.0, -2.5])[beacons.anchor]
    shifted = replace(beacons, shift=late)
    whole = of_all_anchors(scan, model.radio.threshold)
    value = whole.value.copy()
    value[:, 0] += np.array([7.0, -2.5])[whole.label]
    moved = replace(whole, value=value)
    table, poses = detection_table(model.radio), part.belief.mean[[0, 1, 4]][None]
    one = log_likelihood(poses, beacons, whole, table, model.radio)
    np.testing.assert_allclose(log_likelihood(poses, shifted, moved, table, model.radio), one, atol=1e-9)
    drawn = [
        proposed_poses(own, measured, model.radio, np.random.default_rng(3))
        for own, measured in ((beacons, whole), (shifted, moved))
    ]
    np.testing.assert_allclose(*drawn, atol=1e-9)
    doubtful = replace(beacons, variance=np.full(len(beacons), 4.0))
    assert log_likelihood(poses, doubtful, whole, table, model.radio)[0] < one[0]


@pytest.mark.slow
def test_an_agent_that_is_placed_anew_teaches_the_others_nothing():
    scene = gs.Scene.load("exchange")
    slam = NetworkSlam(scene, agents=AGENTS, seed=1)
    data, _ = simulate_network(scene, AGENTS, 1, unlabelled=True)
    for scan in (data.scan(0), data.scan(1)):
        slam.step(scan)
    before, pose = slam.state, np.array([3.0, -1.0, 0.5])
    after = placed_at(before, 1, Fix(pose, 0.01 * np.eye(3), 9.0, 9.0), 0.04)
    rows = before.belief.layout.pose(1).start + np.array([0, 1, 4])
    np.testing.assert_allclose(after.belief.mean[rows], pose)
    own = np.arange(before.belief.layout.pose(1).start, before.belief.layout.pose(1).start + 5)
    rest = np.setdiff1d(np.arange(len(before.belief.mean)), own)
    np.testing.assert_array_equal(after.belief.mean[rest], before.belief.mean[rest])
    np.testing.assert_array_equal(
        after.belief.covariance[np.ix_(rest, rest)], before.belief.covariance[np.ix_(rest, rest)]
    )
    assert not after.belief.covariance[np.ix_(own, rest)].any()
    assert np.linalg.eigvalsh(after.belief.covariance).min() > -1e-9


@pytest.mark.slow
def test_an_agent_that_is_carried_off_in_silence_is_found_where_it_is():
    whole = gs.Scene.load("exchange").model_dump(exclude_none=True)
    whole["filter"]["particles"] = 500
    scene = gs.Scene.checked(whole, "test")
    data, truth = simulate_network(scene, AGENTS, 2, unlabelled=True)
    track, slam = truth.agents["agent2"].trajectory.position_m, NetworkSlam(scene, agents=AGENTS, seed=2)
    off, back, carried = 10, 13, 140
    assert np.linalg.norm(track[back + carried] - track[off]) > 5
    for step in range(back + 3):
        here, elsewhere = data.scan(step), data.scan(step + carried).scans[1]
        if step >= off:
            mute = {key: column[:0] for key, column in vars(elsewhere).items() if np.ndim(column)}
            carried_scan = elsewhere if step >= back else replace(elsewhere, **mute)
            carried_scan = replace(carried_scan, step=step, time_s=here.time_s)
            here = replace(here, scans=(here.scans[0], carried_scan))
        weighed = slam.state.surfaces.angles[..., DEPARTED.start].sum()
        estimate = slam.step(here)
        if step == back:
            assert "found again" in estimate.agents["agent2"].health.why
            assert (
                0 < slam.state.surfaces.angles[..., DEPARTED.start].sum() < 0.5 * weighed
            )  # they told of its place
    error = estimate.agents["agent2"].position_m - track[step + carried]
    assert np.linalg.norm(error) < 0.3
    assert np.linalg.norm(estimate.agents["agent1"].position_m - data.tracks["agent1"].position_m[step]) < 0.3
    assert not estimate.unset.any()
