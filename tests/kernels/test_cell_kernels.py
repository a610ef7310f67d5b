"""Kernels that teach cells, against their twins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_worlds import (
    BINS,
    SEEDS,
    detection_table,
    random_hits,
    random_radio,
    random_world,
    some_rows,
)

from gridslam import reference
from gridslam.kernels.primitives.blocks import (
    Coefficients,
    Drawn,
    Messages,
)
from gridslam.world.radio import REFLECTION_BINS


def cast_paths(draw, rays):
    """Paths with room for two more than are listed, where they start, and polylines and visibility."""
    from gridslam.kernels.propagation.paths import polylines

    state, path, place = random_world(draw, rays, np.float64, surfaces=3)
    path = np.pad(path, ((0, 2), (0, 1)))
    drawn = np.zeros((len(path) * rays, 13))
    polylines(state, path, place[None], drawn)
    return path, place[None], Drawn(np.pad(drawn, ((0, 0), (0, 1))), draw.uniform(0.5, 1.0, (len(path), 6)))


@given(SEEDS, st.sampled_from([1, 5, 48]))
@settings(max_examples=30, deadline=None)
def test_learned_coefficients_equal_their_twin(seed, rays):
    from gridslam.kernels.propagation.coefficients import BINS as OWN
    from gridslam.kernels.propagation.coefficients import learn

    assert len(REFLECTION_BINS) == OWN == BINS, "kernels can't import it, and hold so many on the stack"
    draw = np.random.default_rng(seed)
    path, places, cast = cast_paths(draw, rays)
    room = len(path)
    spread = draw.choice([0.1, 30.0])  # some so sure that all else is impossible
    where, rows = some_rows(draw, (9, 11), spread)
    held, used = np.full((99, BINS), np.nan, np.float32), np.array([len(rows)], np.int32)
    held[: len(rows)] = rows
    surface = draw.dirichlet(np.full(BINS, 0.2), 3)
    frame = np.array([-3.0, -2.0, 0.7, 0.1, 12.0, 0.8, 0.05, 0.0])  # some hits are outside
    factor, ratios = draw.integers(0, 2, (room, 2)).astype(float), draw.uniform(0, 1, (4, room))
    ratios[2], ratios[3] = draw.choice([0.0, 0.01, 0.6, 1.2], room), 12 * ratios[3]
    pairs = np.sort(draw.integers(0, 9, room - 2))
    begin = np.concatenate([[0], pairs, [3, 7]]).astype(np.int32)
    message = np.stack([draw.choice([-1.0, 2.5, 9.0, 40.0], 9), draw.choice([1e-5, 0.3, 1.0], 9)])
    (table, step), radio, count = detection_table(), random_radio(draw), np.array([room - 2, 9], np.int32)
    messages = Messages(count, path, factor, ratios, begin, message)
    into = 7, step, draw.normal(size=13), table, radio, frame, places, cast, messages
    sights = random_hits(np.random.default_rng([seed, 1]), 3)
    own = Coefficients(surface, where, held, used, np.empty(3), np.full(3, 9, np.int32))
    expected = reference.learn(*into, own._replace(surface=surface.copy()), sights)
    known = where.copy()
    learn(*into, own, sights)
    np.testing.assert_allclose(surface, expected[0], rtol=1e-5, atol=1e-12)
    # sums of 48 rays in single precision, of which the greatest is taken off
    np.testing.assert_allclose(reference.dense(where, held), expected[1], rtol=1e-6, atol=3e-3)
    np.testing.assert_array_equal(where[known >= 0], known[known >= 0])
    fresh = np.sort(where[(where >= 0) & (known < 0)])
    np.testing.assert_array_equal(fresh, np.arange(len(rows), used[0]))
    for found, wanted in zip(sights, expected[2:], strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6)


@given(SEEDS, st.sampled_from([1, 5, 48]))
@settings(max_examples=20, deadline=None)
def test_coefficients_learned_by_given_ratios_equal_their_twin(seed, rays):
    from gridslam.kernels.propagation.coefficients import learn_ratios

    draw = np.random.default_rng(seed)
    path, places, cast = cast_paths(draw, rays)
    room = len(path)
    where, rows = some_rows(draw, (9, 11), 3.0)
    held, used = np.full((99, BINS), np.nan, np.float32), np.array([len(rows)], np.int32)
    held[: len(rows)] = rows
    factor, ratios = draw.integers(0, 2, (room, 2)).astype(float), draw.uniform(0, 1, (4, room))
    ratios[2] = draw.choice([0.0, 0.01, 0.6, 1.0], room)
    frame = np.array([-3.0, -2.0, 0.7, 0.1, 12.0, 0.8, 0.05, 0.0])
    count, pairs = np.array([room - 2, 0], np.int32), (np.zeros(room + 1, np.int32), np.zeros((2, 0)))
    messages = Messages(count, path, factor, ratios, *pairs)
    ratio = np.log(draw.uniform(0, 3, (room, 2, BINS)) * draw.choice([1e-3, 1.0, 1e9], (room, 2, 1)))
    into = 7, draw.normal(size=13), ratio, frame, places, cast, messages
    sights = random_hits(np.random.default_rng([seed, 1]), 3)
    surface = draw.dirichlet(np.full(BINS, 0.2), 3)
    own = Coefficients(surface, where, held, used, np.empty(3), np.full(3, 9, np.int32))
    expected = reference.learn_ratios(*into, own._replace(surface=surface.copy()), sights)
    learn_ratios(*into, own, sights)
    np.testing.assert_allclose(surface, expected[0], rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(reference.dense(where, held), expected[1], rtol=1e-6, atol=1e-3)
    for found, wanted in zip(sights, expected[2:], strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6)


@given(SEEDS, st.integers(1, 300), st.integers(0, 3))
@settings(max_examples=30, deadline=None)
def test_absorbed_messages_equal_their_twin(seed, count, slabs):
    from gridslam.kernels.propagation.occupancy import CELLS, fold_messages

    draw, groups = np.random.default_rng(seed), -(-count // CELLS)
    message, before = np.zeros((slabs, count), np.float32), draw.normal(0, 8, count)
    clear, observed = (draw.random((2, count)) < 0.2).astype(np.uint8)
    occupied, news = np.full((2, count), np.nan, np.float32), np.zeros((slabs, groups), np.uint8)
    for every in (1, 0, 0):
        news[...] = draw.random(news.shape) < 0.5
        there = (np.repeat(news, CELLS, 1)[:, :count] > 0) & (draw.random(message.shape) < 0.5)
        message[there] = draw.normal(0, 3, there.sum())
        evidence = np.full(count, np.nan)
        expected = reference.fold_messages(message, before, clear, -2.0, 12.0, observed)
        fold_messages(message, news, before, clear, every, -2.0, 12.0, evidence, observed, occupied)
        np.testing.assert_allclose(evidence, expected[0], rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(observed, expected[1])
        np.testing.assert_allclose(occupied, expected[2], rtol=1e-4)
        assert not message.any()
        assert not news.any()
        before = evidence


def test_cells_that_nothing_is_told_keep_their_occupancy():
    from gridslam.kernels.propagation.occupancy import CELLS, fold_messages

    message, before = np.zeros((2, 3 * CELLS), np.float32), np.full(3 * CELLS, 20.0)
    news, occupied = np.array([[0, 1, 0], [0, 0, 0]], np.uint8), np.full((2, 3 * CELLS), 0.25, np.float32)
    observed, evidence = np.zeros(3 * CELLS, np.uint8), np.empty(3 * CELLS)
    fold_messages(message, news, before, np.zeros_like(observed), 0, -2.0, 12.0, evidence, observed, occupied)
    messaged = np.repeat([False, True, False], CELLS)
    assert (occupied[:, ~messaged] == 0.25).all()
    assert (occupied[:, messaged] > 0.9).all()
    np.testing.assert_array_equal(evidence, np.where(messaged, 12.0, 20.0))
