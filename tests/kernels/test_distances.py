"""Joint modes of distances: the kernel against its plain counterpart."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import log_ndtr

from gridslam import reference
from gridslam.inference.messages.samples.distance_mode import BEHIND_M, PathPrior, joint_mode
from gridslam.inference.messages.samples.signal_likelihood import Band, superpose


def some_band(draw, size):
    pulse = draw.normal(size=size) + 1j * draw.normal(size=size)
    return Band.of(1e7 * (np.arange(size) - 0.5 * (size - 1)), pulse)


def some_prior(draw, count, places):
    root = draw.normal(size=(count, count)) / 0.1
    chance = np.clip(draw.uniform(-0.3, 1.3, count), 0.0, 1.0)
    return PathPrior(places, root @ root.T + np.eye(count), draw.exponential(100.0, count), chance=chance)


def searched(band, samples, prior, noise, rounds, halvings=6, farthest=0.1):
    """What kernel and twin make of a search of so many rounds."""
    from gridslam.kernels.messages.distances import climb_distances

    size = len(prior.mean)
    limits = np.array([noise, farthest, BEHIND_M, rounds, halvings, 4e-4, 1 / np.sqrt(2 * np.pi)])
    distance, information, value = prior.mean.copy(), np.empty((size, size)), np.empty(1)
    numbers = (one.view(np.float64).reshape(-1, 2) for one in (band.pulse, samples))
    climb_distances(
        band.wavenumber, *numbers, prior.mean, prior.precision,
        np.column_stack([prior.weight, prior.chances]), limits, np.full((7, size + 1, size, 2), np.nan),
        np.full((size, 9), np.nan), distance, information, value,
    )  # fmt: skip
    expected = reference.climb_distances(
        band.wavenumber,
        band.pulse,
        samples,
        prior.mean,
        prior.precision,
        prior.weight,
        prior.chances,
        limits,
        prior.mean,
    )
    return (distance, information, value[0]), expected


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(0, 3), st.booleans())
@settings(max_examples=25, deadline=None)
def test_a_search_goes_where_the_twins_goes(seed, count, rounds, coincide):
    draw = np.random.default_rng(seed)
    band = some_band(draw, 17)
    places = np.sort(draw.uniform(2, 20, count))
    if coincide:
        places[-1] = places[0]
    prior = some_prior(draw, count, places)
    prior.weight[draw.random(count) < 0.2] = 0.0
    noise, samples = draw.uniform(0.3, 3), 5 * (draw.normal(size=17) + 1j * draw.normal(size=17))
    found, expected = searched(band, samples, prior, noise, rounds)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-7 * max(1.0, float(np.abs(other).max())))


def log_behind(distance, chance):
    """Log probability (N - 1,) that paths at distances [1:], there with a chance, are behind that at [0]."""
    behind = log_ndtr((distance[1:] - distance[0]) / BEHIND_M)
    with np.errstate(divide="ignore"):
        return np.logaddexp(np.log(chance) + behind, np.log1p(-chance))


@pytest.mark.parametrize("chance", [1.0, 0.4])
@pytest.mark.parametrize("gap", [-60.0, -3.1, -3.0, -2.9, -1.0, 0.0, 1.0, 2.9, 3.0, 3.1, 8.0, 60.0])
def test_the_order_of_paths_weighs_as_the_normal_distribution_says(gap, chance):
    draw = np.random.default_rng(5)
    band, places = some_band(draw, 9), np.array([5.0, 5.0 + gap * BEHIND_M])
    prior = PathPrior(
        places, np.eye(2), np.zeros(2), chance=np.array([1.0, chance])
    )  # nothing is heard: order alone pushes
    samples = draw.normal(size=9) + 1j * draw.normal(size=9)
    (_, _, value), _ = searched(band, samples, prior, 1.0, 0)
    bare = superpose(band, samples, places, prior.weight, 1.0).log_density
    assert value - bare == pytest.approx(float(log_behind(places, chance).sum()), rel=1e-9, abs=1e-11)
    found, expected = searched(band, samples, prior, 1.0, 1, farthest=1e3)
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-9)


def test_a_path_that_is_gone_may_be_nearer_than_its_anchor():
    """An image seen from behind its wall: its distance says where the agent is, and isn't pushed back."""
    band, samples = Band.of(1e7 * (np.arange(17) - 8.0)), np.zeros(17, np.complex128)
    for chance, moves in ((0.0, False), (1e-6, False), (1.0, True)):
        prior = PathPrior(
            np.array([5.0, 4.5]), 1e4 * np.eye(2), np.array([1e-9, 1e-9]), chance=np.array([1.0, chance])
        )
        mode = joint_mode(band, samples, prior, 1.0)
        assert bool(abs(mode.distance - prior.mean).max() > 0.01) == moves


def test_a_step_is_no_longer_than_it_may_be_and_is_halved_until_it_rises():
    draw = np.random.default_rng(8)
    band = Band.of(1e7 * (np.arange(17) - 8.0))
    samples = 30 * band.response(6.3) + 0.1 * (draw.normal(size=17) + 1j * draw.normal(size=17))
    prior = PathPrior(np.array([6.0]), np.array([[0.1]]), np.array([900.0]))
    (near, _, _), (twin, _, _) = searched(band, samples, prior, 0.02, 1, farthest=0.05)
    assert abs(near[0] - 6.0) <= 0.05 + 1e-12
    np.testing.assert_allclose(near, twin, rtol=1e-9)
    (held, _, _), _ = searched(band, samples, prior, 0.02, 5, halvings=0)
    assert held[0] == 6.0
    mode = joint_mode(band, samples, prior, 0.02)
    assert mode.distance[0] == pytest.approx(6.3, abs=0.01)
    expected = superpose(band, samples, mode.distance, prior.weight, 0.02)
    off = mode.distance - prior.mean
    assert mode.log_posterior == pytest.approx(expected.log_density - 0.05 * float(off @ off))
    np.testing.assert_allclose(np.linalg.inv(mode.covariance), 0.1 + expected.information)
