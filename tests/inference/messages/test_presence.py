"""Whether paths are there: hidden ones say nothing, and a line of sight that comes back is found."""

from dataclasses import replace

import numpy as np
import pytest
from signal_worlds import received, signal_model

from gridslam.inference.messages.features.heard_paths import HeardPaths
from gridslam.inference.messages.features.joint_update import predict, update
from gridslam.inference.messages.features.presence import log_likelihood, powers_of, presence_of
from gridslam.inference.messages.features.regaining import UNSURE_M, regained
from gridslam.inference.state.features.features import FeatureBank, entries
from gridslam.inference.state.features.hybrid_state import JointBelief

POINTS = np.array([[3.0, 4.0, 0.0], [-6.0, 2.0, 0.0], [-6.2, 2.3, 0.0]])  # line of sight, two that overlap
POWERS = np.array([4000.0, 800.0, 500.0])
AUDIBLE = np.array([True])


def belief(spread=0.05, features=2, agent=(0.0, 0.0, 0.0, 0.0)):
    one = JointBelief(
        np.array(agent), np.diag(np.full(4, spread**2)), FeatureBank.empty(), np.array([0.9]), POWERS[:1],
        np.ones(1),
    )  # fmt: skip
    for n in range(features):
        width = np.diag(np.square([0.05, 0.02, 1e-3]))
        one = one.with_feature(
            0, entries(POINTS[n + 1], np.zeros(2)), width, np.zeros(2), POWERS[n + 1], n, 0
        )
    return one


def products(one, z, model):
    """Of the responses of the paths that are believed in, with each other and with samples."""
    heard, at = HeardPaths(one, z[None], AUDIBLE, 0.3, model, (0.0, 0.0)), np.append(one.mean, 0.0)
    heard.place(np.stack([at, at]), np.eye(len(at)))
    return heard.multiply()[0]


@pytest.mark.parametrize("used", [(1, 1, 1), (1, 0, 1), (0, 1, 0), (0, 0, 0)])
def test_presence_weighs_the_samples_with_and_without_each_path(used):
    model, draw, before = signal_model(), np.random.default_rng(sum(used)), np.array([0.7, 0.2])
    z = received(model, (0.0, 0.0), 0.3, POINTS[:2], POWERS[:2] / 400, draw)[0]
    known = products(belief(), z, model)
    power = POWERS / 400  # faint ones: nothing is sure
    taken = power * np.array(used)
    after, doubt = presence_of(before, known.of(slice(0, 3)), taken, power[1:], 1.0)
    whole, more = log_likelihood(known, taken, 1.0), 0.0
    for n in (1, 2):
        density = []
        for level in (power[n], 0.0):
            other = taken.copy()
            other[n] = level
            density.append(np.exp(log_likelihood(known, other, 1.0) - whole))
        total = before[n - 1] * density[0] + (1 - before[n - 1]) * density[1]
        assert after[n - 1] == pytest.approx(before[n - 1] * density[0] / total)
        more += np.log(total)
    assert doubt == pytest.approx(more)
    assert 0.01 < after[0] < 0.999


@pytest.mark.slow
def test_a_hidden_feature_is_noticed_keeps_its_power_and_comes_back():
    model, draw, one = signal_model(), np.random.default_rng(6), belief(features=1)
    for step in range(30):
        rows = slice(0, 1 if 5 <= step < 25 else 2)
        one, _ = update(
            one, received(model, (0, 0), 0.3, POINTS[rows], POWERS[rows], draw), AUDIBLE, 0.3, model, step
        )
        if step != 5:
            assert (one.features.presence[0] > 0.5) == (not 5 <= step < 25)
    assert one.features.power[0] == pytest.approx(POWERS[1], rel=0.4)
    assert 8 <= one.features.steps_seen[0] <= 10


def test_a_power_follows_a_step_by_the_probability_that_its_path_is_there():
    model, one = signal_model(), belief(features=1)
    faint = np.array([POWERS[0], 2.0])
    z = received(model, (0, 0), 0.3, POINTS[:2], faint, np.random.default_rng(1))
    moved, there = [], []
    for presence in (0.99, 0.6):  # the same samples, and all else the same
        bank = replace(one.features, power=faint[1:], presence=np.array([presence]))
        after = update(replace(one, features=bank), z, AUDIBLE, 0.3, model, 0)[0].features
        moved.append(after.power[0] - faint[1])
        there.append(after.presence[0])
    assert 0.5 < there[1] < 0.9 * there[0]
    assert abs(moved[0]) > 1e-3
    assert moved[1] / moved[0] == pytest.approx(there[1] / there[0])


