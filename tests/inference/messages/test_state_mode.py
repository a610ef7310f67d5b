"""The joint mode of agent and surfaces: its gradient, its information, and cases with a closed answer."""

from dataclasses import replace

import numpy as np
import pytest
from array_snapshots import band_of, snapshot
from scipy.special import logsumexp

from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.samples.array_likelihood import one_more
from gridslam.inference.messages.samples.array_paths import log_amplitudes
from gridslam.inference.messages.samples.array_search import find_paths
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


def sloped(band, samples, anchor=(0.0, 0.0), agent=(0.0, 0.0)):
    """Samples of arrays over whose elements phases slope: rad for each rad of a place."""
    leaving, arriving = np.exp(1j * band.anchor @ anchor), np.exp(1j * band.agent @ agent)
    return samples * leaving[:, None, None] * arriving[None, :, None]


def extent_of(element):
    """Root of the sum of squares of places along one axis, of a square of elements."""
    return np.sqrt((element**2).sum(0)[0])


def test_a_slope_of_phases_turns_paths_as_a_direction_does():
    """By hand: u . q with u = (cos, sin) of an angle; a slope s adds s . q, as a turn by s . (-sin, cos).

    But for |s|^2, by which no direction is meant.
    """
    path, slope, loud = np.array([[5.0, 0.7, -1.2]]), np.array([0.01, 0.02]), np.array([1e6])
    one = snapshot(BAND, path, [100.0], 1.0)
    by = slope @ [-np.sin(0.7), np.cos(0.7)]
    free = PathsPrior(Belief(MEAN, np.eye(9)), PLACE, TABLE[:0], loud, path)
    there = state_mode(BAND, one, free, 1.0).path[0]
    found = state_mode(BAND, sloped(BAND, one, slope), free, 1.0).path[0]
    np.testing.assert_allclose(abs(found - there), [0, abs(by), 0], atol=5e-4)
    by = slope @ [-np.sin(-1.2), np.cos(-1.2)]
    found = state_mode(BAND, sloped(BAND, one, agent=slope), free, 1.0).path[0]
    np.testing.assert_allclose(abs(found - there), [0, 0, abs(by)], atol=5e-4)


