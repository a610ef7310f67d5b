"""The likelihood of samples against dense algebra, numbers worked out by hand, and its own statistics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.evaluation.signal_bounds import distance_information
from gridslam.inference.messages.samples.distance_mode import PathPrior, joint_mode
from gridslam.inference.messages.samples.signal_likelihood import (
    Band,
    Inverse,
    log_densities,
    log_ratio,
    superpose,
)

LIGHT = 299_792_458.0
M, STEP = 41, 1e7
FLAT = Band.of(STEP * (np.arange(M) - 20))
SHAPED = Band.of(STEP * (np.arange(M) - 20), np.hanning(M + 2)[1:-1] * np.exp(0.3j * np.arange(M)))


def world(seed: int, band: Band = FLAT, paths: int = 3, noise: float = 1.3):
    """Samples of some paths with random distances, powers and amplitudes."""
    rng = np.random.default_rng(seed)
    distance, weight = np.sort(rng.uniform(2, 12, paths)), 10 ** rng.uniform(0, 3, paths)
    amplitude = np.sqrt(weight / 2) * (rng.normal(size=paths) + 1j * rng.normal(size=paths))
    rest = np.sqrt(noise / 2) * (rng.normal(size=M) + 1j * rng.normal(size=M))
    return distance, weight, noise, amplitude @ band.response(distance) + rest, amplitude


def dense(band: Band, distance, weight, noise):
    """C of the model, written down."""
    column = band.response(distance).T
    return noise * np.eye(M) + (column * weight) @ column.conj().T


@pytest.mark.parametrize("band", [FLAT, SHAPED], ids=["flat", "shaped"])
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), paths=st.integers(1, 8))
def test_density_is_that_of_the_dense_covariance(band, seed, paths):
    distance, weight, noise, samples, _ = world(seed, band, paths)
    covariance = dense(band, distance, weight, noise)
    expected = -np.linalg.slogdet(covariance)[1] - np.vdot(samples, np.linalg.solve(covariance, samples)).real
    found = superpose(band, samples, distance, weight, noise)
    assert found.log_density == pytest.approx(expected, rel=1e-9)
    several = log_densities(band, samples, np.stack([distance, distance + 0.1]), weight, noise)
    assert several[0] == pytest.approx(expected, rel=1e-9)
    assert several[1] != pytest.approx(expected, rel=1e-9)
    inverse = np.linalg.inv(covariance)
    rest = noise * inverse @ samples
    expected = np.vdot(rest, rest).real / (noise**2 * np.trace(inverse).real)
    assert found.rest_power / (noise * found.unexplained) == pytest.approx(expected, rel=1e-7)


def test_correlation_is_the_dirichlet_kernel():
    gap = np.array([0.0, 0.3, 0.75, -2.0, LIGHT / STEP - 1.0])
    turn = STEP * gap / LIGHT
    with np.errstate(invalid="ignore"):
        dirichlet = np.sin(np.pi * M * turn) / (M * np.sin(np.pi * turn))
    dirichlet[0] = 1.0
    np.testing.assert_allclose(FLAT.correlation(gap), dirichlet, atol=1e-9)
    pair = SHAPED.response(np.array([3.0, 3.3]))
    assert SHAPED.correlation(0.3) == pytest.approx(np.vdot(pair[0], pair[1]))
    assert FLAT.folding_m == pytest.approx(LIGHT / STEP)
    assert FLAT.resolution_m == pytest.approx(LIGHT / 4e8)


@pytest.mark.parametrize("band", [FLAT, SHAPED], ids=["flat", "shaped"])
def test_gradient_is_the_slope_of_the_density(band):
    distance, weight, noise, samples, _ = world(3, band)
    found = superpose(band, samples, distance, weight, noise).gradient
    for n, step in enumerate(1e-6 * np.eye(3)):
        ahead, back = (
            superpose(band, samples, distance + s, weight, noise).log_density for s in (step, -step)
        )
        assert found[n] == pytest.approx((ahead - back) / 2e-6, rel=1e-5, abs=1e-5)


def test_one_strong_path_tells_what_its_bandwidth_allows():
    power = 1e6
    beta = STEP * np.sqrt((M**2 - 1) / 12)
    found = distance_information(FLAT, np.array([5.0]), np.array([np.sqrt(power) + 0j]), np.array([power]))
    assert found[0, 0] == pytest.approx(8 * np.pi**2 * beta**2 * power / LIGHT**2, rel=1e-5)
    assert 2 * np.pi * beta / LIGHT == pytest.approx(FLAT.rms_wavenumber)


def test_information_is_what_unknown_amplitudes_leave():
    """The Schur complement of the Fisher information of distances and amplitudes, for endless intensities."""
    distance = np.array([4.0, 4.5, 7.0])
    amplitude = np.array([30.0, 10 - 12j, 4j])
    response = FLAT.response(distance)
    slope = amplitude[:, None] * FLAT.slope(response)
    columns = np.concatenate([slope, response, 1j * response])
    fisher = 2 * (columns.conj() @ columns.T).real
    expected = fisher[:3, :3] - fisher[:3, 3:] @ np.linalg.solve(fisher[3:, 3:], fisher[3:, :3])
    found = distance_information(FLAT, distance, amplitude, np.full(3, 1e9))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize(
    ("gap", "turn", "kept", "correlation"),
    [(0.3, 1.0, 0.11, -0.98), (0.3, 1j, 0.11, 0.0), (5 * LIGHT / (M * STEP), 1.0, 0.987, None)],
    ids=["in phase", "in quadrature", "apart"],
)
def test_overlap_costs_what_it_costs(gap, turn, kept, correlation):
    power = np.full(2, 1e6)
    both = distance_information(FLAT, np.array([5, 5 + gap]), 1e3 * np.array([1, turn]), power)
    alone = distance_information(FLAT, np.array([5.0]), np.array([1e3 + 0j]), power[:1])
    assert both[0, 0] / alone[0, 0] == pytest.approx(kept, abs=0.01)
    if correlation is not None:
        assert both[0, 1] / both[0, 0] == pytest.approx(correlation, abs=0.01)


@pytest.mark.slow
def test_score_has_the_covariance_that_the_information_says():
    """Over noise and amplitudes, at 30 dB: E[gradient gradient^T] = E[Lambda]."""
    rng, distance, weight = np.random.default_rng(5), np.array([5.0, 5.6]), np.full(2, 1e3)
    response, scores, informations = FLAT.response(distance), [], []
    for _ in range(1500):
        amplitude = np.sqrt(weight / 2) * (rng.normal(size=2) + 1j * rng.normal(size=2))
        noise = np.sqrt(0.5) * (rng.normal(size=M) + 1j * rng.normal(size=M))
        found = superpose(FLAT, amplitude @ response + noise, distance, weight, 1.0)
        scores.append(found.gradient)
        informations.append(found.information)
    covariance, expected = np.cov(np.transpose(scores)), np.mean(informations, 0)
    np.testing.assert_allclose(covariance, expected, rtol=0.12, atol=0.05 * expected[0, 0])
    assert np.abs(np.mean(scores, 0)).max() < 4 * np.sqrt(expected[0, 0] / 1500)


@pytest.mark.slow
def test_broadening_is_the_mean_over_a_spread_of_distance():
    rng = np.random.default_rng(2)
    wave = SHAPED.response(5 + 0.2 * rng.normal(size=20_000))
    expected = 1.3 * np.eye(M) + 30 * wave.T @ wave.conj() / len(wave)
    found = Inverse.of(SHAPED, np.zeros(M) + 0j, *np.array([[30.0], [5.0], [0.04]]), 1.3)
    np.testing.assert_allclose(np.linalg.inv(found.matrix), expected, atol=0.03)


@pytest.mark.parametrize("band", [FLAT, SHAPED], ids=["flat", "shaped"])
def test_tables_are_those_of_dense_covariances(band):
    """One more path on top of all, and every path on top of the others, at all distances and at one."""
    distance, weight, noise, samples, _ = world(8, band)
    variance = np.array([1e-4, 4e-2, 1e-2])
    inverse = Inverse.of(band, samples, weight, distance, variance, noise)
    table = inverse.sweep(256)
    at, rows = np.array([0, 17, 200]), np.arange(3)
    apart, here = inverse.sweeps_without(table, rows), inverse.without(distance + 0.1)
    for left_out in (None, 0, 1, 2):
        covariance = noise * np.eye(M, dtype=complex)
        for n in rows[rows != left_out]:
            covariance += (inverse.nodes[n].T * inverse.weight[n]) @ inverse.nodes[n].conj()
        response = band.response(table.spacing_m * at)
        matched = response.conj() @ np.linalg.solve(covariance, samples)
        own = np.einsum("gm,gm->g", response.conj(), np.linalg.solve(covariance, response.T).T).real
        found = (table.matched, table.self_power) if left_out is None else (
            apart.matched[left_out], apart.self_power[left_out]
        )  # fmt: skip
        np.testing.assert_allclose(np.abs(found[0][at]), np.abs(matched), rtol=1e-7)
        np.testing.assert_allclose(found[1][at], own, rtol=1e-7)
        if left_out is not None:
            response = band.response(distance[left_out] + 0.1)
            pressed = np.linalg.solve(covariance, response)
            assert here[0][left_out] == pytest.approx(np.abs(np.vdot(pressed, samples)) ** 2, rel=1e-7)
            assert here[1][left_out] == pytest.approx(np.vdot(response, pressed).real, rel=1e-7)


@pytest.mark.parametrize("count", [0, 2])
@pytest.mark.parametrize("frequencies", [41, 600, 1100])
def test_tables_have_room_for_any_number_of_frequencies(frequencies, count):
    """More than half as many as there are points, and more than there are; with and without paths."""
    band = Band.of(4e5 * (np.arange(frequencies) - 0.5 * (frequencies - 1)))
    distance = np.array([40.0, 90.0])[:count]
    z = 30 * band.response(np.array([200.0]))[0] + band.response(np.array([10.0]))[0]
    inverse = Inverse.of(band, z, np.full(count, 4.0), distance, np.full(count, 0.01), 0.5)
    table = inverse.sweep(1024)
    for at in (0, 17, 400):
        response = band.response(np.array([at * table.spacing_m]))[0]
        own = (np.conj(response) @ inverse.matrix @ response).real
        assert table.self_power[at] == pytest.approx(own, rel=1e-9)
        assert abs(table.matched[at]) == pytest.approx(abs(np.conj(response) @ inverse.matrix @ z), rel=1e-9)


def test_ratio_of_one_more_path_is_that_of_the_densities():
    distance, weight, noise, samples, _ = world(8, SHAPED)
    inverse = Inverse.of(SHAPED, samples, weight, distance, np.zeros(3), noise)
    table = inverse.sweep(256)
    before = superpose(SHAPED, samples, distance, weight, noise).log_density
    for row in (0, 17, 200):
        more = np.append(distance, table.spacing_m * row)
        after = superpose(SHAPED, samples, more, np.append(weight, 50.0), noise).log_density
        assert table.log_ratio(50.0)[row] == pytest.approx(after - before, abs=1e-6)


def test_noise_does_not_make_a_path_likelier():
    """E[LR] = 1 in noise: existence does not grow."""
    rng = np.random.default_rng(4)
    matched = rng.exponential(size=400_000)  # |h^H z|^2 at C = I
    ratio = np.exp(log_ratio(matched, np.ones(1), 0.8))
    assert ratio.mean() == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow
def test_samples_and_noise_estimate_have_their_distributions():
    squares, ratios = [], []
    for seed in range(300):
        distance, weight, noise, samples, _ = world(seed, FLAT, 3)
        squares.append(
            2 * np.vdot(samples, np.linalg.solve(dense(FLAT, distance, weight, noise), samples)).real
        )
        prior = PathPrior(distance, np.diag(np.full(3, 1e2)), weight)
        ratios.append(joint_mode(FLAT, samples, prior, noise).noise_ratio)
    assert np.mean(squares) == pytest.approx(2 * M, rel=4 / np.sqrt(M * 300))
    assert np.var(squares) == pytest.approx(4 * M, rel=0.3)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


def test_mode_is_the_highest_place_about_the_prediction():
    distance, weight, noise, samples, _ = world(11, FLAT, 3, 0.1)
    prior = PathPrior(distance + 0.03, np.diag(np.full(3, 400.0)), weight)
    mode = joint_mode(FLAT, samples, prior, noise)
    off = np.random.default_rng(0).normal(size=(500, 3)) * 0.02
    tried = log_densities(FLAT, samples, mode.distance + off, weight, noise) - 200 * (
        (mode.distance + off - prior.mean) ** 2
    ).sum(1)
    assert mode.log_posterior >= tried.max() - 1e-3
    assert mode.log_posterior > tried.max() - 3


def test_scale_and_phase_of_samples_mean_nothing():
    distance, weight, noise, samples, _ = world(21)
    prior = PathPrior(distance + 0.01, np.diag(np.full(3, 100.0)), weight)
    loud = PathPrior(prior.mean, prior.precision, 1e6 * weight)
    one = joint_mode(FLAT, samples, prior, noise)
    other = joint_mode(FLAT, 1e3 * np.exp(0.7j) * samples, loud, 1e6 * noise)
    np.testing.assert_allclose(one.distance, other.distance, atol=1e-9)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-6)


def test_paths_far_apart_are_measured_as_if_alone():
    """Well separated strong paths: the same posterior as of exact range measurements with sigma_d."""
    distance, weight = np.array([3.0, 9.0, 16.0]), np.full(3, 1e4)
    amplitude = np.array([100.0, 80 + 50j, -90j])
    samples = amplitude @ FLAT.response(distance)
    prior = PathPrior(distance + 0.02, np.diag(np.full(3, 25.0)), weight)
    mode = joint_mode(FLAT, samples, prior, 1.0)
    alone = 2 * FLAT.rms_wavenumber**2 * np.abs(amplitude) ** 2
    np.testing.assert_allclose(mode.distance, distance, atol=5e-4)
    np.testing.assert_allclose(1 / mode.variance - 25, alone, rtol=0.05)


def test_an_image_is_not_nearer_than_its_anchor():
    """A reflection that is predicted as near as the strong path doesn't take the line of sight's place."""
    samples = 30 * FLAT.response(5.0) + 10j * FLAT.response(5.5)
    prior = PathPrior(np.array([5.2, 5.3]), np.diag([25.0, 4.0]), np.array([100.0, 900.0]))
    mode = joint_mode(FLAT, samples, prior, 1.0)
    np.testing.assert_allclose(mode.distance, [5.0, 5.5], atol=0.03)
