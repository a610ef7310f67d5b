"""Direct grid SLAM at the wrong place: what it hears fits another one better, and it moves there if that is
the only one; where it is right, nothing changes."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.health.doubt import Doubt
from gridslam.inference.management.poses.pose_score import PoseLikelihood
from gridslam.inference.management.samples.array_challenge import EVERY, any_loud, challenged, doubted
from gridslam.inference.management.samples.paths_alone import HeadedPoseLikelihood, alone, headed, mapped
from gridslam.inference.state.state import State
from gridslam.systems import grid

STEPS = 2 * EVERY + 4


def scene_of(anchors=2):
    """`chamber`, with a start known to 0.1 m and 5 degrees."""
    data = gs.Scene.load("chamber").model_dump(exclude_none=True)
    data["anchors"], agent = data["anchors"][:anchors], data["agents"][0]
    agent["steps"], agent["prior"] = STEPS, {"position_m": 0.1, "heading_deg": 5.0}
    return gs.Scene.checked(data, "chamber")


@pytest.fixture(scope="module")
def recording():
    return gs.simulate(scene_of(), "agent1", seed=21, what="signal")


def slam_of(recording, off=(0.0, 0.0), turn=0.0):
    """Direct grid SLAM that is told a start so far off."""
    slam = gs.DirectGridSlam(scene_of(), seed=1, waveform=recording.waveform)
    truth = recording.truth
    slam.start_at(truth.position_m[0] + np.array(off), float(truth.heading_rad[0]) + turn)
    return slam


def errors(slam, recording):
    """Errors (m) and health of a run."""
    estimates = [slam.step(scan) for scan in recording]
    off = [
        float(np.linalg.norm(one.position_m - place))
        for one, place in zip(estimates, recording.truth.position_m, strict=True)
    ]
    return np.array(off), [one.health for one in estimates]


@pytest.mark.slow
def test_an_agent_told_a_wrong_start_is_moved_and_health_says_so(recording):
    off, health = errors(slam_of(recording, off=(1.5, 1.0), turn=1.0), recording)
    assert off[0] > 1.0
    assert off[-1] < 0.15
    first = int(np.flatnonzero(off < 0.3)[0])
    assert not health[first].ok
    assert "found again" in health[first].why


@pytest.mark.slow
def test_a_right_agent_stays_and_is_well(recording):
    slam = slam_of(recording)
    off, health = errors(slam, recording)
    assert off.max() < 0.15
    assert all(one.ok for one in health[1:])
    assert not slam.population.watch.against()


@pytest.mark.slow
def test_nothing_is_searched_between_comparisons_or_in_silence(recording):
    slam = slam_of(recording)
    scans = list(recording)
    slam.step(scans[0])
    population = replace(slam.population, watch=Doubt())
    assert population.best.step % EVERY == 1
    assert challenged(population, scans[1], grid.start, slam.model, slam.work) is population
    quiet = replace(scans[1], heard=np.zeros_like(scans[1].heard))
    due = replace(population, states=(replace(population.best, step=EVERY),))
    assert challenged(due, quiet, grid.start, slam.model, slam.work) is due


@pytest.mark.slow
def test_a_scan_is_loud_and_its_best_pose_is_the_true_one(recording):
    slam = slam_of(recording)
    scan = next(iter(recording))
    paths = alone(slam.population.best, scan, slam.model, slam.work)
    assert any_loud(paths)
    pose = np.append(recording.truth.position_m[0], recording.truth.heading_rad[0])
    elsewhere = pose + np.array([0.5, -0.5, 0.3])
    right, wrong = paths.score(np.stack([pose, elsewhere]), 2.0)
    assert right > wrong + 20
    assert headed(paths, scan, slam.model) is paths
    with_map = mapped(paths, scan, slam.population.best, slam.model, work=slam.work)
    assert all(terms.known is not None for terms in with_map.terms)


def test_a_measured_heading_speaks_against_poses_that_are_turned():
    poses = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0 + 2 * np.pi], [0.0, 0.0, 1.3]])
    score = HeadedPoseLikelihood((), 1.0, 0.1).score(poses)
    np.testing.assert_allclose(score, [0.0, 0.0, -4.5], atol=1e-9)
    assert not PoseLikelihood(()).score(poses).any()


def test_what_speaks_against_a_place_is_said(recording):
    slam = slam_of(recording)
    _, info = slam.advance(slam.population.best, next(iter(recording)), slam.model, slam.work)
    assert doubted(info, Doubt()) is info
    assert "fits another place better" in doubted(info, Doubt(elsewhere=30.0)).health.why
    assert isinstance(slam.population.best, State)
