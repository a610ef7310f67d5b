"""Likelihood of samples under learned features, its slopes, and back-projection, against their twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_worlds import SEEDS

from gridslam import reference


def world(seed, **shape):
    from signal_worlds import signal_world

    return signal_world(np.random.default_rng(seed), **shape)


@pytest.mark.slow
@given(SEEDS, st.integers(1, 5), st.sampled_from([1, 4]))
@settings(max_examples=25, deadline=None)
def test_ratios_are_those_of_the_covariance_of_all_samples(seed, features, antennas):
    one = world(seed, features=features, antennas=antennas)
    expected = reference.evaluate_features(*one.known)
    np.testing.assert_allclose(one.value()[:, 1:], expected[:, 1:], rtol=2e-3, atol=1e-6)
    # tables are 1e-4 of the greatest output off, and log-likelihoods go with its square over the noise
    np.testing.assert_allclose(one.value()[:, 0], expected[:, 0], rtol=2e-4, atol=2e-3)


@pytest.mark.slow
@given(SEEDS, st.integers(1, 4))
@settings(max_examples=15, deadline=None)
def test_slopes_are_those_of_the_covariance_of_all_samples(seed, features):
    one = world(seed, features=features)
    slopes, value = one.slopes()
    expected = reference.differentiate_features(*one.known)
    np.testing.assert_allclose(slopes, expected, atol=2e-4 * np.abs(expected).max() + 1e-3)
    np.testing.assert_allclose(value, one.value()[:, 0], rtol=1e-9, atol=1e-9)
    some, again = one.slopes(first=features - 1)
    np.testing.assert_array_equal(some[:, -1], slopes[:, -1])
    np.testing.assert_array_equal(again, value)
    assert np.isnan(some[:, :-1]).all()  # untouched


@pytest.mark.slow
@pytest.mark.parametrize("order", [[0, 1, 2, 3], [0, 3, 1, 2], [0, 1, 4, 2, 3]])
def test_antennas_that_mirror_each_other_or_do_not_are_heard_alike(order):
    # whether one stands for both or not: in pairs, in another order, and with one in the middle
    one = world(8, features=5, particles=9)
    element, samples = np.append(one.element, np.zeros((1, 2)), 0), np.append(one.samples, one.samples[:1], 0)
    one = one._replace(element=element[order], samples=samples[order])
    expected = reference.evaluate_features(*one.known)
    np.testing.assert_allclose(one.value()[:, 0], expected[:, 0], rtol=2e-4, atol=2e-3)
    slopes, twins = one.slopes()[0], reference.differentiate_features(*one.known)
    np.testing.assert_allclose(slopes, twins, atol=2e-4 * np.abs(twins).max() + 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("entry", range(4))
def test_the_twin_of_the_slopes_equals_finite_differences(entry):
    one, step = world(5), 1e-5
    for n in range(len(one.features)):
        way = np.zeros_like(one.features)
        way[n, entry] = step
        more, less = (
            reference.evaluate_features(*one._replace(features=one.features + s * way).known)[:, 0]
            for s in (1, -1)
        )
        slope = reference.differentiate_features(*one.known)[:, n, entry]
        np.testing.assert_allclose((more - less) / (2 * step), slope, rtol=1e-5, atol=1e-5)


PLAN = np.array([0.0, 0.5, 1e-4, 0.03, 0.03, 0.01, 5e-3])


@pytest.mark.slow
@given(SEEDS, st.integers(0, 2))
@settings(max_examples=5, deadline=None)
def test_steps_of_adam_are_those_of_the_covariance_of_all_samples(seed, known):
    # steps begin by the sign of the slope alone: where it is next to nothing, tables may have the other
    one = world(seed, features=4, particles=2, noise=1e-2)
    kind = np.random.default_rng(seed).integers(0, 3, 4 - known, np.int32)
    end, best, value = one.climb(kind, PLAN, [4])
    end_twin, best_twin, value_twin = reference.climb_features(*one.known, kind, PLAN, 4)
    np.testing.assert_allclose(value, value_twin, rtol=2e-3, atol=0.05)
    for found, expected in ((end, end_twin), (best, best_twin)):
        off = np.abs(found - expected) > 2e-3
        assert off.mean() <= 0.1, off
        assert np.abs(found - expected).max() < 0.2
        np.testing.assert_array_equal(found[:known], one.features[:known])


@pytest.mark.slow
@pytest.mark.parametrize("kind", range(3))
def test_many_steps_of_adam_are_those_of_the_twin(kind):
    # one strong feature, 5 cm and half its power off, by small steps: slopes change, and so do their means
    one = world(11, features=1, particles=1, noise=1e-3)
    off = one._replace(features=one.features * [1, 1, 1, 0.5] + np.array([0.05, 0.03, 0.0, 0.0]))
    kinds = np.array([kind], np.int32)
    end, best, value = off.climb(kinds, PLAN, [20])
    twins = reference.climb_features(*off.known, kinds, PLAN, 20)
    np.testing.assert_allclose(end, twins[0], atol=1e-3)
    np.testing.assert_allclose(best, twins[1], atol=1e-3)
    np.testing.assert_allclose(value, twins[2], rtol=1e-3, atol=0.05)


@pytest.mark.slow
def test_an_ascent_in_several_launches_is_that_in_one():
    one, kind = world(4, particles=11), np.array([1, 2], np.int32)
    for whole, parts in zip(one.climb(kind, PLAN, [7]), one.climb(kind, PLAN, [3, 1, 3]), strict=True):
        np.testing.assert_array_equal(whole, parts)


@pytest.mark.slow
def test_the_best_features_on_the_way_are_kept_and_kinds_hold():
    one, kind = world(6, features=3, noise=1e-2), np.array([0, 1, 2], np.int32)
    wild = PLAN * [1, 1, 1, 30, 30, 30, 30]  # steps of a metre lead away again
    end, best, value = one.climb(kind, wild, [10])
    assert value[-1] < value.max()
    kept = one._replace(features=best)
    np.testing.assert_allclose(kept.value()[:, 0].sum(), value.max(), rtol=1e-9)
    for found in (end, best):
        assert found[0, 2] == one.features[0, 2], "an image's extra length stays"
        assert (found[:, 2:] >= [0, 0.5e-4]).all()
    assert end[1, 2] == pytest.approx(np.hypot(*(end[1, :2] - one.anchor)))


@pytest.mark.parametrize("particles", [1, 7, 8, 9, 200])
def test_points_side_by_side_do_not_mix(particles):
    one = world(7, particles=particles)
    value, (slopes, again) = one.value(), one.slopes()
    np.testing.assert_allclose(again, value[:, 0], rtol=1e-12)
    for p in {0, particles // 2, particles - 1}:
        alone = one._replace(points=one.points[p : p + 1])
        np.testing.assert_allclose(alone.value()[0], value[p], rtol=1e-12)
        np.testing.assert_allclose(alone.slopes()[0][0], slopes[p], rtol=1e-9, atol=1e-9)


def test_no_feature_a_faint_one_and_one_in_the_line_of_sight_say_nothing():
    one = world(1)
    np.testing.assert_array_equal(one._replace(features=one.features[:0]).value()[:, 0], 0.0)
    faint = one.features * [1, 1, 1, 1e-9]
    np.testing.assert_allclose(one._replace(features=faint).value()[:, 0], 0.0, atol=1e-3)
    hidden = np.array([[*one.anchor, 0.0, 0.5]])
    np.testing.assert_allclose(one._replace(features=hidden).value()[:, 0], 0.0, atol=1e-6)


def test_a_feature_farther_off_than_paths_are_heard_says_nothing():
    one = world(2, features=1)
    far = np.array([[25.0, 20.0, 0.0, 1.0]])
    np.testing.assert_array_equal(one._replace(features=far).value()[:, 0], 0.0)
    np.testing.assert_array_equal(one._replace(features=far).slopes()[0], 0.0)


@pytest.mark.parametrize("frequencies", [40, 41])  # responses a fold farther are the same, or their negative
def test_a_line_of_sight_from_farther_off_than_lengths_fold_is_that_of_the_samples(frequencies):
    one = world(3, features=3, frequencies=frequencies)
    one = one._replace(anchor=one.anchor + np.array([50.0, 20.0]))
    expected = reference.evaluate_features(*one.known)
    np.testing.assert_allclose(one.value()[:, 1:], expected[:, 1:], rtol=0.01, atol=1e-9)
    np.testing.assert_allclose(one.value()[:, 0], expected[:, 0], rtol=2e-4, atol=2e-3)
    slopes, twins = one.slopes()[0], reference.differentiate_features(*one.known)
    np.testing.assert_allclose(slopes, twins, atol=2e-4 * np.abs(twins).max() + 1e-3)


def test_the_best_power_of_a_feature_is_what_its_output_has_beyond_the_noise():
    # the maximum over g of A for one feature and one step: (|y|^2 / K - eta) / K
    one = world(3, features=1, noise=1e-2)
    point, feature = one.points[0, :3], one.features[0]
    _, column = reference.columns(point, one.features, one.anchor, one.element, one.pulse, one.rate)
    energy = np.vdot(column, column).real
    square, noise = abs(np.vdot(column, one.samples.ravel())) ** 2, one.points[0, 3]
    best = (square / energy - noise) / energy
    assert best > 0
    values = [
        one._replace(points=one.points[:1], features=np.array([[*feature[:3], g]])).value()[0, 0]
        for g in best * np.array([0.9, 1.0, 1.1])
    ]
    assert values[1] > max(values[0], values[2])
    there = one._replace(points=one.points[:1], features=np.array([[*feature[:3], best]]))
    assert abs(there.slopes()[0][0, 0, 3]) < 1e-3 / best


@pytest.mark.slow
@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_turned_shifted_permuted_and_rescaled_worlds_give_the_same_numbers(seed):
    one, draw = world(seed), np.random.default_rng(seed)
    value, angle = one.value(), 1.1
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift, points, features = np.array([3.0, -7.0]), one.points.copy(), one.features.copy()
    points[:, :2] = points[:, :2] @ turn.T + shift
    points[:, 2] += angle
    features[:, :2] = features[:, :2] @ turn.T + shift
    turned = one._replace(points=points, features=features, anchor=turn @ one.anchor + shift)
    np.testing.assert_allclose(turned.value(), value, rtol=1e-6, atol=1e-6)
    mixed = one._replace(features=one.features[draw.permutation(3)])
    np.testing.assert_allclose(mixed.value(), value, rtol=1e-9, atol=1e-9)
    louder = one._replace(
        samples=10 * one.samples, points=one.points * [1, 1, 1, 100], features=one.features * [1, 1, 1, 100]
    )
    np.testing.assert_allclose(louder.value()[:, 0], value[:, 0], rtol=1e-6, atol=1e-6)


def test_back_projection_gains_what_one_feature_does():
    # far from everything else, the gain of a feature is its A
    from signal_worlds import LONGEST_M

    from gridslam.inference.messages.features.matched_outputs import coarse_outputs, rows_per_m
    from gridslam.kernels.messages.back_projection import POWERS, back_project

    one = world(8, features=1)
    power = np.geomspace(0.01, 1, POWERS)
    places = np.concatenate([one.features[:, :3], [[6.0, -6.0, 1.0], [40.0, 0.0, 0.0]]])
    table = coarse_outputs(one.samples, one.offset_hz, one.pulse)
    tables, out = np.stack([table] * len(one.points)), np.full((3, 2), np.nan)
    per_m = rows_per_m(one.offset_hz, table.shape[0] - 1)
    back_project(places, one.points, one.element, tables, per_m, LONGEST_M, power, out)
    expected, best = reference.back_project(
        places[:2], one.points, one.element, one.pulse, one.rate, one.samples, power
    )
    np.testing.assert_allclose(out[:2, 0], expected, rtol=3e-3)
    np.testing.assert_array_equal(out[:2, 1], best)
    assert out[2, 0] == 0.0
