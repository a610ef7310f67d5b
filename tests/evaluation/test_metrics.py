"""Scores: each against a second way of computing it, or a case that can be done by hand."""

import tracemalloc
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from wall_samples import paths, walls

from gridslam.errors import InputError
from gridslam.evaluation import metrics
from gridslam.maps.map import Map
from gridslam.world.geometry import Segments
from gridslam.world.trajectory import Trajectory

micrometres = st.integers(-8_000_000, 8_000_000).map(
    lambda n: n / 1e6
)  # so that no square underflows to zero
points = st.integers(0, 4).flatmap(lambda n: arrays(float, (n, 2), elements=micrometres))


def track(time, position, heading=None):
    position = np.asarray(position, float)
    heading = np.zeros(len(position)) if heading is None else np.asarray(heading, float)
    return Trajectory(np.asarray(time, float), position, np.zeros_like(position), heading)


def brute_ospa(a, b, cutoff, order):
    a, b = sorted((list(a), list(b)), key=len)
    if not b:
        return 0.0
    best = min(
        sum(min(np.linalg.norm(x - y), cutoff) ** order for x, y in zip(a, chosen, strict=True))
        for chosen in permutations(b, len(a))
    )
    return ((best + cutoff**order * (len(b) - len(a))) / len(b)) ** (1 / order)


@given(a=points, b=points, order=st.sampled_from([1.0, 2.0]))
@settings(max_examples=40, deadline=None)
def test_ospa_finds_the_best_of_all_assignments(a, b, order):
    assert metrics.ospa(a, b, 5.0, order) == pytest.approx(brute_ospa(a, b, 5.0, order), abs=1e-9)


@given(a=points, b=points, c=points, order=st.sampled_from([1.0, 2.0]))
@settings(max_examples=60, deadline=None)
def test_ospa_and_gospa_are_metrics(a, b, c, order):
    for distance, cutoff in ((metrics.ospa, 5.0), (metrics.gospa, 2.0)):
        ab, bc, ac = (distance(x, y, cutoff, order) for x, y in ((a, b), (b, c), (a, c)))
        assert ab == pytest.approx(distance(b, a, cutoff, order))
        assert ac <= ab + bc + 1e-9
        assert distance(a, a[::-1], cutoff, order) == 0
        assert (ab > 0) == (sorted(a.tolist()) != sorted(b.tolist()))


def test_ospa_charges_a_missing_point_the_cutoff_and_gospa_half():
    one, two = [[0.0, 0.0]], [[0.0, 0.0], [9.0, 9.0]]
    assert metrics.ospa(one, two) == pytest.approx(2.5)
    assert metrics.ospa(np.zeros((0, 2)), one) == 5.0
    assert metrics.ospa([], []) == 0.0
    assert metrics.gospa(one, two) == pytest.approx(1.0)
    assert metrics.gospa([[3.0, 0.0]], one) == pytest.approx(2.0)


def test_heading_error_is_wrapped_and_truth_interpolated():
    truth = track([0, 2, 4], [[0, 0], [2, 0], [4, 0]], [3.0, -3.0, -3.0])
    turn = 2 * np.pi - 6
    estimate = track([1, 2, 3], [[1, 1], [2, 0], [3, -1]], [np.pi, np.pi, -3.0])
    position, heading = metrics.track_errors(estimate, truth)
    np.testing.assert_allclose(position, [[0, 1], [0, 0], [0, -1]], atol=1e-12)
    np.testing.assert_allclose(heading, [np.pi - 3 - turn / 2, 3 - np.pi, 0], atol=1e-12)
    assert metrics.rmse(position) == pytest.approx(np.sqrt(2 / 3))


def test_truth_that_ends_early_is_refused_instead_of_held():
    truth = track([0, 1], np.zeros((2, 2)))
    with pytest.raises(InputError, match="truth"):
        metrics.track_errors(track([0, 1, 2], np.zeros((3, 2))), truth)


def test_divergence_counts_only_after_step_ten_and_above_half_a_metre():
    error = np.zeros((20, 2))
    error[10] = [9, 9]
    error[15] = [0.5, 0]
    assert not metrics.diverged(error)
    error[11] = [0.4, 0.4]
    assert metrics.diverged(error)
    assert not metrics.diverged(error[:5])


