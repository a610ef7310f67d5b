"""Hybrid SLAM after a silence: it finds its agent again, or says that it hasn't."""

import copy
from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam import runtime
from gridslam.systems.hybrid import HybridSlam

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
SEEDS, SETTLED, EARLY, AFTER = (1, 2, 3), 22, 5, 8
PAUSES_S = 3.0, 3600.0


@pytest.fixture(scope="module")
def screen():
    return gs.Scene.load("screen").with_filter(particles=2000)


@pytest.fixture(scope="module")
def begun(screen):
    """Of several seeds, the filter at two steps, and the recording."""
    runs = []
    for seed in SEEDS:
        recording = gs.simulate(screen, "agent1", seed, what="signal")
        slam, kept = HybridSlam(screen, seed=seed, waveform=recording.waveform), {}
        for scan in recording:
            if scan.step in (EARLY, SETTLED):
                kept[scan.step] = copy.copy(slam)
            if scan.step == SETTLED:
                break
            slam.step(scan)
        runs.append((kept, recording))
    return runs


def later(slam, scans, seconds):
    return [slam.step(replace(scan, time_s=scan.time_s + seconds)) for scan in scans]


def judged(estimates, scans, recording):
    """Errors (m), squared errors over variances, and whether health is well."""
    truth = recording.truth.position_m[[scan.step for scan in scans], :2]
    off = np.array([one.position_m[:2] for one in estimates]) - truth
    own = np.array([one.covariance[:2, :2] for one in estimates])
    squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(own), off)
    return np.hypot(*off.T), squared, np.array([one.health.ok for one in estimates])


@pytest.mark.slow
@pytest.mark.parametrize("seconds", PAUSES_S)
def test_the_first_snapshot_after_a_silence_finds_the_agent(begun, seconds):
    found = []
    for kept, recording in begun:
        scans = list(recording)[SETTLED : SETTLED + AFTER]
        found.append(judged(later(copy.copy(kept[SETTLED]), scans, seconds), scans, recording))
    off, squared, well = (np.array(part) for part in zip(*found, strict=True))
    assert off.max() < 0.3
    assert squared.mean() < 4
    assert well.all()


@pytest.mark.slow
def test_who_knows_no_feature_yet_says_that_it_is_not_found_until_it_is(begun):
    """Two by two elements can't tell a direction from its opposite: features do, when they are learned."""
    for kept, recording in begun:
        scans = list(recording)[EARLY : EARLY + 20]
        off, squared, well = judged(later(copy.copy(kept[EARLY]), scans, 60.0), scans, recording)
        assert not (well & (off > 0.5) & (squared > 16)).any()
        assert off[-3:].max() < 0.3
        assert well[-3:].all()


@pytest.mark.slow
def test_an_agent_that_has_not_been_found_goes_on_from_its_checkpoint(begun, screen, tmp_path):
    kept, recording = begun[0]
    slam, scans = copy.copy(kept[EARLY]), list(recording)[EARLY : EARLY + 14]
    later(slam, scans[:2], 60.0)
    slam.save(tmp_path / "astray.h5")
    again = HybridSlam.resume(tmp_path / "astray.h5")
    assert slam.state.joint.astray
    assert again.state.joint.astray
    for one, other in zip(later(slam, scans[2:], 60.0), later(again, scans[2:], 60.0), strict=True):
        np.testing.assert_array_equal(one.position_m, other.position_m)
        np.testing.assert_array_equal(one.covariance, other.covariance)


@pytest.mark.slow
def test_forty_steps_at_which_nothing_is_heard(begun):
    """The agent goes on meanwhile, by 3.3 m."""
    found = []
    for kept, recording in begun[:2]:
        slam, scans = copy.copy(kept[SETTLED]), list(recording)[SETTLED:]
        for scan in scans[:40]:
            slam.step(replace(scan, samples=np.zeros_like(scan.samples), heard=np.zeros_like(scan.heard)))
        after = scans[40 : 40 + AFTER]
        found.append(judged([slam.step(scan) for scan in after], after, recording))
    off, squared, _ = (np.array(part) for part in zip(*found, strict=True))
    assert off[:, 1:].max() < 0.3
    assert squared.mean() < 4
