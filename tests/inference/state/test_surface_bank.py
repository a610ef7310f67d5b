"""The walk of reflection coefficients: a belief stays one, whatever a scene sets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.inference.state.surface_bank import diffused
from gridslam.world.filter_settings import FilterSettings
from gridslam.world.radio import BINS, REFLECTION_BINS

SEEDS = st.integers(0, 2**32 - 1)


def explicit(belief, std):
    """One step of the explicit scheme, as filters took it from the first on."""
    step, after = 0.5 * (std * BINS) ** 2 * (belief[:, 1:] - belief[:, :-1]), belief.copy()
    after[:, :-1] += step
    after[:, 1:] -= step
    return after


@given(SEEDS, st.floats(0, 1) | st.floats(0, 1e12), st.integers(1, 5))
def test_a_belief_about_a_coefficient_stays_one_for_any_setting(seed, std, steps):
    draw, std = np.random.default_rng(seed), FilterSettings(reflection=std).reflection
    belief = draw.dirichlet(np.full(BINS, 0.05), 3)
    for _ in range(steps):
        belief = diffused(belief, std)
    assert (belief >= 0).all()
    np.testing.assert_allclose(belief.sum(1), 1, atol=1e-12)


@given(st.floats(0, 0.09))
def test_a_coefficients_variance_grows_as_the_setting_says_and_its_mean_stays(std):
    belief = np.eye(BINS)[[9]]  # too far from the ends to come there
    after = diffused(belief, std)
    mean = after @ REFLECTION_BINS
    assert mean == pytest.approx(REFLECTION_BINS[9])
    assert after @ (REFLECTION_BINS - mean) ** 2 == pytest.approx(std**2, abs=1e-9)


@pytest.mark.parametrize("std", [0.0, 0.003, 0.01, 0.03])
def test_a_narrow_walk_is_one_step_of_the_explicit_scheme_bit_for_bit(std):
    belief = np.random.default_rng(1).dirichlet(np.ones(BINS), 4)
    np.testing.assert_array_equal(diffused(belief, std), explicit(belief, std))


@pytest.mark.parametrize("std", [10.0, 1e12])
def test_a_walk_wider_than_all_coefficients_leaves_nothing_known(std):
    np.testing.assert_allclose(diffused(np.eye(BINS), std), 1 / BINS, atol=1e-12)