def test_p95_is_taken_over_lengths():
    error = np.stack([np.arange(101.0) * 0.6, np.arange(101.0) * -0.8], -1)
    assert metrics.p95(error) == pytest.approx(95)


@given(
    legs=arrays(float, (3, 2, 2), elements=st.floats(-1.3, 2.3, allow_subnormal=False)),
    horizontal=st.booleans(),
)
@settings(max_examples=40, deadline=None)
def test_leg_misses_no_cell_that_dense_sampling_finds(legs, horizontal):
    if horizontal:
        legs[0, 1, 1] = legs[0, 0, 1]
    grid = Map.blank((-1, -0.5), 0.25, (8, 10), 0.01)
    crossed = metrics.crossed_cells(grid, legs[:, 0], legs[:, 1])
    share = np.linspace(0, 1, 4001)[:, None, None]
    dense = legs[:, 0] + share * (legs[:, 1] - legs[:, 0])
    cell, inside = grid.index(dense)
    sampled = np.zeros(grid.shape, bool)
    sampled[tuple(cell[inside].T)] = True
    inner = np.abs((dense - grid.origin_m) / grid.cell_m % 1 - 0.5) < 0.499  # not on a grid line
    clear = np.zeros(grid.shape, bool)
    clear[tuple(cell[inside & inner.all(-1)].T)] = True
    assert crossed[clear].all()
    grown = metrics._grown(sampled)
    assert grown[crossed].all()
    assert crossed.sum() <= sampled.sum() + 12


@given(
    positive=arrays(float, st.integers(1, 8), elements=st.sampled_from([0.0, 0.3, 0.5, 1.0])),
    negative=arrays(float, st.integers(1, 8), elements=st.sampled_from([0.0, 0.3, 0.5, 1.0])),
)
@settings(max_examples=40, deadline=None)
def test_auc_counts_pairs_and_half_of_the_ties(positive, negative):
    pairs = positive[:, None] - negative[None]
    assert metrics.area_under_curve(positive, negative) == pytest.approx(
        (pairs > 0).mean() + (pairs == 0).mean() / 2
    )
    assert metrics.area_under_curve(positive, []) is None


def room():
    """Ten by ten cells of 1 m, a wall along y = 8.5, hit 10 times at x = 4.5 and 9 times at x = 1.5."""
    segments = walls(([0, 8.5], [10, 8.5], 0.7, 0))
    often = ([[2.5, 2.5], [4.5, 8.5], [6.5, 2.5]], [0, -1])
    seldom = ([[2.5, 2.5], [1.5, 8.5], [0.5, 2.5]], [0, -1])
    routes = paths(*[often] * 10, *[seldom] * 9)
    return Map.blank((0, 0), 1.0, (10, 10), 0.1), segments, routes


def marked(grid, occupied=(), free=()):
    evidence, observed = np.zeros(grid.shape), np.zeros(grid.shape, bool)
    for cells, value in ((occupied, 9.0), (free, -9.0)):
        for row, column in cells:
            evidence[row, column], observed[row, column] = value, True
    return replace(grid, evidence=evidence, observed=observed)


def test_wall_found_one_cell_off_counts_and_two_cells_off_does_not():
    grid, segments, routes = room()
    assert metrics.map_scores(marked(grid, occupied=[(8, 4)]), segments, routes)["occupied_recall"] == 1
    assert metrics.map_scores(marked(grid, occupied=[(7, 5)]), segments, routes)["occupied_recall"] == 1
    assert metrics.map_scores(marked(grid, occupied=[(6, 4)]), segments, routes)["occupied_recall"] == 0
    assert metrics.map_scores(marked(grid, occupied=[(8, 1)]), segments, routes)["occupied_recall"] == 0


def test_precision_looks_at_true_walls_not_at_hits():
    grid, segments, routes = room()
    scores = metrics.map_scores(marked(grid, occupied=[(8, 9), (6, 9), (5, 9), (2, 2)]), segments, routes)
    assert scores["occupied_precision"] == pytest.approx(0.5)


