"""Direct SLAM as published: it follows, repeats itself, and goes on from checkpoints."""

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.systems.published.direct_paper import PublishedDirectSlam

STEPS = 16


@pytest.fixture(scope="module")
def world():
    scene = short("overlap", STEPS, particles=800)
    return scene, gs.simulate(scene, "agent1", 2, what="signal")


@pytest.mark.slow
def test_it_follows_its_agent_and_goes_on_bit_for_bit(world, tmp_path):
    scene, recording = world
    slam = PublishedDirectSlam(scene, waveform=recording.waveform, seed=5)
    for scan in recording:
        if scan.step == 10:
            slam.save(tmp_path / "a.h5")
            again = PublishedDirectSlam.resume(tmp_path / "a.h5")
        estimate = slam.step(scan)
        if scan.step >= 10:
            np.testing.assert_array_equal(estimate.covariance, again.step(scan).covariance)
        off = estimate.position_m - recording.truth.position_m[scan.step]
        assert np.linalg.norm(off) < 0.5  # 0.33 at most in eight seeds
    assert estimate.detected.sum() > 2
    assert slam.state.noise.mean() == pytest.approx(1.0, rel=0.5)
