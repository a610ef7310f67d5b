"""Angles are told where the snapshot tells them, and left out where another direction fits as well."""

import numpy as np
import pytest
from signal_samples import FREQUENCIES, C, sampled_scene

import gridslam as gs
from gridslam.extraction.ambiguity import MOST_ENTRIES, _Gain, ambiguous
from gridslam.extraction.fit import Fit, deviations, noise_power, refit
from gridslam.extraction.front_end import find_paths
from gridslam.extraction.responses import Band, compose
from gridslam.world.geometry import wrap
from gridslam.world.scene_parts import ArraySpec
from gridslam.world.waveform import Waveform


def band_of(spacing, agent=2, anchor=1):
    ends = [
        C / 6e9 * ArraySpec(rows=n, columns=n, spacing_wavelengths=spacing).elements for n in (anchor, agent)
    ]
    return Band(Waveform(6e9, FREQUENCIES, np.ones(41), ends[0][None], ends[1]), 0)


def heard(band, paths, snr_db, seed):
    """Snapshots (S, ...) of paths (S, L, 3) with random phases in noise of power 1."""
    draw = np.random.default_rng(seed)
    gain = 10 ** (snr_db / 20) * np.exp(2j * np.pi * draw.random(paths.shape[:2]))
    noise = draw.standard_normal((2, len(paths), *band.waveform.shape[1:])) * np.sqrt(0.5)
    return compose(band, paths, gain) + noise[0] + 1j * noise[1]


def judged(band, paths, snr_db, seed):
    """Errors over claims (S,) of the AoA of the one path, and whether it is left open."""
    samples = heard(band, paths, snr_db, seed)
    fit = find_paths(band, samples, 0.01)
    noise = noise_power(band, fit)
    spread = deviations(band, samples, fit, noise)
    off = np.abs(fit.paths[..., 0] - paths[:, :1, 0])
    row, which = np.arange(len(off)), np.where(fit.there, off, np.inf).argmin(1)
    error = wrap(fit.paths[row, which, 2] - paths[:, 0, 2]) / spread[row, which, 2]
    return error, ambiguous(band, samples, fit, spread, noise)[row, which, 2]


def anywhere(count, seed):
    draw = np.random.default_rng(seed)
    length, angle = draw.uniform(3, 20, count), draw.uniform(-np.pi, np.pi, count)
    return np.stack([length, np.zeros(count), angle], -1)[:, None]


@pytest.mark.slow
@pytest.mark.parametrize("snr_db", [15, 20, 30])
def test_no_angle_is_told_that_may_be_the_opposite_and_others_are_as_good_as_claimed(snr_db):
    error, is_open = judged(band_of(0.5), anywhere(400, 1), snr_db, 2)
    wrong = np.abs(error) > 5
    assert wrong.mean() > 0.1, "half a wavelength leaves opposites"
    assert wrong[~is_open].mean() < 0.03
    assert 0.2 < is_open.mean() < 0.75
    assert np.sqrt(np.mean(error[~is_open & ~wrong] ** 2)) == pytest.approx(1.1, abs=0.25)


@pytest.mark.slow
def test_arrays_that_tell_all_directions_lose_none():
    for spacing, size in ((0.4, 2), (0.25, 3)):
        error, is_open = judged(band_of(spacing, size), anywhere(300, 3), 20, 4)
        assert is_open.mean() < 0.01
        assert (np.abs(error) > 5).mean() < 0.01


def test_a_direction_along_an_axis_is_open_at_any_strength_and_one_between_them_at_none():
    band = band_of(0.5)
    along, between = np.array([[[8.0, 0, 0.0]]]), np.array([[[8.0, 0, 0.25 * np.pi]]])
    assert all(judged(band, along, snr_db, 5)[1].all() for snr_db in (20, 40, 60))
    assert not any(judged(band, between, snr_db, 5)[1].any() for snr_db in (20, 40, 60))


