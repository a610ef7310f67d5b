"""Walls and points fitted to what is heard, against the plain counterpart."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam import reference
from gridslam.kernels import UNMEASURED

ROWS = 7


def fitted(*arguments):
    from gridslam.kernels.messages.scatterers import fit_forms

    forms = arguments[-1].copy()
    fit_forms(*arguments[:-1], forms)
    return forms


def spreads(draw, scale):
    """Covariances (xx, xy, yy) of rows, (7, 3)."""
    root = scale * draw.normal(size=(ROWS, 2, 2))
    return np.einsum("dij,dkj->dik", root, root).reshape(ROWS, 4)[:, [0, 1, 3]]


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.3, 2.0]))
@settings(max_examples=60, deadline=None)
def test_forms_are_those_of_the_twin(seed, scale):
    """New ones and old ones, with quantities that weren't measured, and anchors beside agent and point."""
    draw = np.random.default_rng(seed)
    root = 0.2 * draw.normal(size=(3, 3))
    heard = np.hstack([draw.uniform([0, -7, -7], [12, 7, 7], (ROWS, 3)), draw.uniform(1e-4, 0.1, (ROWS, 3))])
    heard[:, 3:][draw.random((ROWS, 3)) < 0.2] = UNMEASURED
    forms = np.hstack([
        draw.uniform(-4, 4, (ROWS, 2)), spreads(draw, scale), draw.uniform(-4, 4, (ROWS, 2)),
        spreads(draw, scale), draw.uniform(-29, 29, (ROWS, 1)),
    ])  # fmt: skip
    forms[draw.random(ROWS) < 0.3] = 0.0
    places = draw.uniform(-5, 5, (ROWS, 3))
    places[0, :2] = forms[0, 5:7]
    pose = places[1].copy() if draw.random() < 0.2 else draw.uniform(-5, 5, 3)
    lines = np.hstack([draw.uniform(-4, 4, (ROWS, 2)), spreads(draw, scale)])
    arguments = pose, root @ root.T, heard, places, lines, forms
    found, expected = fitted(*arguments), reference.fit_forms(*arguments)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


def test_a_length_off_a_wall_by_hand():
    """The wall x = 2, known to 0.1 m, anchor (0, 0), agent (0, 3): 5 m long, 5.2 m heard, to 0.1 m."""
    form = np.zeros((1, 11))
    form[0, :5], form[0, 5:10] = [0, 2, 0, 0, 0.01], [2, 1.5, 1, 0, 1]
    heard = np.array([[5.2, 0, 0, 0.01, UNMEASURED, UNMEASURED]])
    after = fitted(np.array([0, 3.0, 0]), np.zeros((3, 3)), heard, np.zeros((1, 3)), np.zeros((1, 5)), form)
    slope, bend = 2 * 4 / 5, 2 * 3 / 5  # the image moves by (2, 0): along its way, and across
    noise = 0.01 + 0.5 * (bend**2 * 0.01 / 5) ** 2
    whole = slope**2 * 0.01 + noise
    assert after[0, 1] == pytest.approx(2 + slope * 0.01 / whole * 0.2)
    assert after[0, 4] == pytest.approx(1.02 * (0.01 - (slope * 0.01) ** 2 / whole))


def test_a_point_begins_where_distance_and_arrival_put_it():
    """Anchor (0, 0), agent (4, 0) that hears 8 m from straight ahead, up: (4, 3)."""
    heard = np.array([[8.0, 0.0, 0.5 * np.pi, 0.01, UNMEASURED, 0.01]])
    after = fitted(
        np.array([4.0, 0, 0]), np.zeros((3, 3)), heard, np.zeros((1, 3)),
        np.array([[0.1, 2.0, 0.01, 0.0, 0.04]]), np.zeros((1, 11)),
    )  # fmt: skip
    np.testing.assert_allclose(after[0, 5:7], [4, 3], atol=1e-9)
    assert after[0, 10] == 0
