"""Ray casting and messages to cells against their plain NumPy twin, and rays that touch the grid oddly."""

import numpy as np
import pytest
from filter_states import Plot
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_worlds import BINS, SEEDS, some_rows

from gridslam import reference
from gridslam.inference.workspace.cell_buffers import SPARED_CELLS
from gridslam.kernels import ALREADY_LISTED, CELL_SLABS, STATE_GIVEN
from gridslam.kernels.primitives.blocks import Belief, Casting, Cells, Draft, Links, Listed, Query, Slabs


def launch_cast(state, path, place, worth, traversed, hit, frame, seed=0, spared=0.0):
    """Rays as drawn (K, 13), their V (K,) and the messages to the cells (ny, nx); coefficients by `seed`."""
    from gridslam.kernels.propagation.bundles import LANES, LINES, PLACES
    from gridslam.kernels.propagation.cells import cast
    from gridslam.kernels.propagation.occupancy import CELLS

    slabs = CELL_SLABS["cpu"]
    shape, rays = traversed.shape, state.shape[1]
    drawn, message = np.zeros((len(path) * rays, 14)), np.zeros((slabs, traversed.size), np.float32)
    seen = np.full((len(path), 6), np.nan)
    sums = np.zeros((3 * slabs, traversed.size), np.float32)
    touched = np.zeros((2 * slabs, traversed.size + 1), np.int32)
    news = np.zeros((slabs, -(-traversed.size // CELLS)), np.uint8)
    met = np.zeros((slabs, traversed.size), np.uint8)
    line = np.full((slabs, LINES, LANES), np.nan)
    spot = np.full((slabs, PLACES, LANES), -(2**31), np.int32)
    occupied = np.stack([traversed.ravel(), hit.ravel()]).astype(np.float32)
    factor = np.stack([worth, np.ones(len(worth))], -1)
    table = np.pad(path, ((0, 0), (0, 1)))
    draw = np.random.default_rng(seed)
    # some so sure that all else is impossible
    where, held = some_rows(draw, shape, draw.choice([0.1, 30.0]))
    surface = draw.dirichlet(np.full(BINS, 0.2), state.shape[0] // 3)
    belief, frame = np.full((len(path), 2 * BINS), np.nan), np.append(frame, [0.1, 12.0, 0.0, 0.05, spared])
    square, row, entries = np.empty((0, 0)), np.empty(0), np.empty(0, np.int64)
    single = square.astype(np.float32)
    query = Query(np.array([ALREADY_LISTED, 0, 0, 0, STATE_GIVEN, 1], np.int32), np.array([0.0, 0.0, 1.0]))
    cast(
        query, Belief(row, square), np.append(place, [0.0, 0.0])[None],
        Links(row, entries, row, square, np.empty((0, 0, 0))),
        Draft(single, square, single, single, state, np.full(1, 9, np.int32)),
        Listed(table, row, row, square, np.array([len(path)], np.int32)),
        Cells(occupied, frame, where, held, surface), Casting(factor, drawn, seen, belief),
        Slabs(line, spot, sums, touched, met, message, news),
    )  # fmt: skip
    np.testing.assert_allclose(belief.sum(1), 1, rtol=1e-9)
    np.testing.assert_allclose(
        belief, reference.coefficient_product(drawn, table, where, held, surface, frame[:3], 0.05), atol=1e-9
    )
    for array in (sums, met):
        assert not array.any(), "scratch is left as it was found"
    sent = np.pad(message != 0, ((0, 0), (0, news.shape[1] * CELLS - traversed.size)))
    assert not sent.reshape(*news.shape, CELLS)[news == 0].any(), "where there are messages is known"
    whole = drawn.reshape(len(path), rays, 14)
    possible = whole[..., 12].mean(1)
    through = (whole[..., 12] * whole[..., 13]).mean(1)
    np.testing.assert_allclose(seen[:, 0] * possible, through, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(seen[:, 1], possible, rtol=1e-12)
    np.testing.assert_allclose(seen[:, 2:], whole[..., 2:6].mean(1), rtol=1e-6, atol=1e-9)
    return drawn[:, :13], drawn[:, 13], message.sum(0).reshape(shape)


@pytest.mark.slow
@given(
    SEEDS, st.sampled_from([1, 3, 50]), st.sampled_from([0.0, 0.005, 0.1, 1.0]),
    st.sampled_from([0.0, 0.15, 0.3, 1.0]),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_ray_casting_and_cell_messages_equal_their_twin(seed, rays, spread, spared):
    draw = np.random.default_rng(seed)
    shape, surfaces = (16, 21), 3
    traversed, hit = draw.uniform(0.001, 0.5, shape), draw.uniform(0.001, 0.9, shape)
    state = np.empty((3 + 3 * surfaces, rays))
    state[:3] = draw.uniform(-1, 6, (3, 1)) + spread * draw.normal(size=(3, rays))
    angle = draw.uniform(-3, 3, (surfaces, 1)) + 0.2 * spread * draw.normal(size=(surfaces, rays))
    state[3::3], state[4::3] = np.cos(angle), np.sin(angle)
    state[5::3] = draw.uniform(-3, 6, (surfaces, 1)) + 0.5 * spread * draw.normal(size=(surfaces, rays))
    path = [[0, -1, -1]] + [[1, s, s] for s in range(surfaces)]
    path += [[2, s, r] for s in range(surfaces) for r in range(surfaces) if s != r]
    path, worth = np.array(path, np.int32), np.exp(draw.normal(0, 2, len(path)))
    frame, place = np.array([-0.3, 0.2, 0.3]), draw.uniform(0, 5, 2)
    drawn, validity, message = launch_cast(state, path, place, worth, traversed, hit, frame, seed, spared)
    expected = reference.cast(
        drawn[:, :8].reshape(-1, 4, 2), drawn[:, 8:12].reshape(-1, 2, 2), drawn[:, 12], path[:, 0], worth,
        traversed, hit, frame, rays, 0.1, 12.0, spared,
    )  # fmt: skip
    np.testing.assert_allclose(validity, expected[0], rtol=1e-5, atol=1e-9)
    # a ratio of e^7 and more is told from rounded sums that all but cancel
    clear = np.abs(expected[1]) < 7
    np.testing.assert_allclose(message[clear], expected[1][clear], rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(message[~clear], expected[1][~clear], atol=0.5)


@pytest.mark.slow
@given(SEEDS, st.booleans())
@settings(max_examples=8, deadline=None)
def test_rays_cross_the_right_cells_a_thousand_columns_on(seed, tall):
    draw, rays = np.random.default_rng(seed), 50
    shape, ends = (40, 1100), np.array([[1090.0, 20.0, 0.0]]).T + draw.normal(0, 5, (3, rays))
    start = np.array([2.5, draw.uniform(1, 39)])
    if tall:
        shape, ends, start = shape[::-1], ends[[1, 0, 2]], start[::-1]
    table = draw.choice([1e-4, 0.02], shape)
    path, frame = np.array([[0, -1, -1]], np.int32), np.array([0.0, 0.0, 1.0])
    drawn, validity, message = launch_cast(ends, path, start, np.array([0.5]), table, table, frame, seed)
    expected = reference.cast(
        drawn[:, :8].reshape(-1, 4, 2), drawn[:, 8:12].reshape(-1, 2, 2), drawn[:, 12], path[:, 0],
        np.array([0.5]), table, table, frame, rays, 0.1, 12.0,
    )  # fmt: skip
    # a ray that grazes a corner by less than rounding tells may cross one cell more or less
    np.testing.assert_allclose(validity, expected[0], rtol=0.03)
    assert np.isclose(validity, expected[0], rtol=1e-3).sum() >= rays - 1
    assert np.isclose(message, expected[1], rtol=0.03, atol=1e-9).sum() >= message.size - 3


def cast_sight(start, end, shape=(4, 4), worth=9.0):
    """V and the messages of one line of sight through cells of 1 m with o = 0.1."""
    state, path = np.array([[*end, 0.0]]).T, np.array([[0, -1, -1]], np.int32)
    table = np.full(shape, 0.1)
    return launch_cast(
        state, path, np.array(start), np.array([worth]), table, table, np.array([0.0, 0.0, 1.0])
    )[1:]


@pytest.mark.parametrize("shape", [(1, 1), (1, 65), (64, 1), (8, 8)])
@pytest.mark.parametrize("worth", [0.3, 0.51, 0.9, 1.0001, 1.4, 1.99, 2.01, 3.3])
def test_a_cell_alone_on_a_ray_is_told_its_whole_worth(shape, worth):
    """Free, it makes the path worth so much; occupied, nothing gets through."""
    message = cast_sight((0.3, 0.4), (0.6, 0.5), shape, worth)[1]
    assert message[0, 0] == pytest.approx(-np.log(worth), rel=5e-6, abs=2e-7)
    assert np.count_nonzero(message) == 1


@pytest.mark.parametrize(
    ("worth", "message"), [(np.exp(11.0), -11.0), (np.exp(13.0), -12.0), (np.exp(30.0), -12.0)]
)
def test_no_path_tells_a_cell_more_than_twelve_nats(worth, message):
    """However surely it was heard; alone, it would tell the logarithm of what it is worth."""
    assert cast_sight((0.3, 0.4), (0.6, 0.5), (1, 1), worth)[1][0, 0] == pytest.approx(message, rel=1e-5)
    assert Plot((4, 4)).cells.frame_of_messages[4] == 12.0, "as the filter asks for it"


def test_rays_that_rise_steeply_across_an_edge_cross_the_right_cells():
    """In a bundle that goes the other way, and but a millionth of a cell along it."""
    shape, rays = (40, 300), 48
    draw = np.random.default_rng(1)
    state = np.zeros((3, rays))
    state[0], state[1] = draw.uniform(10, 250, rays), draw.uniform(1, 39, rays)
    start, table = np.array([290.0 - 1e-6, 20.4]), draw.choice([1e-3, 0.02], shape)
    for n, (along, rise) in enumerate([(1.3e-6, 18.3), (1.3e-6, -18.6), (1.6e-6, 19.1), (3e-6, -15.0)]):
        state[0, n], state[1, n] = start[0] + along, start[1] + rise
    path, frame = np.array([[0, -1, -1]], np.int32), np.array([0.0, 0.0, 1.0])
    drawn, validity, message = launch_cast(state, path, start, np.array([0.5]), table, table, frame)
    expected = reference.cast(
        drawn[:, :8].reshape(-1, 4, 2), drawn[:, 8:12].reshape(-1, 2, 2), drawn[:, 12], path[:, 0],
        np.array([0.5]), table, table, frame, rays, 0.1, 12.0,
    )  # fmt: skip
    np.testing.assert_allclose(validity, expected[0], rtol=1e-4)
    np.testing.assert_allclose(message, expected[1], rtol=1e-3, atol=1e-7)


@pytest.mark.parametrize(
    ("start", "end", "cells"),
    [
        ((0.5, 0.5), (3.5, 0.5), {(0, 0), (0, 1), (0, 2), (0, 3)}),  # parallel to an axis
        ((2.5, 3.5), (2.5, 0.5), {(3, 2), (2, 2), (1, 2), (0, 2)}),
        ((1.5, 1.5), (1.5, 1.5), {(1, 1)}),  # no length
        ((-5.0, 1.5), (9.0, 1.5), {(1, 0), (1, 1), (1, 2), (1, 3)}),  # in and out of the grid
        ((-5.0, -1.5), (9.0, -1.5), set()),  # past it
    ],
)
def test_a_ray_touches_exactly_the_cells_on_its_way(start, end, cells):
    _, message = cast_sight(start, end)
    assert {tuple(int(i) for i in c) for c in np.argwhere(message != 0)} == cells


@pytest.mark.parametrize(("start", "end"), [((0.5, 0.5), (3.5, 3.5)), ((3.5, 0.5), (0.5, 3.5))])
def test_a_ray_through_corners_stays_between_the_cells_that_touch_it(start, end):
    validity, message = cast_sight(start, end)
    touched = np.argwhere(message != 0)
    assert len(touched) >= 4
    assert (np.abs(touched[:, 1] - (touched[:, 0] if start[0] < 1 else 3 - touched[:, 0])) <= 1).all()
    assert 0.9 ** len(touched) == pytest.approx(validity[0], rel=1e-5)


@pytest.mark.parametrize(("spared", "beside"), [(0.0, {3, 4, 6, 7}), (0.4, {3, 7}), (1.0, set())])
def test_a_flat_ray_spares_the_cells_of_the_wall_that_it_meets(spared, beside):
    """From (0.5, 1.6) to (10.5, 1.6) by the wall y = 0.5, which it meets in the sixth cell."""
    table = np.full((4, 11), 0.1)
    state = np.array([10.5, 1.6, 0.0, 0.0, 1.0, 0.5]).reshape(-1, 1)
    message = launch_cast(
        state, np.array([[1, 0, 0]], np.int32), np.array([0.5, 1.6]), np.array([np.exp(3.0)]), table, table,
        np.array([0.0, 0.0, 1.0]), spared=spared,
    )[2]  # fmt: skip
    assert set(np.flatnonzero(message[0] < 0).tolist()) == beside
    assert message[0, 5] > 0


def test_a_wall_on_a_border_of_cells_keeps_the_cell_in_front():
    """From (0.5, 2.6) to (10.5, 2.6) by a wall 1 cm below y = 1: its front cells end 1.01 cells from it."""
    table = np.full((5, 11), 0.1)
    state = np.array([10.5, 2.6, 0.0, 0.0, 1.0, 0.99]).reshape(-1, 1)
    freed = []
    for spared in (1.0, SPARED_CELLS):
        message = launch_cast(
            state, np.array([[1, 0, 0]], np.int32), np.array([0.5, 2.6]), np.array([np.exp(3.0)]), table,
            table, np.array([0.0, 0.0, 1.0]), spared=spared,
        )[2]  # fmt: skip
        assert message[0, 5] > 0
        freed.append(bool((message[1] < 0).any()))
    assert freed == [True, False]


def test_no_paths_cast_nothing():
    table = np.full((3, 3), 0.1)
    _, validity, message = launch_cast(
        np.zeros((3, 2)),
        np.zeros((0, 3), np.int32),
        np.zeros(2),
        np.zeros(0),
        table,
        table,
        np.array([0.0, 0.0, 1.0]),
    )
    assert len(validity) == 0
    assert not message.any()
