"""Paths as functions of the whole state, against their plain counterpart."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_worlds import random_belief

from gridslam import reference


def traced(mean, root, spot, path):
    """What the kernel makes of paths at a state."""
    from gridslam.kernels.propagation.state_paths import trace_paths

    value, turn = np.full((len(path), 3), np.nan), np.full((len(path), 3, len(mean)), np.nan)
    trace_paths(5, mean, root, spot, path, value, turn)
    return value, turn


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.sampled_from([0.0, 1.5]))
@settings(max_examples=30, deadline=None)
def test_paths_and_their_derivatives_are_those_of_the_twin(seed, surfaces, height):
    draw = np.random.default_rng(seed)
    mean, covariance, path = random_belief(draw, surfaces)
    root = np.linalg.cholesky(covariance)
    spot = np.array([*draw.uniform(-5, 5, 2), draw.uniform(-3, 3), 0.3 * height, height])
    value, turn = traced(mean, root, spot, path)
    expected, slope = reference.trace_paths(5, mean, root, spot, path)
    gap = value - expected
    gap[:, 1:] = np.remainder(gap[:, 1:] + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(gap, 0.0, atol=2e-6)
    np.testing.assert_allclose(turn, slope, atol=2e-6, rtol=2e-6)


def test_no_paths_are_none_and_a_line_of_sight_is_known_by_hand():
    mean, root = np.array([3.0, 4.0, 0.0, 0.0, 0.5]), np.eye(5)
    value, turn = traced(
        mean, root, np.array([0.0, 0.0, 0.1, 0.0, 0.0]), np.array([[0, -1, -1, 0]], np.int32)
    )
    angle = np.arctan2(4.0, 3.0)
    np.testing.assert_allclose(value[0], [5.0, angle - 0.1, angle - np.pi - 0.5], atol=1e-6)
    np.testing.assert_allclose(turn[0, 0], [0.6, 0.8, 0.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(turn[0, 2], [-0.16, 0.12, 0.0, 0.0, -1.0], atol=1e-6)
    none, _ = traced(mean, root, np.zeros(5), np.zeros((0, 4), np.int32))
    assert none.shape == (0, 3)