def test_free_space_scores_ignore_cells_next_to_walls():
    grid, segments, routes = room()
    start, end, _ = routes.legs
    crossed = metrics.crossed_cells(grid, start, end)
    crossed[7:] = False  # the centre of row 7 is 1 m from the wall
    cells = [tuple(cell) for cell in np.argwhere(crossed)]
    scores = metrics.map_scores(marked(grid, free=[*cells[1:], (8, 0)]), segments, routes)
    assert scores["free_recall"] == pytest.approx(1 - 1 / len(cells))
    assert scores["free_precision"] == pytest.approx(1 - 1 / len(cells))
    assert scores["occupied_precision"] is None


def test_auc_ranks_unobserved_cells_at_the_prior():
    grid, segments, routes = room()
    assert metrics.map_scores(grid, segments, routes)["auc"] == 0.5
    assert metrics.map_scores(marked(grid, occupied=[(8, 4)]), segments, routes)["auc"] == 1
    assert metrics.map_scores(marked(grid, free=[(8, 4)]), segments, routes)["auc"] == 0


def test_scores_of_a_world_without_walls_are_null_not_an_error():
    grid, _, _ = room()
    whole = np.zeros(0, int)
    none = Segments(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), whole, whole, whole)
    sight = paths(([[2.5, 2.5], [6.5, 2.5]], [-1, -1]))
    scores = metrics.map_scores(marked(grid, free=[(2, 4)]), none, sight)
    assert scores["occupied_recall"] is None
    assert scores["free_precision"] == 1
    assert scores["free_recall"] == pytest.approx(1 / 5)
    assert metrics.reflection_mae(grid, none) is None


def test_reflection_is_compared_with_the_nearest_piece_of_wall():
    grid = marked(Map.blank((0, 0), 1.0, (10, 10), 0.1), occupied=[(8, 1), (8, 8), (2, 2)])
    cube = np.zeros(grid.coefficient.shape)
    cube[8, 1, 13] = cube[8, 8, 7] = cube[2, 2, 0] = 50.0  # 0.675, 0.375; the third is far from any wall
    grid = replace(grid, coefficient=cube)
    segments = walls(([0, 8.5], [5, 8.5], 0.7, 0), ([5, 8.5], [10, 8.5], 0.3, 0))
    assert metrics.reflection_mae(grid, segments) == pytest.approx((0.025 + 0.075) / 2, rel=1e-5)


def test_scores_are_the_same_however_few_cells_and_legs_are_taken_at_once(monkeypatch):
    grid, segments, routes = room()
    grid = marked(grid, occupied=[(8, 9), (6, 9), (8, 4)], free=[(2, 4), (8, 0), (3, 3)])
    whole = metrics.map_scores(grid, segments, routes)
    monkeypatch.setattr(metrics, "CUTS_AT_ONCE", 1)
    monkeypatch.setattr(metrics, "CELLS_AT_ONCE", 1)
    assert metrics.map_scores(grid, segments, routes) == whole


@pytest.mark.slow
def test_scores_take_little_beside_the_map_itself():
    rng, shape = np.random.default_rng(1), (1000, 1000)
    seen = rng.random(shape) < 0.5
    grid = replace(Map.blank((0, 0), 0.1, shape, 0.1), evidence=rng.normal(-1, 3, shape), observed=seen)
    segments = walls(*(([20.0 * k, 1.0], [20.0 * k + 9, 99.0], 0.7, k) for k in range(5)))
    corners = [*rng.uniform(0, 100, (150, 3, 2)).tolist(), *[[[1.0, 2.0], [30.0, 99.0], [70.0, 3.0]]] * 10]
    routes = paths(*((bends, [0, -1]) for bends in corners))
    tracemalloc.start()
    try:
        scores = metrics.map_scores(grid, segments, routes)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert None not in scores.values()
    assert peak / grid.observed.size < 30, "bytes a cell; the map has 85"


def test_times_that_count_from_1970_are_told_so_that_they_differ():
    heard, late = (track(1.7e9 + np.array(s), np.zeros((2, 2))) for s in ((0, 0.5), (0.25, 8)))
    with pytest.raises(
        InputError, match=r"1700000000.25 to 1700000008 s; .*least 1700000000 to 1700000000.5 s"
    ):
        metrics.track_errors(heard, late)
