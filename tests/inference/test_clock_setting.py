"""Open clocks: histograms choose the mode that all agents' paths agree on, and only when they are sure."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from gridslam.inference.messages.clock_setting import clock_evidence
from gridslam.inference.state.clock_search import ClockSearch
from gridslam.world.clocks import ClockModel

CLOCKS = ClockModel(2, 1, np.array([30.0, 0.0, 0.0]), walk_m=0.03)
CENTRE = ClockSearch.start(CLOCKS).centre


def test_evidence_of_one_path_and_one_measurement_is_the_textbook_ratio():
    draw = np.random.default_rng(1)
    root = draw.normal(size=(3, 3)) * [[0.5], [0.1], [0.1]]
    value, spread, noise = np.array([8.0, 0.3, -2.9]), root @ root.T, np.array([0.2, 0.05, 0.08])
    measured, chance, clutter = np.array([[4.7, 0.35, 3.1]]), np.array([0.7]), 5 / 130 / (4 * np.pi**2)
    found = clock_evidence(value[None], spread[None], chance, measured, noise[None, None], clutter, CENTRE)
    whole = spread + np.diag(noise**2 + np.array([0.1**2 / 12, 0, 0]))
    residual = [(measured[0] - value)[0], 0.05, 3.1 + 2.9 - 2 * np.pi]
    density = [multivariate_normal.pdf(residual - np.array([b, 0, 0]), cov=whole) for b in CENTRE]
    np.testing.assert_allclose(found, np.log(0.3 + 0.7 * np.array(density) / clutter), rtol=1e-9)


def test_an_angle_that_was_not_measured_says_nothing():
    value, spread = np.array([[8.0, 0.3, -2.9]]), np.diag([0.04, 0.01, 0.01])[None]
    std, chance = np.full((1, 1, 3), 0.1), np.array([0.7])
    found = clock_evidence(value, spread, chance, np.array([[4.7, np.nan, -2.8]]), std, 0.01, CENTRE)
    by_hand = norm.pdf(-3.3 - CENTRE, 0, np.sqrt(0.05 + 0.1**2 / 12)) * norm.pdf(0.1, 0, np.sqrt(0.02))
    np.testing.assert_allclose(found, np.log(0.3 + 0.7 * by_hand / (2 * np.pi) / 0.01), rtol=1e-9)
    nothing = clock_evidence(value, spread, chance, np.array([[np.nan, 0.3, -2.9]]), std, 0.01, CENTRE)
    np.testing.assert_allclose(nothing, np.log(0.3))


def test_a_clock_is_set_once_its_rivals_are_gone():
    search = ClockSearch.start(CLOCKS)
    assert search.unset.tolist() == [True, False]
    peaks = -0.5 * ((CENTRE - 7.3) / 0.2) ** 2, -0.5 * ((CENTRE + 12) / 0.2) ** 2 - 3.0
    both = np.tile(np.logaddexp(*peaks), (2, 1))
    search = search.heard(both)
    assert search.decided() == []  # the rival still has 5 %
    mean, variance = search.moments(0)
    assert -12 < mean < 7.3
    assert variance > 10
    search = search.heard(both)
    ((anchor, offset),) = search.decided()
    assert anchor == 0
    assert offset == pytest.approx(7.3, abs=0.02)
    assert not search.closed(0).unset.any()


def test_walks_blur_and_nothing_leaves_the_prior():
    search = ClockSearch.start(CLOCKS).heard(np.tile(-0.5 * ((CENTRE - 5.0) / 0.3) ** 2, (2, 1)))
    before = search.moments(0)[1]
    after = search.walked(0.25)
    assert after.moments(0)[1] - before == pytest.approx(0.25, rel=0.02)
    assert after.mass[0].sum() == pytest.approx(1)
    assert after.mass[1].max() == 1  # the other anchor's prior is a point


def test_an_opened_clock_knows_nothing():
    search = ClockSearch.start(CLOCKS).heard(np.tile(-(CENTRE**2), (2, 1))).closed(0).opened(0, CLOCKS)
    assert search.unset[0]
    np.testing.assert_allclose(search.mass[0], 1 / len(CENTRE))
