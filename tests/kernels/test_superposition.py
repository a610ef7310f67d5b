"""Snapshots of arrays as sums of paths: kernels against their plain counterparts."""

import numpy as np
import pytest
from array_snapshots import band_of
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam import reference
from gridslam.inference.messages.samples.array_likelihood import (
    ArrayBand,
    climbed,
    composed,
    one_more,
    superpose_arrays,
)


def some_band(draw, rows, columns, frequencies):
    """A band with a pulse that isn't flat; one element tells no angle."""
    flat = band_of(rows, columns, frequencies)
    pulse = draw.normal(size=frequencies) + 1j * draw.normal(size=frequencies)
    return ArrayBand(flat.wavenumber, pulse / np.linalg.norm(pulse), flat.anchor, flat.agent)


def numbers(draw, *shape):
    return draw.normal(size=shape) + 1j * draw.normal(size=shape)


def some_paths(draw, count):
    return np.column_stack([draw.uniform(1, 30, count), draw.uniform(-4, 4, (count, 2))])


def arguments(band):
    return band.wavenumber, band.pulse, band.anchor, band.agent


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.sampled_from([(1, 1, 9), (2, 2, 8)]), st.booleans())
@settings(max_examples=15, deadline=None)
def test_responses_and_what_they_tell_are_those_of_the_twins(seed, count, size, coincide):
    draw = np.random.default_rng(seed)
    band, path = some_band(draw, *size), some_paths(draw, count)
    if coincide:
        path[-1] = path[0]
    made, factors = band.factors(path), reference.respond(*arguments(band), path)
    for found, expected in zip((made.delay, made.leaving, made.arriving), factors, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-10)
    samples = 3 * numbers(draw, len(band.anchor), len(band.agent), len(band.wavenumber))
    weight, noise = draw.exponential(10.0, count), draw.uniform(0.3, 3)
    weight[draw.random(count) < 0.2] = 0.0
    expected = reference.superpose(factors, samples, weight, noise)
    paths = superpose_arrays(band, samples, path, weight, noise)
    sums = paths.log_density, paths.rest_power, paths.unexplained
    found = paths.amplitude, paths.matched, paths.own, paths.gradient, paths.information, sums
    for one, other in zip(found, expected, strict=True):
        scale = max(1.0, float(np.abs(other).max()))
        np.testing.assert_allclose(np.reshape(one, np.shape(other)), other, atol=1e-8 * scale)
    amplitudes = numbers(draw, count)
    known = superpose_arrays(band, samples, path, weight, noise, amplitudes).information
    expected = reference.superpose(factors, samples, weight, noise, amplitudes)[4]
    np.testing.assert_allclose(known, expected.reshape(known.shape), atol=1e-8 * np.abs(expected).max())


def test_no_paths_are_noise_alone_and_one_more_is_one_of_no_weight():
    draw = np.random.default_rng(4)
    band, path = some_band(draw, 2, 2, 9), some_paths(draw, 3)
    samples = numbers(draw, 4, 4, 9)
    none = superpose_arrays(band, samples, np.zeros((0, 3)), np.zeros(0), 2.0)
    power = np.vdot(samples, samples).real
    assert none.log_density == pytest.approx(-samples.size * np.log(2.0) - power / 2)
    assert (none.rest_power, none.unexplained) == pytest.approx((power, samples.size))
    assert none.information.shape == (0, 0)
    matched, own = one_more(band, samples, path[1:], path[:1], np.array([5.0]), 2.0)
    whole = superpose_arrays(band, samples, path, np.array([5.0, 0, 0]), 2.0)
    np.testing.assert_allclose(matched, whole.matched[1:])
    np.testing.assert_allclose(own, whole.own[1:])


@given(st.integers(0, 2**32 - 1), st.sampled_from([(1, 1, 9), (3, 2, 8)]))
@settings(max_examples=15, deadline=None)
def test_peaks_are_climbed_as_by_the_twin(seed, size):
    draw = np.random.default_rng(seed)
    band, path = band_of(*size), some_paths(draw, 1)
    samples = composed(band, path, np.array([9.0j])) + 0.1 * numbers(
        draw, len(band.anchor), len(band.agent), size[2]
    )
    start = path[0] + 0.2 / np.maximum(band.steepness, 0.3) * draw.normal(size=3)
    found = climbed(band, samples, start, 3)
    expected = reference.climb(*arguments(band), band.steepness, samples, 3, start)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    gap = (climbed(band, samples, start, 20) - path[0]) * band.steepness
    assert np.abs(gap).max() < 0.1
