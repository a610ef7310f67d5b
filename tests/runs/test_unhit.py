"""Stretches of walls off which nothing was heard, of methods without cells."""

from types import SimpleNamespace

import numpy as np

from gridslam.estimate_tables import PathEstimate, SurfaceEstimate
from gridslam.runs.unhit import unhit, unhit_words

WALL = 7


def wall(extent):
    """The line y = 2, whose tangent is (-1, 0)."""
    flat = np.zeros((1, 2, 2))
    line, one = np.array([[np.pi / 2, 2.0]]), np.ones(1)
    return SurfaceEstimate.from_lines(
        line, flat, one, one, one, extent_m=np.array([extent]), identity=np.array([WALL])
    )


def step(places, existence=1.0, double=False):
    """Paths that bounce off the wall at x = `places`; double ones there last, and off another wall first."""
    count = len(places)
    none, there = np.full((count, 2), np.nan), np.column_stack([places, np.full(count, 2.0)])
    other = np.zeros((count, 2))
    bounces = [other, there] if double else [there, none]
    points = np.stack([np.zeros((count, 2)), *bounces, np.ones((count, 2))], axis=1)
    pair = np.tile([WALL, 9] if double else [WALL, WALL], (count, 1))
    one = np.ones(count)
    paths = PathEstimate(np.zeros(count, int), pair, one, one, one, one, existence * one, points)
    return SimpleNamespace(paths=paths)


def test_what_lies_between_hits_is_found_whichever_bounce_hit():
    left, right = np.arange(0, 3, 0.1), np.arange(4, 5.01, 0.1)
    found = unhit([step(left), step(right, double=True)], wall([-5.0, 0.0]))
    np.testing.assert_allclose(found, [[[4.0, 2.0], [2.9, 2.0]]])
    (rest,) = unhit([step(left), step(right), step([3.4])], wall([-5.0, 0.0]))
    np.testing.assert_allclose(rest, [[4.0, 2.0], [3.4, 2.0]])


def test_paths_that_are_hardly_believed_in_hit_nothing():
    everywhere, sure = step(np.arange(0, 5.01, 0.1), 0.6), step([0.0, 1.0])
    assert len(unhit([everywhere, sure], wall([-5.0, 0.0]))) == 2
    np.testing.assert_allclose(unhit([everywhere], wall([-5.0, 0.0])), [[[5.0, 2.0], [0.0, 2.0]]], atol=1e-9)


def test_short_gaps_and_walls_never_hit_are_none():
    assert len(unhit([step(np.arange(0, 5.01, 0.4))], wall([-5.0, 0.0]))) == 0
    assert len(unhit([step([1.0])], wall([np.nan, np.nan]))) == 0
    assert len(unhit([], wall([0.0, 0.3]))) == 0


def test_the_longest_are_told_with_their_sum():
    ends = np.array([[[0.0, x], [1.0 / x, x]] for x in range(1, 7)])
    said = unhit_words(ends)
    assert said.startswith(
        ". Nothing was heard off 2.4 m in between: from (0.0, 1.0) to (1.0, 1.0), from (0.0, 2"
    )
    assert said.endswith(" and 2 more")
    assert unhit_words(ends[:0]) == ""
