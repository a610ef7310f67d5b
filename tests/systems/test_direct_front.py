"""Direct SLAM by the doors of all methods: estimates, maps, health, checkpoints, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.errors import InputError
from gridslam.systems import values

STEPS, SAVED = 60, 45


@pytest.fixture(scope="module")
def scene():
    return short("overlap", STEPS)


@pytest.fixture(scope="module")
def recording(scene):
    return gs.simulate(scene, "agent1", seed=1, what="signal")


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """Where `ran` leaves its checkpoint, written before step `SAVED`."""
    return tmp_path_factory.mktemp("direct") / "a.h5"


@pytest.fixture(scope="module")
def ran(scene, recording, checkpoint):
    slam = gs.DirectSlam(scene, waveform=recording.waveform)
    estimates = []
    for scan in recording:
        if scan.step == SAVED:
            assert len(slam.state.images)
            assert len(slam.state.tentative)
            slam.save(checkpoint)
        estimates.append(slam.step(scan))
    return slam, estimates


@pytest.mark.slow
def test_estimates_hold_agent_surfaces_and_paths(scene, recording, ran):
    last = ran[1][-1]
    assert np.linalg.norm(last.position_m - recording.truth.position_m[-1]) < 0.1
    assert last.surfaces.owner.tolist() == ran[0].state.images.anchor.tolist()
    assert last.detected.all()
    lengths = np.linalg.norm(np.diff(last.paths.points[:, [0, 1, 3]], axis=1), axis=-1).sum(1)
    single = last.paths.surfaces[:, 0] >= 0
    np.testing.assert_allclose(lengths[single], last.paths.distance_m[single], atol=1e-9)
    assert (~single).sum() == 2
    loudest = last.paths.amplitude.max() ** 2
    assert 10 < 10 * np.log10(loudest) < 40


def test_heading_is_that_of_the_motion_and_unknown_at_rest(scene, recording, ran):
    truth = recording.truth.heading_rad[-1]
    last = ran[1][-1]
    deviation = np.sqrt(last.covariance[4, 4])
    assert np.abs(np.remainder(last.heading_rad - truth + np.pi, 2 * np.pi) - np.pi) < 4 * deviation
    assert deviation < 0.6
    first = gs.DirectSlam(scene).step(recording.scan(0))
    assert first.covariance[4, 4] <= np.pi**2 / 3 + 1e-9
    assert np.linalg.eigvalsh(first.covariance).min() > -1e-12


def test_map_holds_the_surfaces_behind_the_images(scene, ran, tmp_path):
    sheet = ran[0].map()
    assert len(sheet.surfaces) == len(ran[0].state.images)
    sheet.save(tmp_path / "map.h5")
    again = gs.Map.load(tmp_path / "map.h5")
    np.testing.assert_array_equal(again.surfaces.line, sheet.surfaces.line)
    assert not sheet.observed.any()


@pytest.mark.slow
def test_it_goes_on_from_a_checkpoint_bit_for_bit(recording, ran, checkpoint):
    slam, estimates = ran
    again = gs.DirectSlam.resume(checkpoint)
    for number in range(SAVED, STEPS):
        other = again.step(recording.scan(number))
        np.testing.assert_array_equal(estimates[number].covariance, other.covariance)
    for name, array in values.arrays_of(slam.state).items():
        np.testing.assert_array_equal(array, values.arrays_of(again.state)[name], err_msg=name)


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("visible", lambda x: x + 2.0),
        ("noise", lambda x: -x),
        ("anchor", lambda x: x + 7),
        ("existence", lambda x: x - 2.0),
        ("mean", lambda x: x[..., :-1]),
    ],
)
def test_a_checkpoint_whose_numbers_cannot_be_is_refused(ran, tmp_path, monkeypatch, name, spoil):
    put = values.put
    with monkeypatch.context() as patch:
        patch.setattr(
            values, "put", lambda group, own, x, unit: put(group, own, spoil(x) if own == name else x, unit)
        )
        ran[0].save(tmp_path / "a.h5")
    with pytest.raises(InputError):
        gs.DirectSlam.resume(tmp_path / "a.h5")


@pytest.mark.slow
def test_a_filter_that_is_lost_says_so(scene, recording, ran):
    assert all(estimate.health.ok for estimate in ran[1]), [e.health.why for e in ran[1]]
    slam = gs.DirectSlam(scene, waveform=recording.waveform)
    slam.start_at([4.5, 3.5], 0.0)  # 3 m off, with a prior of 0.1 m
    assert any(not slam.step(scan).health.ok and scan.step >= 10 for scan in recording)
    slam = gs.DirectSlam(scene, waveform=recording.waveform)
    for number in range(8):
        scan = recording.scan(number)
        last = slam.step(replace(scan, heard=np.zeros(2, bool)))
    assert "nothing heard" in last.health.why


def test_arrays_are_refused_by_name(scene):
    data = scene.model_dump(exclude_none=True)
    data["radio"]["array"] = {"rows": 2, "columns": 1, "spacing_wavelengths": 0.5}
    with pytest.raises(InputError, match="one at either end"):
        gs.DirectSlam(gs.Scene.checked(data, "overlap"))


def test_a_known_start_of_the_noise_is_taken(scene, recording):
    waveform = replace(recording.waveform, noise_std=np.array([3.0, 4.0]))
    np.testing.assert_allclose(gs.DirectSlam(scene, waveform=waveform).state.links.noise, [9.0, 16.0])


@pytest.mark.slow
def test_map_scene_scores_it():
    scene = short("overlap", 15)
    run = gs.map_scene(scene, gs.simulate(scene, "agent1", seed=1, what="signal"), "direct")
    assert run.method == "direct"
    assert 0 < run.score(gs.ground_truth(scene, "agent1"))["position_rmse_m"] < 0.1
