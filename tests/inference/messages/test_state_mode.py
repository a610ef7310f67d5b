"""The joint mode of agent and surfaces: its gradient, its information, and cases with a closed answer."""

import numpy as np
import pytest
from array_snapshots import band_of, snapshot
from scipy.special import logsumexp

from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.samples.array_likelihood import one_more
from gridslam.inference.messages.samples.array_paths import log_amplitudes
from gridslam.inference.messages.samples.state_mode import PathsPrior, paths_at, state_mode

MEAN = np.array([0.5, -0.4, 0.1, 0.0, 0.3, 0.1, 3.0, 1.6, 2.5])
"""Agent, and two walls."""
PLACE = np.array([-2.0, 1.0, 0.2])
TABLE = np.array([[0, -1, -1, 0], [1, 0, -1, 0], [1, 1, -1, 0], [2, 0, 1, 0]], np.int32)
BAND = band_of(3, 3, 31)
NO_PATH = np.zeros((0, 3))
DEVIATION = np.array([0.05, 0.05, 0.01, 0.01, 0.05, 0.02, 0.05, 0.02, 0.05])


def prior_of(weight, mean=MEAN, deviation=DEVIATION):
    return PathsPrior(Belief(mean.copy(), np.diag(deviation**2)), PLACE, TABLE, np.array(weight), NO_PATH)


def test_paths_and_their_slopes():
    path, slope = paths_at(MEAN, PLACE, TABLE, 5)
    assert path[0, 0] == pytest.approx(np.hypot(2.5, 1.4))
    for entry in range(len(MEAN)):
        step = 1e-6 * (np.arange(len(MEAN)) == entry)
        rise = (paths_at(MEAN + step, PLACE, TABLE, 5)[0] - paths_at(MEAN - step, PLACE, TABLE, 5)[0]) / 2e-6
        np.testing.assert_allclose(slope[:, :, entry], rise, atol=1e-6)


def test_strong_paths_lead_the_state_to_where_it_is():
    """Prior and samples disagree by some deviations; the samples know better, and claim no more."""
    squares = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        truth = MEAN + DEVIATION * rng.normal(size=len(MEAN))
        amplitude = 30 * np.exp(2j * np.pi * rng.uniform(size=4))
        samples = snapshot(BAND, paths_at(truth, PLACE, TABLE, 5)[0], amplitude, 1.0, seed)
        mode = state_mode(BAND, samples, prior_of([900.0] * 4), 1.0)
        off = mode.belief.mean - truth
        squares.append(off @ np.linalg.solve(mode.belief.covariance, off))
    assert 5.0 < np.mean(squares) < 14.0  # 9 is perfect; 12 draws of deviation 1.2
    assert mode.belief.covariance[0, 0] < 0.2 * DEVIATION[0] ** 2


def test_the_mode_is_where_the_gradient_vanishes():
    truth = MEAN + 0.5 * DEVIATION
    samples = snapshot(BAND, paths_at(truth, PLACE, TABLE, 5)[0], [30, 20j, -15, 8], 1.0)
    prior = prior_of([900.0, 400.0, 225.0, 64.0])
    mode = state_mode(BAND, samples, prior, 1.0)
    path, slope = paths_at(mode.belief.mean, PLACE, TABLE, 5)
    np.testing.assert_allclose(path, mode.path, atol=1e-9)
    pull = slope.reshape(-1, 9).T @ mode.paths.gradient.reshape(-1)
    pull = pull - (mode.belief.mean - MEAN) / DEVIATION**2
    left = pull @ mode.belief.covariance @ pull
    assert left < 0.02**2 * 4
    wanted = np.linalg.inv(
        np.diag(DEVIATION**-2) + slope.reshape(-1, 9).T @ mode.paths.information @ slope.reshape(-1, 9)
    )
    np.testing.assert_allclose(mode.belief.covariance, wanted, rtol=1e-6, atol=1e-12)


