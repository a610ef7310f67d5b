"""Messages of the published direct SLAM against enumeration and dense algebra."""

from itertools import product

import numpy as np
import pytest

from gridslam.inference.messages.published.direct_particles import (
    agent_message,
    expect,
    feature_messages,
    noise_message,
    resampled,
)
from gridslam.inference.messages.samples.signal_likelihood import Band
from gridslam.inference.state.published.feature_particles import Features, ParticleState

M, COUNT = 8, 300
BAND = Band.of(2e7 * (np.arange(M) - 3.5), np.linspace(1, 2, M) * np.exp(0.2j * np.arange(M)))


def state_of(seed, spread=0.2, noise=1.5):
    """Two features of one anchor, and the anchor, about distances of 3, 5 and 6 m."""
    draw = np.random.default_rng(seed)
    agent = np.concatenate([0.05 * draw.standard_normal((COUNT, 2)), np.zeros((COUNT, 2))], 1)
    middle = np.array([[3.0, 0.0], [0.0, 5.0], [-6.0, 0.0]])
    place = middle[:, None] + np.array([0, spread, spread])[:, None, None] * draw.standard_normal(
        (3, COUNT, 2)
    )
    features = Features(
        np.arange(3), np.zeros(3, np.int64), np.array([True, False, False]), np.array([0.9, 0.7, 0.4]), place,
        draw.uniform(2, 20, (3, COUNT)),
    )  # fmt: skip
    return ParticleState(agent, noise * draw.uniform(0.8, 1.2, (1, COUNT)), features, 0, 3), draw


def samples_of(draw):
    return draw.standard_normal(M) + 1j * draw.standard_normal(M) + 6 * BAND.response(5.0)


def outer(state, n, rows=slice(None)):
    """gamma h h^H of a feature at its paired particles, (P, M, M)."""
    far = np.linalg.norm(state.features.position[n] - state.agent[:, :2], axis=-1)[rows]
    wave = BAND.response(far)
    return state.features.intensity[n][rows, None, None] * wave[:, :, None] * wave[:, None].conj()


def test_covariance_is_that_of_the_mixture_over_existences_and_particles():
    state, _ = state_of(0)
    expected = expect(state, 0, BAND)
    chance, each = state.features.existence, [outer(state, n).mean(0) for n in range(3)]
    mixture = np.zeros((M, M), complex)
    for exists in product([0, 1], repeat=3):
        weight = np.prod([c if r else 1 - c for c, r in zip(chance, exists, strict=True)])
        own = sum((r * e for r, e in zip(exists, each, strict=True)), np.zeros((M, M)))
        mixture += weight * (state.noise.mean() * np.eye(M) + own)
    np.testing.assert_allclose(expected.covariance(), mixture, atol=2e-3)
    without = mixture - chance[1] * each[1]
    np.testing.assert_allclose(expected.covariance(1), without, atol=2e-3)


@pytest.mark.slow
def test_messages_to_agent_and_noise_are_densities_of_their_covariances():
    state, draw = state_of(1)
    samples, expected = samples_of(draw), expect(state, 0, BAND)
    found = agent_message(state, expected, BAND, samples)
    stacked = sum(state.features.existence[n] * outer(state, n) for n in range(3))
    dense = density(expected.noise * np.eye(M) + stacked, samples)
    np.testing.assert_allclose(found - found[0], dense - dense[0], atol=0.05)
    found = noise_message(state, 0, expected, samples)
    level = state.noise[0][:, None, None] * np.eye(M)
    dense = density(level + expected.terms.sum(0), samples)
    np.testing.assert_allclose(found - found[0], dense - dense[0], atol=1e-6)


def density(covariance, samples):
    log_det = np.linalg.slogdet(covariance)[1]
    shape = (*covariance.shape[:-1], 1)
    solved = np.linalg.solve(covariance, np.broadcast_to(samples[:, None], shape))[..., 0]
    return -log_det - (samples.conj() * solved).sum(-1).real


def test_existence_follows_the_mean_ratio():
    state, draw = state_of(2)
    samples, expected = samples_of(draw), expect(state, 0, BAND)
    updated = feature_messages(state, expected, BAND, samples, np.random.default_rng(0))
    for n in range(3):
        rest = expected.covariance(n)
        ratio = np.exp(density(rest + outer(state, n), samples) - density(rest, samples)).mean()
        chance = state.features.existence[n]
        assert updated.existence[n] == pytest.approx(chance * ratio / (chance * ratio + 1 - chance), abs=0.01)


def test_drawing_anew_keeps_shares():
    logs = np.log(np.array([1.0, 2.0, 3.0, 4.0]) / 10)
    picks = [resampled(logs, np.random.default_rng(seed)) for seed in range(500)]
    np.testing.assert_allclose(np.bincount(np.concatenate(picks)) / 2000, np.exp(logs), atol=0.02)
