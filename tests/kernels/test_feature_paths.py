"""Kernels on the paths of learned features against their twins, by way of their owner."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_worlds import SEEDS
from signal_worlds import signal_model

from gridslam import reference
from gridslam.inference.messages.features.heard_paths import HeardPaths
from gridslam.inference.state.features.features import FeatureBank
from gridslam.inference.state.features.hybrid_state import JointBelief

HEADING, OWN = 0.7, (0.04, 0.01)


def world(seed, features, frequencies=41, antennas=4):
    """A model, samples (J, N, M), a belief in so many features of each anchor, a state beside its mean."""
    draw, anchors = np.random.default_rng(seed), len(features)
    element = draw.uniform(-0.01, 0.01, (antennas, 2))
    model = signal_model(frequencies=frequencies, anchor_element_m=np.zeros((anchors, 1, 2)))
    model = replace(
        model, anchors=draw.uniform(-6, 6, (anchors, 3)),
        waveform=replace(model.waveform, agent_element_m=element - element[::-1]),
    )  # fmt: skip
    whose = draw.permutation(np.repeat(np.arange(anchors), features))
    many = len(whose)
    bank = FeatureBank(
        np.arange(many), whose, draw.normal(size=(many, 2)), draw.uniform(1, 100, many), np.zeros(many, int),
        np.zeros(many, int), np.ones(many),
    )  # fmt: skip
    length, extra = draw.uniform(3, 15, many), draw.uniform(0, 2, many)
    own = np.stack([length, draw.uniform(-np.pi, np.pi, many), extra], 1)
    mean = np.concatenate([draw.normal(size=4), own.ravel()])
    root = 0.1 * draw.normal(size=(len(mean), len(mean)))
    los, noise = draw.uniform(1, 100, anchors), draw.uniform(0.5, 2, anchors)
    belief = JointBelief(mean, root @ root.T, bank, np.ones(anchors), los, noise, 0.2)
    samples = draw.normal(size=(2, anchors, antennas, frequencies))
    at = np.append(mean, 0.0) + 0.05 * draw.normal(size=len(mean) + 1)
    return model, samples[0] + 1j * samples[1], belief, np.stack([at, np.append(mean, 0.0)])


def same(one, other):
    np.testing.assert_allclose(one, other, atol=1e-10 * np.abs(other).max(initial=0.0), rtol=1e-10)


def compare(model, samples, belief, state, audible, silent=0.0):
    """All that the kernels make of heard anchors, a share of whose paths have no power, against the twins."""
    draw, size = np.random.default_rng(len(belief.mean)), len(belief.mean)
    heard = HeardPaths(belief, samples, audible, HEADING, model, OWN)
    prior = np.zeros((size + 1, size + 1))
    prior[:size, :size], prior[size, size] = belief.covariance, 0.01
    heard.shift[:] = 0.02 * draw.normal(size=len(heard.shift))
    heard.place(state, prior)
    expected = [
        reference.place_paths(state, prior, belief, j, HEADING, model) for j in np.flatnonzero(audible)
    ]
    numbers = np.concatenate([one[0] for one in expected]) + heard.shift
    same(heard.numbers, numbers)
    same(heard.off, np.concatenate([one[1] for one in expected]) + heard.shift)
    same(heard.towards, np.concatenate([one[2] for one in expected]))
    power = draw.uniform(1, 50, len(numbers) // 2)
    power[draw.uniform(size=len(power)) < silent] = 0.0
    known, first, density = heard.multiply(), 0, 0.0
    found = heard.slopes(power)
    for j, products, one in zip(heard.anchors, known, expected, strict=True):
        rows = slice(first, first + len(one[0]))
        own = np.repeat(OWN, len(one[0]) // 2)
        own[[0, len(own) // 2]] = 0.0  # lines of sight are where they are
        same(heard.spread[rows, rows], one[3] + np.diag(own))
        gram, matched = reference.multiply_paths(numbers[rows], samples[j], model.waveform)
        same(products.gram, gram)
        same(products.matched, matched)
        assert products.energy == pytest.approx(np.vdot(samples[j], samples[j]).real, rel=1e-12)
        score, curvature, log = reference.slope_paths(
            gram, matched, power[rows.start // 2 : rows.stop // 2], belief.noise[j], products.energy,
            samples[j].size,
        )  # fmt: skip
        same(found.score[rows], score)
        same(found.curvature[rows, rows], curvature)
        density += log
        between = found.curvature[rows].copy()
        between[:, rows] = 0.0
        assert not between.any(), "what one anchor sends says nothing of another's paths"
        first = rows.stop
    assert found.log_density == pytest.approx(density, rel=1e-10)
    same(heard.spread, heard.spread.T)


@given(SEEDS, st.lists(st.integers(0, 9), min_size=1, max_size=3), st.sampled_from([0.0, 0.4, 1.0]))
@settings(max_examples=25, deadline=None)
def test_paths_their_products_and_slopes_equal_their_twins(seed, features, silent):
    compare(*world(seed, features), np.ones(len(features), bool), silent)


@pytest.mark.parametrize("antennas", [1, 2, 5])
@pytest.mark.parametrize("frequencies", [8, 9])
def test_any_number_of_antennas_and_frequencies_will_do(antennas, frequencies):
    compare(*world(3, [2, 4], frequencies, antennas), np.array([True, True]))


def test_anchors_that_are_not_heard_are_left_out():
    compare(*world(5, [3, 1, 4]), np.array([True, False, True]))


def test_as_many_paths_as_there_may_be_equal_their_twins():
    compare(*world(6, [40]), np.array([True]))


def test_paths_of_no_length_are_taken_for_short_ones():
    model, samples, belief, state = world(7, [1])
    belief.features.origin_m[0] = state[0, :2]
    model.anchors[0, :2], state[0, [4, 6]] = state[0, :2] + 0.01, 0.0
    compare(model, samples, belief, state, np.array([True]))