def test_a_faint_path_moves_nothing_and_a_known_state_stays():
    samples = snapshot(BAND, paths_at(MEAN + DEVIATION, PLACE, TABLE, 5)[0], [30, 20, 10, 5], 1.0)
    mode = state_mode(BAND, samples, prior_of([1e-9] * 4), 1.0)
    np.testing.assert_allclose(mode.belief.mean, MEAN, atol=1e-6)
    known = state_mode(BAND, samples, prior_of([900.0] * 4, deviation=0 * DEVIATION), 1.0)
    np.testing.assert_allclose(known.belief.mean, MEAN, atol=1e-12)
    np.testing.assert_allclose(known.belief.covariance, 0, atol=1e-12)


def test_a_vague_start_finds_the_highest_of_several_modes():
    """0.9 m off at c/B = 0.4 m: the mean lies beyond the first sidelobes."""
    deviation = np.array([0.5, 0.5, 0.01, 0.01, 0.2, 0.01, 0.01, 0.01, 0.01])
    truth = MEAN + np.array([0.7, 0.6, 0, 0, 0.2, 0, 0, 0, 0])
    samples = snapshot(BAND, paths_at(truth, PLACE, TABLE, 5)[0], [30, 20j, -15, 8], 1.0)
    mode = state_mode(BAND, samples, prior_of([900.0, 400.0, 225.0, 64.0], deviation=deviation), 1.0)
    assert np.linalg.norm(mode.belief.mean[:2] - truth[:2]) < 0.05


def test_evidence_of_a_path_is_the_mean_of_its_ratio_over_what_was_believed():
    """Laplace's approximation against a sum over a grid of states."""
    deviation = np.zeros(9)
    deviation[:2] = 0.04
    prior = PathsPrior(Belief(MEAN, np.diag(deviation**2)), PLACE, TABLE[:1], np.array([400.0]), NO_PATH)
    truth = MEAN + np.array([0.03, -0.02, *np.zeros(7)])
    samples = snapshot(BAND, paths_at(truth, PLACE, TABLE[:1], 5)[0], [20.0], 1.0)
    mode = state_mode(BAND, samples, prior, 1.0)

    def log_ratio(path):
        matched = np.abs(one_more(BAND, samples, path, NO_PATH, np.zeros(0), 1.0)[0]) ** 2
        return log_amplitudes(matched, np.ones(len(path)), np.array([[20.0]]), True)[:, 0]

    steps = np.linspace(-4, 4, 25)
    states = np.array([[[x, y, *np.zeros(7)] for x in steps] for y in steps])
    rows = [
        np.concatenate([paths_at(MEAN + deviation * state, PLACE, TABLE[:1], 5)[0] for state in row])
        for row in states
    ]
    prior_logs = -0.5 * (states**2).sum(-1)
    wanted = logsumexp(np.array([log_ratio(row) for row in rows]) + prior_logs) - logsumexp(prior_logs)
    found = log_ratio(mode.path)[0] + mode.log_evidence()[0]
    assert found == pytest.approx(wanted, abs=0.3)
    assert log_ratio(mode.path)[0] > wanted + 0.5


def test_ratios_of_amplitudes_are_fair():
    """Over noise alone their mean is 1; one of steady paths tells the amplitude without bias."""
    rng = np.random.default_rng(3)
    noise = (rng.normal(size=200_000) + 1j * rng.normal(size=200_000)) * np.sqrt(0.5)
    nodes = np.array([[0.7, 1.5]])
    for fades in (False, True):
        ratio = np.exp(log_amplitudes(np.abs(noise) ** 2, np.ones(len(noise)), nodes, fades))
        np.testing.assert_allclose(ratio.mean(0), 1, atol=0.05)
    grid = np.linspace(0.05, 4, 80)[None]
    power = np.abs(1.5 + noise[:400]) ** 2
    total = log_amplitudes(power, np.ones(400), grid, False).sum(0)
    assert grid[0, total.argmax()] == pytest.approx(1.5, abs=0.12)
