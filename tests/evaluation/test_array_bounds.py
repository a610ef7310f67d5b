"""Bounds on samples of arrays: against those of single antennas and of paths, and what overlap costs."""

import numpy as np
import pytest
from array_snapshots import band_of

import gridslam as gs
from gridslam.evaluation.array_bounds import array_bound, snapshot_information
from gridslam.evaluation.bounds import known_map_bound, unknown_map_bound
from gridslam.evaluation.ground_truth import known_bound
from gridslam.evaluation.signal_bounds import distance_information
from gridslam.inference.messages.samples.array_likelihood import ArrayBand
from gridslam.inference.messages.samples.signal_likelihood import Band

BAND = band_of(3, 3, 31)


def short(steps=12, **radio):
    data = gs.Scene.load("chamber").model_dump(exclude_none=True)
    data["agents"][0]["steps"] = steps
    data["radio"] |= radio
    for key in ("bandwidth_hz", "max_distance_m"):
        data["radio"].pop(key, None)
    return gs.Scene.checked(data, "chamber")


@pytest.mark.slow
def test_one_antenna_is_the_information_of_distances():
    single = ArrayBand(BAND.wavenumber, BAND.pulse, np.zeros((1, 2)), np.zeros((1, 2)))
    path = np.array([[3.0, 0.4, 1.0], [3.6, 0.4, 1.0]])
    amplitude = np.array([20, 12j - 4])
    found = snapshot_information(single, path, amplitude, np.abs(amplitude) ** 2)
    expected = distance_information(
        Band(BAND.wavenumber, BAND.pulse), path[:, 0], amplitude, np.abs(amplitude) ** 2
    )
    np.testing.assert_allclose(found[::3, ::3], expected, rtol=1e-9)


@pytest.mark.slow
def test_paths_apart_tell_what_each_tells_and_overlapping_ones_less():
    amplitude = np.array([40.0 + 0j, 30.0])

    def information_with(second):
        path = np.array([[3.0, 0.4, 1.0], second])
        return snapshot_information(BAND, path, amplitude, np.abs(amplitude) ** 2)

    alone = snapshot_information(BAND, np.array([[3.0, 0.4, 1.0]]), amplitude[:1], np.array([1600.0]))
    apart, near = information_with([7.0, -2.0, -1.5]), information_with([3.1, 0.5, 1.1])
    np.testing.assert_allclose(apart[:3, :3], alone, rtol=0.05, atol=0.05 * alone.max())
    assert near[0, 0] < 0.6 * alone[0, 0]


def test_it_is_below_that_of_the_map_unknown_and_near_that_of_paths_where_these_are_apart():
    scene = short(frequencies=201, snr_at_1m_db=40.0)  # 2.5 GHz: paths are apart, and heard
    known, unknown = (array_bound(scene, "agent1", which) for which in (True, False))
    assert (known.position_m <= unknown.position_m * (1 + 1e-9)).all()
    paths = known_map_bound(scene, "agent1")
    np.testing.assert_allclose(known.position_m[3:], paths.position_m[3:], rtol=0.08)
    np.testing.assert_allclose(known.heading_rad[3:], paths.heading_rad[3:], rtol=0.08)
    apart = unknown_map_bound(scene, "agent1")
    np.testing.assert_allclose(unknown.position_m[3:], apart.position_m[3:], rtol=0.1)


def test_runs_on_samples_of_arrays_are_judged_by_it():
    scene = short(4)
    truth = gs.ground_truth(scene, "agent1")
    found = known_bound(scene, "agent1", truth, "signal")
    np.testing.assert_allclose(found.position_m, array_bound(scene, "agent1", True).position_m)
    assert np.isfinite(found.heading_rad).all()


def test_no_bound_is_given_where_scatterers_tell_samples_more_than_walls_do():
    data = gs.Scene.load("scatter").model_dump(exclude_none=True)
    data["agents"][0]["steps"] = 2
    data["scatterers"] = data["scatterers"][:1]
    scene = gs.Scene.checked(data, "scatter")
    truth = gs.ground_truth(scene, "agent1")
    assert known_bound(scene, "agent1", truth, "signal") is None
    assert known_bound(scene, "agent1", truth, "paths") is not None  # no filter of paths makes use of them
    bare = gs.Scene.checked(data | {"scatterers": []}, "scatter")
    assert known_bound(bare, "agent1", gs.ground_truth(bare, "agent1"), "signal") is not None


def test_a_measured_heading_is_worth_its_deviation():
    data = short(4).model_dump(exclude_none=True)
    data["agents"][0]["heading_sensor_deg"] = 0.5
    found = array_bound(gs.Scene.checked(data, "chamber"), "agent1", True)
    assert found.heading_rad.max() <= np.radians(0.5)


def test_fading_amplitudes_tell_less_on_average():
    steady, fading = (array_bound(short(6, fading=kind), "agent1", True) for kind in ("steady", "swerling1"))
    assert fading.position_m[1:].mean() > steady.position_m[1:].mean()