def test_what_arrays_may_turn_is_no_news_of_the_state():
    """The mode's gradient by state and slopes vanishes; the covariance is the state's of both together."""
    samples = snapshot(BAND, paths_at(MEAN + 0.5 * DEVIATION, PLACE, TABLE, 5)[0], [30, 20j, -15, 8], 1.0)
    samples = sloped(BAND, samples, (0.02, -0.03), (0.01, 0.02))
    prior = replace(prior_of([900.0, 400.0, 225.0, 64.0]), phase_std=0.15)
    mode = state_mode(BAND, samples, prior, 1.0)
    path, slope = paths_at(mode.belief.mean, PLACE, TABLE, 5)
    np.testing.assert_allclose(path + mode.turned, mode.path, atol=1e-9)
    by_turn = np.zeros((4, 3, 4))
    for array, element in enumerate((BAND.anchor, BAND.agent)):
        angle = path[:, 1 + array]
        extent = (element**2).sum(0)  # of nine in a square about 0: the same along both axes
        np.testing.assert_allclose(extent, extent[0])
        by_turn[:, 1 + array, 2 * array : 2 * array + 2] = np.stack([-np.sin(angle), np.cos(angle)], -1)
        by_turn[:, 1 + array, 2 * array : 2 * array + 2] *= 0.15 / np.sqrt(extent[0])
    both = np.concatenate([slope, by_turn], -1).reshape(12, 13)
    known = np.concatenate([DEVIATION**-2, np.ones(4)])
    wanted = np.linalg.inv(np.diag(known) + both.T @ mode.paths.information @ both)
    told = np.linalg.inv(wanted[:9, :9]) - np.diag(DEVIATION**-2)
    np.testing.assert_allclose(mode.information, DEVIATION[:, None] * told * DEVIATION, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(mode.belief.covariance, wanted[:9, :9], rtol=1e-6, atol=1e-12)
    turns = np.linalg.pinv(by_turn.reshape(12, 4)) @ mode.turned.reshape(-1)
    pull = both.T @ mode.paths.gradient.reshape(-1)
    pull -= known * np.concatenate([mode.belief.mean - MEAN, turns])
    assert pull @ wanted @ pull < 0.02**2 * 4
    without = state_mode(BAND, samples, prior_of([900.0, 400.0, 225.0, 64.0]), 1.0)
    wider = np.diag(mode.belief.covariance) / np.diag(without.belief.covariance)
    assert (np.delete(wider, [2, 3]) > 1.3).all()  # but for the velocity


def test_an_agent_is_where_it_is_though_arrays_turn_all_that_is_heard():
    """Slopes of 1.5 degrees, distances exact: squared error over variance of the state, of 16 draws."""
    squares = {0.0: [], 0.025 * extent_of(BAND.anchor): []}
    for seed in range(16):
        rng = np.random.default_rng(seed)
        truth = MEAN + DEVIATION * rng.normal(size=9)
        one = snapshot(BAND, paths_at(truth, PLACE, TABLE, 5)[0], [90, 80j, -70, 60], 1.0, seed)
        samples = sloped(BAND, one, rng.normal(0, 0.025, 2), rng.normal(0, 0.025, 2))
        for phase_std, found in squares.items():
            prior = replace(prior_of([8000.0] * 4), phase_std=phase_std)
            mode = state_mode(BAND, samples, prior, 1.0)
            off = mode.belief.mean - truth
            found.append(off @ np.linalg.solve(mode.belief.covariance, off))
    without, marginal = map(np.mean, squares.values())
    assert 6.0 < marginal < 12.5  # 9 is perfect, of deviation 1.1
    assert without > 40


def test_a_new_path_is_where_it_would_be_heard_by_right_arrays():
    """A known path of a known state tells the slopes; the new one beside it is turned back by them."""
    slope, deviation = (0.02, -0.02), 1e-6 * DEVIATION
    known, new = paths_at(MEAN, PLACE, TABLE[:1], 5)[0], np.array([[6.0, 1.9, 2.0]])
    new[0, 1:] += 1e-3  # not quite where the search for it begins
    received = snapshot(BAND, np.concatenate([known, new]), [3000.0, 1000j], 1.0)
    weight = np.array([9e6, 1e6])
    prior = PathsPrior(
        Belief(MEAN, np.diag(deviation**2)), PLACE, TABLE[:1], weight, new + np.array([0.01, 0.01, -0.01]),
        0.03 * extent_of(BAND.anchor),
    )  # fmt: skip
    mode = state_mode(BAND, sloped(BAND, received, slope, slope), prior, 1.0)
    off = (mode.path - mode.turned)[1] - new[0]
    std = np.sqrt(np.diag(mode.free_spread[0]))
    assert (np.abs(off) < 4 * std).all()
    assert std[1] > 0.01  # one direction tells one of two slopes
    right = state_mode(BAND, received, replace(prior, phase_std=0.0), 1.0)
    assert not right.turned.any()
    np.testing.assert_array_equal(right.free_spread, right.spread[1:])
    assert np.sqrt(right.free_spread[0, 1, 1]) < 1e-3


def test_new_paths_are_handed_on_as_right_arrays_would_have_heard_them():
    slope = (0.02, -0.02)
    known, new = paths_at(MEAN, PLACE, TABLE[:1], 5)[0], np.array([[6.0, 1.9, 2.0]])
    received = sloped(BAND, snapshot(BAND, np.concatenate([known, new]), [3000.0, 1000j], 1.0), slope, slope)
    belief, off = Belief(MEAN, 1e-12 * np.eye(9)), 0.03 * extent_of(BAND.anchor)
    offs, stds = [], []
    for allowed in (off, 0.0):
        prior = PathsPrior(belief, PLACE, TABLE[:1], np.array([9e6]), NO_PATH, allowed)
        found = find_paths(BAND, received, prior, 1.0, np.array([9e6])).new
        row = np.linalg.norm(found.path - new[0], axis=1).argmin()
        offs.append(np.abs(found.path[row] - new[0]))
        stds.append(found.std[row])
    assert (offs[0] < 4 * stds[0]).all()
    assert (stds[0][1:] > 0.01).all()
    assert (offs[1][1:] > 4 * stds[1][1:]).any()


@pytest.mark.parametrize(("rows", "columns"), [(3, 3), (2, 3), (1, 4)])
def test_how_well_an_array_tells_a_direction_is_its_extent_across_it(rows, columns):
    """By hand: phases off by 0.1 rad, places t across a direction: 0.01 over the sum of their squares."""
    band = band_of(rows, columns, 9)
    prior = PathsPrior(Belief(MEAN, np.zeros((9, 9))), PLACE, TABLE, np.full(4, 1e-12), NO_PATH, 0.1)
    mode = state_mode(band, np.zeros((len(band.anchor), len(band.agent), 9), complex), prior, 1.0)
    for array, element in enumerate((band.anchor, band.agent)):
        angle = mode.path[:, 1 + array]
        across = np.outer(-np.sin(angle), element[:, 0]) + np.outer(np.cos(angle), element[:, 1])
        wanted = 0.01 / (across**2).sum(1)
        np.testing.assert_allclose(mode.spread[:, 1 + array, 1 + array], wanted, rtol=1e-6)


def test_one_antenna_turns_nothing():
    band = replace(band_of(3, 3, 9), anchor=np.zeros((1, 2)), agent=np.zeros((1, 2)))
    prior = PathsPrior(Belief(MEAN, np.zeros((9, 9))), PLACE, TABLE, np.full(4, 1e-12), NO_PATH, 0.1)
    mode = state_mode(band, np.zeros((1, 1, 9), complex), prior, 1.0)
    np.testing.assert_array_equal(mode.spread[:, 1:, 1:], 0)