def test_a_path_beside_others_is_judged_by_what_they_leave():
    """The energy that is gained is that which is lost without the path, the others fitted anew."""
    band = band_of(0.4, 3, 2)
    paths = np.array([[[8.0, 0.3, 1.0], [8.2, 0.5, 1.4], [8.3, -2.0, 0.9]]])
    samples = heard(band, paths, 25, 6)
    none = np.zeros((1, 3), complex)
    fit = refit(band, samples, Fit(paths, np.array([[True, True, False]]), none, np.zeros(1), np.zeros(1)))
    for factor in (1, 2):
        moved = paths.copy()
        moved[0, 0, factor] += 0.4
        there = np.array([[False, True, False]])
        without = refit(band, samples, Fit(paths, there, none, np.zeros(1), np.zeros(1)))
        other = refit(band, samples, Fit(moved, fit.there, none, np.zeros(1), np.zeros(1)))
        gain = _Gain(band, samples, fit, factor)(np.broadcast_to(moved[..., factor, None], (1, 3, 1)))
        assert gain[0, 0, 0] == pytest.approx(without.energy[0] - other.energy[0], rel=1e-6)


@pytest.mark.slow
def test_many_snapshots_are_worked_at_in_parts_with_the_same_outcome(monkeypatch):
    band, paths = band_of(0.5), anywhere(40, 7)
    whole = judged(band, paths, 18, 8)[1]
    assert 40 * 32 < MOST_ENTRIES
    monkeypatch.setattr("gridslam.extraction.ambiguity.MOST_ENTRIES", 100)
    np.testing.assert_array_equal(whole, judged(band, paths, 18, 8)[1])


@pytest.mark.slow
def test_extracted_tables_leave_such_angles_empty_and_keep_the_rest_of_the_path(tmp_path):
    scene = gs.Scene.load("screen")
    found = gs.extract(gs.simulate(scene, "agent1", 1, what="signal"), scene)
    is_open = np.isnan(found.aoa_rad)
    assert 0.3 < is_open.mean() < 0.8
    np.testing.assert_array_equal(is_open, np.isnan(found.aoa_std_rad))
    assert np.isfinite(found.distance_m).all()
    assert np.isfinite(found.amplitude).all()
    found.to_csv(tmp_path / "heard.csv")
    back = gs.Measurements.from_csv(tmp_path / "heard.csv", scene.anchor_names)
    np.testing.assert_array_equal(back.aoa_rad, found.aoa_rad)


def test_nothing_found_leaves_nothing_open():
    band = band_of(0.5)
    samples = np.zeros((3, *band.waveform.shape[1:]), complex)
    assert ambiguous(band, samples, Fit.none(samples), np.zeros((3, 0, 3)), np.ones(3)).shape == (3, 0, 3)


def test_both_ends_are_judged_each_by_itself():
    scene = sampled_scene(
        radio={"snr_at_1m_db": 60.0, "array": {"rows": 2, "columns": 2, "spacing_wavelengths": 0.5}},
        array={"rows": 2, "columns": 2, "spacing_wavelengths": 0.4},
        anchor_deg=float(np.degrees(np.arctan2(4, 3))),
    )
    found = gs.extract(gs.simulate(scene, "me", 1, what="signal"), false_alarms=1e-3)
    assert np.isnan(found.aod_rad).all(), "the agent is straight ahead of the anchor's array"
    assert np.isfinite(found.aoa_rad).all()


@pytest.mark.slow
def test_grid_slam_keeps_to_its_way_on_paths_of_an_array_that_leaves_opposites():
    """Told opposites as if they were sure, it was metres off."""
    scene = gs.Scene.load("screen")
    found = gs.extract(gs.simulate(scene, "agent1", 2, what="signal"), scene)
    run = gs.map_scene(scene, found, seed=2, particles=512)
    assert run.score(gs.ground_truth(scene, "agent1"))["position_rmse_m"] < 0.8
