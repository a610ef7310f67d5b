"""Lines, mirrors and paths: identities, finite differences, and drawn polylines."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gridslam as gs
from gridslam.world.geometry import line_between, line_of_sfv, mirror, sfv, trace, wrap

angles, offsets = st.floats(-3, 3), st.floats(0.5, 20)
places = st.tuples(st.floats(-20, 20), st.floats(-20, 20)).map(np.array)


@given(angles, offsets, places)
def test_mirroring_twice_is_the_identity(angle, offset, point):
    line = np.array([angle, offset])
    np.testing.assert_allclose(mirror(line, mirror(line, point)), point, atol=1e-9)


@given(angles, offsets)
def test_a_line_and_its_sfv_are_the_same_surface(angle, offset):
    line = np.array([angle, offset])
    back = line_of_sfv(sfv(line))
    assert abs(wrap(back[0] - angle)) < 1e-9
    assert back[1] == pytest.approx(offset)


@given(angles, offsets, places)
def test_the_line_between_a_point_and_its_image_is_the_mirror(angle, offset, point):
    line = np.array([angle, offset])
    image = mirror(line, point)
    if np.linalg.norm(image - point) > 1e-3:
        np.testing.assert_allclose(mirror(line_between(point, image), point), image, atol=1e-7)


def test_path_derivatives_agree_with_finite_differences_for_every_number_of_bounces():
    draw = np.random.default_rng(0)
    count = 60
    agent, anchor = draw.normal(0, 5, (2, count, 2))
    last, first = (np.stack([draw.uniform(-3, 3, count), draw.uniform(0, 8, count)], -1) for _ in range(2))
    bounces = draw.integers(0, 3, count)

    def values(shift):
        path = trace(agent + shift[:2], anchor, last + shift[3:5], first + shift[5:7], bounces)
        return np.stack([path.distance, path.departure, path.arrival - shift[2]], -1)

    exact = trace(agent, anchor, last, first, bounces).jacobian
    for column in range(7):
        shift = np.eye(7)[column] * 1e-6
        change = values(shift) - values(-shift)
        change[:, 1:] = wrap(change[:, 1:])
        np.testing.assert_allclose(exact[:, :, column], change / 2e-6, atol=1e-6)


def test_path_length_equals_the_drawn_polyline_and_the_law_of_reflection_holds():
    paths = gs.ground_truth(gs.Scene.load("room"), "agent1").paths
    start, end, owner = paths.legs
    length = np.zeros(len(paths))
    np.add.at(length, owner, np.linalg.norm(end - start, axis=1))
    np.testing.assert_allclose(length, paths.distance_m, rtol=1e-9)
    assert set(paths.bounces) == {0, 1, 2}
