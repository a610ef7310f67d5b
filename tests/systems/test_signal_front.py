"""The front of methods on samples: what is handed over, refused, kept and gone on from."""

from dataclasses import replace

import numpy as np
import pytest
from echo_slam import EchoFilter
from signal_samples import sampled_scene

import gridslam as gs
from gridslam.errors import InputError
from gridslam.systems import values

STRONG = {"snr_at_1m_db": 60.0}


@pytest.fixture(scope="module")
def scene():
    return sampled_scene(radio=STRONG, prior={"position_m": 0.1, "velocity_mps": 0.01, "heading_deg": 10.0})


@pytest.fixture(scope="module")
def recording(scene):
    return gs.simulate(scene, "me", 1, what="signal")


def test_a_filter_on_samples_follows_its_agent_and_says_so(scene, recording):
    slam = EchoFilter(scene, waveform=recording.waveform)
    off = [
        np.linalg.norm(slam.step(scan).position_m - recording.truth.position_m[scan.step])
        for scan in recording
    ]
    assert max(off) < 0.15
    assert slam.info == {"anchors": 1}
    assert slam.state.step == len(recording)
    assert slam.map().shape == scene.grid.shape


def test_it_goes_on_from_its_checkpoint_bit_for_bit_with_its_waveform(scene, recording, tmp_path):
    noisy = replace(recording.waveform, noise_std=np.array([2.0]))
    slam = EchoFilter(scene, waveform=noisy, seed=3)
    slam.step(recording.scan(0))
    slam.save(tmp_path / "a.h5")
    again = EchoFilter.resume(tmp_path / "a.h5")
    assert again.waveform.noise_std.tolist() == [2.0]
    assert np.array_equal(again.waveform.offset_hz, noisy.offset_hz)
    assert again.state.levels[0].noise == slam.state.levels[0].noise
    for scan in (recording.scan(1), recording.scan(2)):
        assert np.array_equal(slam.step(scan).covariance, again.step(scan).covariance)
    assert np.array_equal(slam.state.mean, again.state.mean)
    assert slam.now.identity == again.now.identity
    with pytest.raises(InputError, match="method"):
        gs.GridSlam.resume(tmp_path / "a.h5")


def test_a_state_without_some_of_its_parts_comes_back_without_them(scene, tmp_path):
    slam = EchoFilter(scene)
    slam.save(tmp_path / "a.h5")
    state = EchoFilter.resume(tmp_path / "a.h5").state
    assert (state.time_s, state.levels[0].noise, state.levels[0].count) == (None, None, 0)


@pytest.mark.parametrize(
    ("name", "spoil", "says"),
    [
        ("mean", lambda x: np.full(4, np.nan), "finite"),
        ("mean", lambda x: x.reshape(2, 2), "axes"),
        ("mean", lambda x: x.astype(complex), "numbers"),
        ("covariance", lambda x: -x, "positive"),
        ("covariance", lambda x: x + np.eye(4, k=1), "symmetric"),
        ("covariance", lambda x: x[:3], "square"),
        ("offset_hz", lambda x: x[::-1].copy(), "rising"),
    ],
)
def test_a_checkpoint_that_cannot_be_is_refused(scene, tmp_path, monkeypatch, name, spoil, says):
    slam, put = EchoFilter(scene), values.put
    with monkeypatch.context() as patch:
        patch.setattr(
            values, "put", lambda group, own, x, unit: put(group, own, spoil(x) if own == name else x, unit)
        )
        slam.save(tmp_path / "a.h5")
    with pytest.raises(InputError, match=says):
        EchoFilter.resume(tmp_path / "a.h5")


def test_the_other_kind_of_observation_is_refused_by_its_name(scene, recording):
    paths = gs.simulate(scene, "me", 1)
    with pytest.raises(InputError, match=r"EchoFilter.step.*path measurements"):
        EchoFilter(scene).step(paths.scan(0))
    slam = gs.GridSlam(scene)
    before = slam.state
    with pytest.raises(InputError, match=r"GridSlam.step.*sampled signals.*extract"):
        slam.step(recording.scan(0))
    assert slam.state is before


def test_scans_that_make_no_sense_leave_the_state_alone(scene, recording):
    slam = EchoFilter(scene)
    slam.step(recording.scan(1))
    before = slam.state
    for wrong in (recording.scan(0), replace(recording.scan(2), samples=np.ones((1, 1, 1, 40)))):
        with pytest.raises(InputError, match=r"time_s|shape"):
            slam.step(wrong)
    assert slam.state is before


def test_a_start_is_told_before_the_first_step_alone(scene, recording):
    slam = EchoFilter(scene)
    slam.start_at([3.05, 4.0], 0.0)
    assert slam.state.mean[:2].tolist() == [3.05, 4.0]
    slam.step(recording.scan(0))
    with pytest.raises(InputError, match="before the first"):
        slam.start_at([3.0, 4.0], 0.0)


def test_a_waveform_must_be_of_the_scenes_anchors_and_there(scene):
    with pytest.raises(InputError, match=r"radio.frequencies"):
        EchoFilter(gs.Scene.load("room"))
    two = gs.Scene.load("overlap").waveform("agent1")
    with pytest.raises(InputError, match="2 anchors"):
        EchoFilter(scene, waveform=two)


def test_the_identity_of_a_run_is_that_of_its_samples(scene, recording):
    one, two, other = (EchoFilter(scene) for _ in range(3))
    for slam, scan in ((one, recording.scan(0)), (two, recording.scan(0))):
        slam.step(scan)
    other.step(replace(recording.scan(0), samples=2 * recording.scan(0).samples))
    assert one.now.identity == two.now.identity != other.now.identity
