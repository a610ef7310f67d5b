"""The filter that follows an agent by lines of sight, against its plain counterpart and by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam import reference
from gridslam.kernels.primitives import sights as column
from gridslam.kernels.primitives.sights import Sights

FULL = np.array([0.9, 0.1, 0.5, 8, 0, 0, 0.9, 0.3, 0.0])


def follow(tables, some):
    from gridslam.kernels.management.sight_filter import follow_sights

    steps, most = len(tables.step) - 1, max(len(some), tables.step[:, column.COUNT].max())
    particle, place = np.zeros((2, most, column.PARTICLE)), np.empty((steps, 3))
    likeliest = np.empty((len(tables.scan) - 1, 3))
    particle[0, : len(some)] = some
    line = np.empty((len(tables.row) + len(tables.scan) + column.LINES, most))
    follow_sights(tables, particle, line, place, likeliest)
    return place, likeliest, particle[steps % 2, : tables.step[-1, column.COUNT]]


def drawn(seed, steps, thorough, world, sized, left=25, anchors=3, walls=4):
    """Tables of a random course, and particles about where it begins."""
    draw, count = np.random.default_rng(seed), 25
    counts = np.array([count, *[left] * steps])
    used = 3 * counts[:-1] + 1 + sized * counts[1:]
    begin = np.concatenate([[0], np.cumsum(used)])
    numbers = draw.standard_normal(begin[-1])
    numbers[begin[:-1] + 3 * counts[:-1]] = draw.random(steps)
    heard = [draw.permutation(anchors)[: draw.integers(1, anchors + 1)] for _ in range(steps)]
    scans = np.concatenate(heard)
    sizes = draw.integers(1, 5, len(scans))
    first = np.cumsum([0, *map(len, heard)])
    step = np.column_stack([draw.integers(1, 4, steps + 1), first, begin, counts])
    row = np.zeros((sizes.sum(), column.PEAK + 1))
    row[:, 0], row[:, 1:3] = draw.uniform(1, 9, len(row)), draw.uniform(-3, 3, (len(row), 2))
    row[:, column.SURE : column.PEAK] = draw.uniform(0.1, 1.5, (len(row), 3))
    missing = draw.random((len(row), 3)) < 0.2
    row[:, :3][missing] = row[:, column.SURE : column.PEAK][missing] = 0.0
    row[:, column.PEAK] = draw.uniform(1, 30, len(row))
    stands = np.column_stack([draw.uniform(-4, 4, (anchors, 2)), draw.uniform(-3, 3, anchors)])
    spoilt = np.column_stack([draw.uniform(0, 2, anchors), *(sized * draw.integers(-1, 2, (2, anchors)))])
    choice = FULL.copy()
    choice[[column.WORLD, column.THOROUGH]] = world, thorough
    choice[[column.LASTING, column.SHRINKAGE]] = 0.9 * thorough, 0.98 * sized
    scan = np.column_stack([[*scans, 0], [0, *np.cumsum(sizes)]])
    tables = Sights(
        choice, step.astype(np.int32), scan.astype(np.int32), row,
        np.hstack([stands, spoilt]), draw.uniform(-5, 5, (walls, 4)), numbers,
    )  # fmt: skip
    some = draw.normal(size=(count, column.PARTICLE))
    some[:, column.PACE], some[:, column.SIZE] = draw.uniform(0.1, 1, count), sized * draw.normal(size=count)
    return tables, some


@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans(), st.booleans(), st.sampled_from([0, 4]))
@settings(max_examples=60, deadline=None)
def test_a_step_is_that_of_the_twin(seed, thorough, world, sized, walls):
    tables, some = drawn(seed, 1, thorough, world, sized, walls=walls)
    (place, likeliest, after), (plain, best, others) = (
        follow(tables, some),
        reference.follow_sights(tables, some),
    )
    np.testing.assert_allclose(place, plain, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(likeliest[:, 1:], best[:, 1:], rtol=1e-3, atol=1e-6)
    same = np.isclose(after, others, rtol=1e-4, atol=1e-4).all(1)
    assert same.mean() > 0.9  # a place between two particles may fall to either


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("left", [10, 40])
def test_a_course_is_that_of_the_twin(seed, left):
    tables, some = drawn(seed, 6, seed % 2, False, seed > 1, left)
    found, expected = follow(tables, some), reference.follow_sights(tables, some)
    for ours, plain in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, plain, rtol=1e-3, atol=1e-3)
    assert len(found[2]) == left


def test_evidence_of_two_particles_is_as_worked_out_by_hand():
    """An anchor at the origin faces +y, the agent at (3, 0) or (3, 4) +x; a wall hides the second place.

    Of two rows the first is 3 m long, departs at -90 degrees and arrives at 180.
    """
    some = np.zeros((2, column.PARTICLE))
    some[:, 0], some[1, 1] = 3.0, 4.0
    row = np.array([[3.0, -np.pi / 2, np.pi, 10.0, 20.0, 20.0, 50.0], [9.0, 0.0, 0.0, 10.0, 0.0, 0.0, 50.0]])
    choice = np.array([0.0, 0.0, 0.0, 8, 0, 1, 0.9, 0.3, 0.0])
    tables = Sights(
        choice, np.array([[1, 0, 0, 2], [0, 1, 7, 2]], np.int32), np.array([[0, 0], [0, 2]], np.int32), row,
        np.array([[0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0]]), np.array([[1.0, 2.0, 2.0, 1.0]]),
        np.array([*np.zeros(6), 0.5]),
    )  # fmt: skip
    place, likeliest, after = follow(tables, some)
    near, far = 0.1 + 0.9 * 50 / 2, 0.7
    assert place[0, 0] == pytest.approx(np.log((near + far) / 2))
    assert place[0, 2] == pytest.approx(4 * far / (near + far))
    assert likeliest[0, 0] == 0
    assert likeliest[0, 1] == pytest.approx(0.9 * 25 / (near + far))
    assert likeliest[0, 2] == pytest.approx((3 * near + 5 * far) / (near + far))
    assert (after[:, 1] == 0).all()  # at 0.25 and 0.75 of weights of 0.97 and 0.03
