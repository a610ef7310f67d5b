"""Densities at particles, by series, against the sum over all samples."""

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam import reference
from gridslam.inference.messages.samples import response_series
from gridslam.inference.messages.samples.response_series import NEGLIGIBLE, ResponseSeries
from gridslam.inference.messages.samples.signal_likelihood import Band, log_densities


def some_case(draw, size, count, others, particles, flat):
    """A band, samples, covariance of other paths, and particles up to several folding ranges away."""
    pulse = None if flat else draw.normal(size=size) + 1j * draw.normal(size=size)
    band = Band.of(1e7 * (np.arange(size) - 0.5 * (size - 1)), pulse)
    distance = draw.uniform(0, 70, (count, 1)) + 0.2 * draw.normal(size=(count, particles))
    power = draw.uniform(1, 30, (count, 1)) ** 2 * draw.uniform(0.8, 1.2, (count, particles))
    waves = band.response(draw.uniform(2, 20, others)) * draw.uniform(3, 10, (others, 1))
    samples = draw.normal(size=size) + 1j * draw.normal(size=size)
    if count:
        samples = samples + 20 * band.response(distance[0, 0])
    return band, samples, waves.T @ waves.conj(), np.abs(distance), power


def summed(band, samples, extra, noise, distance, power):
    base = noise * np.eye(len(band)) + extra
    return reference.weigh_particles(band.wavenumber, band.pulse, samples, base, distance, noise * power)


@given(
    st.integers(0, 2**32 - 1), st.integers(8, 25), st.integers(0, 6), st.integers(0, 3), st.integers(1, 20),
    st.booleans(),
)  # fmt: skip
@settings(max_examples=25, deadline=None)
def test_series_say_what_the_sum_over_samples_says(seed, size, count, others, particles, flat):
    draw = np.random.default_rng(seed)
    case = some_case(draw, size, count, others, particles, flat)
    noise = draw.uniform(0.3, 3)
    with patch.object(response_series, "NEGLIGIBLE", 1e-3):  # what else is there may be faint
        found = ResponseSeries.of(*case[:3], noise).log_densities(*case[3:])
    expected = summed(*case[:3], noise, *case[3:])
    np.testing.assert_allclose(found, expected, atol=2e-3, rtol=1e-5)


def test_series_are_right_to_a_millionth_of_the_samples_power():
    draw = np.random.default_rng(3)
    band, samples, _, distance, power = some_case(draw, 41, 3, 0, 200, True)
    series = ResponseSeries.of(band, 10 * samples, np.zeros((41, 41), complex), 1.0)
    found, power = series.log_densities(distance, 1e4 * power), 1e4 * power
    exact = log_densities(band, 10 * samples, distance.T, power.T, 1.0)
    np.testing.assert_allclose(
        found - found[0], exact - exact[0], atol=1e-6 * 100 * np.vdot(samples, samples).real
    )


def test_what_is_left_out_beside_the_noise_is_negligible():
    draw = np.random.default_rng(4)
    band, samples, _, distance, power = some_case(draw, 21, 2, 0, 50, True)
    samples = draw.normal(size=21) + 1j * draw.normal(
        size=21
    )  # what fits worse is changed by as many times more
    wave = band.response(7.0)[:, None]
    faint = 0.9 * NEGLIGIBLE * wave @ wave.conj().T
    found = ResponseSeries.of(band, samples, faint, 1.0).log_densities(distance, power)
    expected = summed(band, samples, faint, 1.0, distance, power)
    assert 0 < np.ptp(found - expected) < 5 * NEGLIGIBLE


def test_one_path_by_hand():
    band = Band.of(1e7 * (np.arange(8) - 3.5))
    series = ResponseSeries.of(band, 3 * band.response(5.0), np.zeros((8, 8), complex), 1.0)
    found = series.log_densities(np.full((1, 3), 5.0), np.array([[0.0, 1.0, 9.0]]))
    # |h^H z|^2 w / (1 + w) - log(1 + w), with |h| = 1
    np.testing.assert_allclose(found, [0.0, 4.5 - np.log(2), 8.1 - np.log(10)], atol=1e-6)
    np.testing.assert_array_equal(series.log_densities(np.empty((0, 5)), np.empty((0, 5))), np.zeros(5))


@pytest.mark.parametrize("flat", [True, False])
def test_particles_far_apart_are_weighed_in_parts(flat):
    draw = np.random.default_rng(5)
    band, samples, extra, distance, power = some_case(draw, 15, 3, 1, 40, flat)
    distance[1] = np.linspace(0.0, 3 * band.folding_m, 40)  # of which one series would be far too long
    found = ResponseSeries.of(band, samples, extra, 1.0).log_densities(distance, power)
    np.testing.assert_allclose(found, summed(band, samples, extra, 1.0, distance, power), atol=2e-3)


def test_a_particle_weighs_the_same_alone_and_among_many():
    draw = np.random.default_rng(6)
    band, samples, extra, distance, power = some_case(draw, 41, 5, 2, 100, True)
    series = ResponseSeries.of(band, samples, extra, 1.0)
    found = series.log_densities(distance, power)
    for p in (0, 37, 99):
        alone = series.log_densities(distance[:, [p]], power[:, [p]])
        np.testing.assert_allclose(found[p], alone[0], atol=1e-3)
