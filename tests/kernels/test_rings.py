"""Messages to hypotheses of rings: the kernels against their plain counterparts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam import reference
from gridslam.inference.messages.samples.image_rings import NODES, nodes
from gridslam.inference.messages.samples.signal_likelihood import Band, Inverse, pairs

SEEDS = st.integers(0, 2**32 - 1)


def some_rings(draw, rings, hypotheses, spread, span=60.0):
    """Weights, some of them 0, means and covariances, of images up to two folding ranges away."""
    weight = draw.random((rings, hypotheses)) * (draw.random((rings, hypotheses)) < 0.7)
    mean = draw.normal(size=(rings, hypotheses, 6))
    mean[..., 4:] *= span / 2
    root = spread * draw.normal(size=(rings, hypotheses, 6, 6))
    return weight, mean, root @ np.swapaxes(root, -1, -2) + 1e-6 * np.eye(6)


def agree(found, expected, rtol=1e-8):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(
            one, other, rtol=rtol, atol=rtol * max(1.0, np.abs(other).max(initial=0.0))
        )


@given(SEEDS, st.integers(0, 3), st.integers(1, 9), st.booleans())
@settings(max_examples=25, deadline=None)
def test_what_the_agent_learned_is_taken_in_as_the_twin_does(seed, rings, hypotheses, surer):
    from gridslam.kernels.messages.rings import follow_rings

    draw = np.random.default_rng(seed)
    weight, mean, covariance = some_rings(draw, rings, hypotheses, 0.3, span=10.0)
    root, more = draw.normal(size=(2, 4, 4)) * draw.exponential(1.0, 4)
    root, doubt = (root, np.zeros((4, 4))) if surer else (np.zeros((4, 4)), 0.01 * more @ more.T)
    before, information = draw.normal(size=4), root @ root.T
    push = information @ draw.normal(size=4)
    expected = reference.follow_rings(weight, before, push, information, doubt, mean, covariance)
    log = np.zeros(weight.shape)
    follow_rings(weight, np.column_stack([before, push, root, doubt]), mean, covariance, log)
    agree((mean, covariance, log), expected)


def test_a_hypothesis_takes_in_information_as_a_measurement_by_hand():
    from gridslam.kernels.messages.rings import follow_rings

    # x of variance 4 is seen at 3 with variance 4: half of both; the image's x leans on it by a half
    mean, covariance, log = np.zeros((1, 2, 6)), np.tile(np.eye(6), (1, 2, 1, 1)), np.full((1, 2), 7.0)
    covariance[..., 0, 0], covariance[..., 0, 4], covariance[..., 4, 0] = 4.0, 2.0, 2.0
    covariance[..., 4, 4] = 2.0
    learned = np.zeros((4, 10))
    learned[0, 1:3] = 3 / 4, 1 / 2
    follow_rings(np.array([[1.0, 0.0]]), learned, mean, covariance, log)
    np.testing.assert_allclose(mean[0, 0, [0, 4]], [1.5, 0.75])
    np.testing.assert_allclose(covariance[0, 0][np.ix_([0, 4], [0, 4])], [[2.0, 1.0], [1.0, 1.5]])
    assert log[0, 0] == pytest.approx(0.5 * 0.75 * 1.5 - 0.5 * np.log(2))
    assert not mean[0, 1].any()  # of weight 0: left as it is
    assert log[0, 1] == 7.0


@given(SEEDS, st.integers(0, 3), st.integers(1, 6), st.sampled_from([0.01, 0.3, 8.0]))
@settings(max_examples=25, deadline=None)
def test_a_snapshot_is_weighed_as_the_twin_does(seed, rings, hypotheses, spread):
    from gridslam.kernels.messages.rings import weigh_rings

    draw = np.random.default_rng(seed)
    band = Band.of(1e7 * (np.arange(17) - 8.0), draw.normal(size=17) + 1j * draw.normal(size=17))
    paths, samples = rings + 2, 3 * (draw.normal(size=17) + 1j * draw.normal(size=17))
    inverse = Inverse.of(
        band, samples, draw.exponential(30.0, paths), draw.uniform(2, 20, paths), np.full(paths, 1e-3), 1.0
    )
    whole, rows = inverse.sweep(256), np.arange(2, paths)
    intensity = draw.exponential(30.0, rings)
    logs = inverse.sweeps_without(whole, rows).log_ratio(intensity[:, None])
    weight, mean, covariance = some_rings(draw, rings, hypotheses, spread)
    limits = np.array(
        [whole.spacing_m, draw.uniform(1, 40), 0.06, 0.97, 1 / np.sqrt(2 * np.pi), 2 * np.pi / 256]
    )
    expected = reference.weigh_rings(weight, logs.reshape(rings, 256), limits, NODES, mean, covariance)
    log, there = np.zeros((2, *weight.shape))
    weigh_rings(
        weight, intensity, pairs(whole.matched), whole.self_power, pairs(inverse.taken_by(rows)), limits,
        np.full(256, np.nan), nodes(), mean, covariance, log, there,
    )  # fmt: skip
    agree((mean, covariance, log, there), expected, 1e-7)
