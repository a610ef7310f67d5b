"""The front end: what it finds, what it makes up, and whether its errors are as large as it says."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import shortened
from signal_samples import FREQUENCIES, C, recording, sampled_scene

import gridslam as gs
from gridslam.errors import InputError
from gridslam.extraction.fit import Fit, deviations, noise_power, refit, slopes
from gridslam.extraction.front_end import find_paths
from gridslam.extraction.responses import Band, Products, compose
from gridslam.extraction.search import surprise
from gridslam.simulation.image_source import true_paths
from gridslam.world.scene_parts import ArraySpec
from gridslam.world.waveform import Waveform

BETA = 1e7 * np.sqrt((41**2 - 1) / 12)


def band_of(anchor=(1, 1), agent=(1, 1), spacing=0.4, pulse=None):
    lone = [
        C / 6e9 * ArraySpec(rows=r, columns=c, spacing_wavelengths=spacing).elements
        for r, c in (anchor, agent)
    ]
    pulse = np.ones(41) if pulse is None else pulse
    return Band(Waveform(6e9, FREQUENCIES, pulse, lone[0][None], lone[1]), 0)


def noise_of(band, count, seed):
    draw = np.random.default_rng(seed)
    shape = (count, *band.waveform.shape[1:])
    return (draw.standard_normal(shape) + 1j * draw.standard_normal(shape)) * np.sqrt(0.5)


def received(band, lengths, snr_db, seed, angles=None):
    """Snapshots (S, ...) of paths (S, L) of one SNR and random phases, and the paths (S, L, 3)."""
    draw = np.random.default_rng([seed, 1])
    paths = np.zeros((*lengths.shape, 3))
    paths[..., 0] = lengths
    if angles is not None:
        paths[..., 1:] = angles
    gain = 10 ** (snr_db / 20) * np.exp(2j * np.pi * draw.uniform(size=lengths.shape))
    return noise_of(band, len(lengths), seed) + compose(band, paths, gain), paths


def nearest(fit, length):
    """Which path is nearest to a length (S,), and how far off, (S,)."""
    off = np.where(fit.there, np.abs(fit.paths[..., 0] - length[:, None]), np.inf)
    return off.argmin(1), off.min(1)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.3, 0.1, 0.03])
def test_noise_alone_passes_as_often_as_was_asked_for_whatever_its_power(rate):
    band = band_of()
    for scale in (1.0, 1e-4):
        found = find_paths(band, scale * noise_of(band, 1500, 3), rate).count.mean()
        assert found == pytest.approx(rate, rel=0.5)


@pytest.mark.slow
def test_noise_alone_passes_as_often_with_arrays():
    band = band_of((2, 2), (2, 2))
    assert find_paths(band, noise_of(band, 300, 4), 0.1).count.mean() == pytest.approx(0.1, abs=0.07)


@pytest.mark.slow
@pytest.mark.parametrize("snr", [13, 20, 30])
def test_a_lone_path_is_found_with_the_error_that_is_claimed_and_that_is_possible(snr):
    band = band_of()
    length = np.random.default_rng(1).uniform(2, 25, (800, 1))
    samples, _ = received(band, length, snr, 5)
    fit = find_paths(band, samples, 0.1)
    noise = noise_power(band, fit)
    which, off = nearest(fit, length[:, 0])
    found = off < 0.5
    assert found.mean() > 0.97
    assert (fit.count - found).mean() < 0.2, "and little else"
    rows = np.flatnonzero(found)
    error = fit.paths[rows, which[rows], 0] - length[rows, 0]
    claimed = deviations(band, samples, fit, noise)[rows, which[rows], 0]
    assert np.sqrt(np.mean((error / claimed) ** 2)) == pytest.approx(1.0, abs=0.12)
    bound = C / (np.sqrt(8) * np.pi * BETA * 10 ** (snr / 20))
    assert np.sqrt(np.mean(error**2)) < 1.2 * bound
    assert noise.mean() == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("snr", "apart"), [(20, 0.75), (30, 0.4), (40, 0.2)])
def test_two_paths_within_the_resolution_are_told_apart_where_their_strength_allows(snr, apart):
    band = band_of()
    first = np.random.default_rng(2).uniform(3, 20, 400)
    samples, paths = received(band, np.stack([first, first + apart], -1), snr, 6)
    fit = find_paths(band, samples, 0.1)
    two = (
        (fit.count >= 2)
        & (nearest(fit, paths[:, 0, 0])[1] < apart / 2)
        & (nearest(fit, paths[:, 1, 0])[1] < apart / 2)
    )
    assert two.mean() > 0.75
    spread = deviations(band, samples, fit, noise_power(band, fit))
    errors = []
    for path in range(2):
        which, _ = nearest(fit, paths[:, path, 0])
        rows = np.flatnonzero(two)
        errors.append((fit.paths[rows, which[rows], 0] - paths[rows, path, 0]) / spread[rows, which[rows], 0])
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.2)


def test_deviations_are_those_of_the_radio_for_one_path_and_more_for_two_that_overlap():
    """In phase and 0.3 m apart, two paths keep 11 % of what each tells alone."""
    band = band_of()
    alone = np.array([[[10.0, 0, 0]]])
    samples = compose(band, alone, np.array([[100.0 + 0j]]))
    fit = Fit(alone, np.ones((1, 1), bool), np.array([[100.0 + 0j]]), np.zeros(1), np.zeros(1))
    one = deviations(band, samples, fit, np.ones(1))[0, 0, 0]
    assert one == pytest.approx(C / (np.sqrt(8) * np.pi * BETA * 100), rel=1e-3)
    pair = np.array([[[10.0, 0, 0], [10.3, 0, 0]]])
    gain = np.full((1, 2), 1e4 + 0j)
    products = Products.of(band, compose(band, pair, gain), pair)
    information = 2 * slopes(products, np.ones((1, 2), bool), np.zeros(1))[1][0]
    kept = information / (8 * np.pi**2 * BETA**2 * 1e8 / C**2)
    assert np.diagonal(kept) == pytest.approx([0.11, 0.11], abs=0.01)


@pytest.mark.parametrize("ridge", [0.0, 0.3])
def test_slopes_are_those_of_the_energy_by_finite_differences(ridge):
    band = band_of((2, 2), (1, 3))
    draw = np.random.default_rng(8)
    paths = np.concatenate([draw.uniform(3, 9, (1, 3, 1)), draw.uniform(-3, 3, (1, 3, 2))], -1)
    samples = noise_of(band, 1, 9) + compose(band, paths + 0.02, draw.normal(size=(1, 3)) * 30 + 0j)
    there = np.array([[True, True, False]])
    ridge = np.full(1, ridge)
    gradient = slopes(Products.of(band, samples, paths), there, ridge)[0][0].reshape(3, 3)

    def energy(moved):
        none = np.zeros((1, 3), complex)
        return refit(band, samples, Fit(moved, there, none, np.zeros(1), ridge)).energy[0]

    for factor in range(3):
        for path in range(3):
            nudge = np.zeros((1, 3, 3))
            nudge[0, path, factor] = 1e-5
            numeric = (energy(paths + nudge) - energy(paths - nudge)) / 2e-5
            assert -2 * gradient[factor, path] == pytest.approx(numeric, rel=1e-4, abs=1e-4)


@pytest.mark.slow
@given(
    length=st.floats(1, 28),
    leaving=st.floats(-3, 3),
    arriving=st.floats(-3, 3),
    scale=st.sampled_from([1e-6, 1.0, 1e5]),
)
@settings(max_examples=15, deadline=None)
def test_one_clean_path_is_found_exactly_in_any_scale(length, leaving, arriving, scale):
    band = band_of((2, 2), (2, 2))
    samples, paths = received(band, np.array([[length]]), 60.0, 7, np.array([leaving, arriving]))
    fit = find_paths(band, scale * samples, 1e-3)
    assert fit.count[0] == 1
    off = np.exp(1j * fit.paths[0, 0, 1:]) - np.exp(1j * paths[0, 0, 1:])
    assert fit.paths[0, 0, 0] == pytest.approx(length, abs=1e-3)
    assert np.abs(off).max() < 0.01


def test_pulses_weigh_frequencies_and_a_path_is_as_sharp_as_its_pulse():
    pulse = np.hanning(43)[1:-1]
    band = band_of(pulse=pulse)
    samples, _ = received(band, np.full((300, 1), 7.0), 30.0, 11)
    fit = find_paths(band, samples, 0.1)
    which, off = nearest(fit, np.full(300, 7.0))
    claimed = deviations(band, samples, fit, noise_power(band, fit))[np.arange(300), which, 0]
    share = pulse**2 / (pulse**2).sum()
    width = np.sqrt((share * FREQUENCIES**2).sum())
    assert np.median(claimed) == pytest.approx(C / (np.sqrt(8) * np.pi * width * 10**1.5), rel=0.05)
    assert np.sqrt(np.mean((off / claimed) ** 2)) == pytest.approx(1.0, abs=0.15)


def test_angles_are_told_relative_to_the_devices_and_none_by_elements_in_a_line():
    scene = sampled_scene(
        radio={"snr_at_1m_db": 60.0, "array": {"rows": 2, "columns": 2, "spacing_wavelengths": 0.4}}
    )
    truth = true_paths(scene, "me")
    measurements = gs.extract(gs.simulate(scene, "me", 1, what="signal"), false_alarms=1e-3)
    assert measurements.step.tolist() == [0, 1, 2]
    assert measurements.distance_m == pytest.approx(truth.distance_m, abs=0.01)
    assert measurements.aod_rad == pytest.approx(truth.aod_rad, abs=0.01)
    assert measurements.aoa_rad == pytest.approx(truth.aoa_rad, abs=0.01)
    assert measurements.amplitude == pytest.approx(truth.amplitude, rel=0.2)
    flat = sampled_scene(
        radio={"snr_at_1m_db": 60.0, "array": {"rows": 2, "columns": 1, "spacing_wavelengths": 0.4}},
        array={"rows": 1, "columns": 1},
    )
    measurements = gs.extract(gs.simulate(flat, "me", 1, what="signal"), false_alarms=1e-3)
    assert np.isnan(measurements.aod_rad).all()
    assert np.isnan(measurements.aoa_rad).all()
    assert measurements.aod_std_rad is None
    assert measurements.distance_m == pytest.approx(truth.distance_m, abs=0.01)


def test_missing_snapshots_give_no_rows_and_all_steps_are_there():
    scene = sampled_scene(radio={"snr_at_1m_db": 50.0})
    whole = gs.simulate(scene, "me", 1, what="signal")
    part = replace(whole, heard=np.array([[True], [False], [True]]))
    measurements = gs.extract(part)
    assert (len(measurements), sorted(set(measurements.step))) == (3, [0, 2])
    assert measurements.truth == whole.truth
    assert measurements.anchor_position_m == pytest.approx(scene.anchor_positions)


def test_nothing_found_is_a_table_without_rows_and_the_scene_sets_the_threshold():
    quiet = recording(noise_of(band_of(), 5, 1)[:, 0, 0][:, None])
    assert len(gs.extract(quiet, false_alarms=1e-6)) == 5
    scene = sampled_scene(radio={"false_alarms": 1.0, "detection_threshold_db": 11.0})
    measurements = gs.extract(replace(quiet), scene)
    assert (measurements.amplitude > 10 ** (11 / 20)).all()


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, 11.0])
def test_what_cannot_be_asked_for_is_refused(rate):
    with pytest.raises(InputError, match="false_alarms"):
        gs.extract(recording(), false_alarms=rate)


def test_a_scene_of_other_anchors_is_refused():
    with pytest.raises(InputError, match="anchors"):
        gs.extract(recording(), gs.Scene.load("room"))


@pytest.mark.slow
def test_examples_of_the_docs_do_what_they_say(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).resolve().parents[2] / "docs" / "signals.md").read_text(encoding="utf-8")
    names = {}
    for block in re.findall(r"^```python\n(.*?)^```", page, re.M | re.S):
        exec(compile(block, "signals.md", "exec"), names)
    assert capsys.readouterr().out == "[5.  5.1 5.2]\n"


def test_a_scene_whose_radio_measures_distances_alone_gets_these_alone():
    scene = sampled_scene(radio={"snr_at_1m_db": 50.0, "measures": ("distance",)})
    measurements = gs.extract(gs.simulate(scene, "me", 1, what="signal"), scene)
    assert len(measurements.step)
    assert np.isnan(measurements.amplitude).all()
    assert (measurements.distance_std_m > 0).all()


@pytest.mark.slow
def test_virtual_anchors_follow_what_was_found_among_overlapping_fading_paths():
    scene = shortened(gs.Scene.load("overlap"), 50)
    measurements = gs.extract(gs.simulate(scene, "agent1", 0, what="signal"), scene)
    run = gs.map_scene(scene, measurements, "va", seed=0)
    assert run.score(gs.ground_truth(scene, "agent1"))["position_rmse_m"] < 0.08


@pytest.mark.slow
def test_paths_that_are_needed_no_longer_beside_later_ones_are_taken_out(monkeypatch):
    band = band_of()
    first = np.random.default_rng(3).uniform(3, 15, (250, 1))
    samples, _ = received(band, first + 0.6 * np.arange(6), 40.0, 12)
    right = (find_paths(band, samples, 0.1).count == 6).mean()
    monkeypatch.setattr(
        "gridslam.extraction.front_end._without_weakest", lambda band, samples, fit, believed, needed: fit
    )
    assert right > (find_paths(band, samples, 0.1).count == 6).mean() + 0.01


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 1e-5])
def test_paths_that_melt_into_one_do_not_cancel_with_amplitudes_beyond_the_strongest_peak(scale):
    band = band_of()
    first = np.random.default_rng(4).uniform(3, 20, (150, 1))
    samples, _ = received(band, first + 0.25 * np.arange(4), 30.0, 13)
    peak = np.abs(find_paths(band, scale * samples, 0.1, most=1).amplitude)[:, 0]
    fit = find_paths(band, scale * samples, 0.1)
    assert fit.count.mean() > 1.5
    assert (np.abs(fit.amplitude).max(1) < 4 * peak).all()


def test_energy_is_what_is_left_and_the_amplitudes_share_and_noise_is_what_is_left_alone():
    band = band_of()
    samples, paths = received(band, np.array([[5.0, 5.4]]), 20.0, 14)
    none = np.zeros((1, 2), complex)
    fit = refit(band, samples, Fit(paths, np.ones((1, 2), bool), none, np.zeros(1), np.full(1, 0.2)))
    left = (np.abs(samples - compose(band, paths, fit.amplitude)) ** 2).sum()
    own = (np.abs(fit.amplitude) ** 2).sum()
    assert fit.energy[0] == pytest.approx(left + 0.2 * own)
    assert noise_power(band, fit)[0] == pytest.approx(left / (41 - 3))


def test_lengths_and_angles_of_paths_before_take_part_of_the_noise_as_amplitudes_do():
    for size, parameters in ((((1, 1), (1, 1)), 1), (((2, 2), (2, 2)), 3)):
        band = band_of(*size)
        first = band.samples - 1
        second = band.samples - 2 - 0.5 * parameters
        left, height = np.full(1, 3.0), 9.0
        found = [
            surprise(band, left * np.expm1(height / freedom), left, np.array([count]))
            for count, freedom in ((1, first), (2, second))
        ]
        np.testing.assert_allclose(found[0], found[1])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "samples", [1j * np.ones((1, 41)), np.exp(-2j * np.pi * FREQUENCIES * 5.0 / C)[None]]
)
def test_samples_without_any_noise_are_measured_without_a_warning(samples):
    """What is left over beside their paths is rounding, which may be less than nothing."""
    found = gs.extract(recording(np.tile(samples, (3, 1, 1))), false_alarms=0.01)
    assert len(found) == 3
    for column in (found.amplitude, found.distance_std_m):
        assert np.isfinite(column).all()
        assert (column > 0).all()