@pytest.mark.slow
def test_where_a_hidden_path_should_be_noise_says_nothing():
    model, draw = signal_model(), np.random.default_rng(2)
    one = belief(features=1)
    alone = one.keep(np.zeros(1, bool))
    for step in range(40):
        z = received(model, (0, 0), 0.3, POINTS[:1], 0.02 * POWERS[:1], draw)
        one, alone = (predict(known, 0.1, 2.0) if step else known for known in (one, alone))
        one, alone = (update(known, z, AUDIBLE, 0.3, model, step)[0] for known in (one, alone))
    np.testing.assert_allclose(one.agent_covariance, alone.agent_covariance, rtol=0.3, atol=2e-3)
    np.testing.assert_allclose(one.mean[:2], alone.mean[:2], atol=0.05)


@pytest.mark.parametrize("extent", [0.0, 0.2])
def test_a_hidden_feature_has_no_power_in_a_crowd_or_out_of_it(extent):
    model, draw, one = signal_model(), np.random.default_rng(3), replace(belief(features=1), extent=extent)
    for rows, power in ((slice(0, 1), 0.0), (slice(0, 2), POWERS[1])):
        z = received(model, (0, 0), 0.3, POINTS[rows], POWERS[rows], draw)
        assert powers_of(one, np.ones(1), 0, products(one, z[0], model))[1] == power


@pytest.mark.parametrize("off", [(0.9, -0.5), (-0.6, 1.0), (0.0, 0.0)])
def test_a_line_of_sight_that_comes_back_is_found_where_the_agent_may_be(off):
    model, draw = signal_model(), np.random.default_rng(4)
    lost = replace(belief(0.6, 1, (*off, 0.0, 0.0)), existence=np.array([1e-3]))
    lost.covariance[4, 0] = lost.covariance[0, 4] = 0.02  # what hangs together moves together
    z = received(model, (0, 0), 0.3, POINTS[:1], POWERS[:1], draw)
    begun = regained(lost, z, AUDIBLE, 0.3, model)
    assert np.hypot(*(begun[:2] - POINTS[0, :2])) == pytest.approx(5.0, abs=0.25)
    shift = begun - lost.mean
    assert shift[4] == pytest.approx(0.02 / 0.36 * shift[0])
    found, _ = update(lost, z, AUDIBLE, 0.3, model, 0)
    assert found.existence[0] > 0.99
    assert np.hypot(*found.mean[:2]) < 0.15


def test_a_line_of_sight_that_comes_back_is_found_without_any_feature():
    model, draw = signal_model(), np.random.default_rng(7)
    lost = replace(belief(0.6, 0, (0.9, -0.5, 0.0, 0.0)), existence=np.array([1e-3]))
    hidden = replace(belief(0.6, 1, (0.9, -0.5, 0.0, 0.0)), existence=np.array([1e-3]))
    bank = replace(hidden.features, presence=np.zeros(1))
    z = received(model, (0, 0), 0.3, POINTS[:1], POWERS[:1], draw)
    for one in (lost, replace(hidden, features=bank)):
        found, _ = update(one, z, AUDIBLE, 0.3, model, 0)
        assert found.existence[0] > 0.99
        assert np.hypot(*found.mean[:2]) < 0.15


def test_nothing_is_looked_for_where_noise_is_all_or_the_agent_is_known():
    model, draw = signal_model(), np.random.default_rng(5)
    lost = replace(belief(0.6, 1, (0.9, -0.5, 0.0, 0.0)), existence=np.array([1e-3]))
    for _ in range(10):
        z = received(model, (0, 0), 0.3, POINTS[1:2], POWERS[1:2], draw)
        noise = received(model, (0, 0), 0.3, POINTS[:0], POWERS[:0], draw)
        np.testing.assert_array_equal(regained(lost, noise, AUDIBLE, 0.3, model), lost.mean)
        # a feature's own path, seen from where it is believed to be, is no line of sight
        own = replace(lost, mean=belief(features=1).mean)
        np.testing.assert_array_equal(regained(own, z, AUDIBLE, 0.3, model), own.mean)
    z = received(model, (0, 0), 0.3, POINTS[:1], POWERS[:1], draw)
    sure = replace(belief(0.9 * UNSURE_M, 1, (0.2, 0.0, 0.0, 0.0)), existence=np.array([1e-3]))
    np.testing.assert_array_equal(regained(sure, z, AUDIBLE, 0.3, model), sure.mean)
    seen = replace(lost, existence=np.array([0.9]))
    np.testing.assert_array_equal(regained(seen, z, AUDIBLE, 0.3, model), seen.mean)
    np.testing.assert_array_equal(regained(lost, z, np.array([False]), 0.3, model), lost.mean)
