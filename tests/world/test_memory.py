"""Memory that cells take, counted as it is asked for."""

import tracemalloc

import numpy as np
import pytest
from filter_states import Plot

import gridslam as gs
from gridslam.inference.workspace.cell_buffers import CLEAR_ANCHOR_CELLS
from gridslam.world import grid_memory

SHAPE, SIDE = (500, 400), 0.1


@pytest.fixture(scope="module")
def crowd():
    """50 anchors, some of them at the edge or outside."""
    return np.random.default_rng(1).uniform(-1.0, 45.0, (50, 2))


def test_four_million_cells_with_fifty_anchors_fit_into_two_gigabytes(crowd):
    Plot((8, 8), side=SIDE, anchors=crowd).fold_messages()  # whatever is made once
    tracemalloc.start()
    try:
        plot = Plot(SHAPE, side=SIDE, anchors=crowd)
        plot.fold_messages()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    each = peak / np.prod(SHAPE)
    assert each < 1.02 * grid_memory.CELL_BYTES, "what scenes are checked by is what is taken"
    assert each * 4_000_000 < 1e9


def test_cells_next_to_an_anchor_are_those_within_reach_of_the_nearest(crowd):
    plot = Plot((60, 70), side=SIDE, anchors=crowd / 6, origin=(-0.3, 0.2))
    y, x = np.indices((60, 70))
    centre = np.array([-0.3, 0.2]) + SIDE * (np.stack([x, y], -1) + 0.5)
    gap = np.linalg.norm(centre[:, :, None] - crowd / 6, axis=-1).min(-1)
    np.testing.assert_array_equal(plot.cells.clear.reshape(60, 70), gap < CLEAR_ANCHOR_CELLS * SIDE)


def test_slabs_are_fewer_where_each_is_large():
    assert grid_memory.slabs_for(64, 160_000) == 64
    assert grid_memory.slabs_for(64, 4_000_000) == 5  # 500 MB / (25 B x 4 M)
    assert grid_memory.slabs_for(64, 10**8) == grid_memory.slabs_for(4, 10) == 4


def test_a_grid_that_memory_has_no_room_for_is_refused_in_one_line():
    grid_memory.check_room(1000, 1000 * grid_memory.CELL_BYTES)
    with pytest.raises(
        gs.InputError, match=r"need 0\.82 GB, and 0\.5 GB free; allowed: a larger grid.cell_m"
    ):
        grid_memory.check_room(4_000_000, 500_000_000)
    room = gs.Scene.load("room").model_dump(exclude_none=True)
    whole = {"x_m": [-250.0, 250.0], "y_m": [-250.0, 250.0], "cell_m": 0.1}
    with pytest.raises(
        gs.InputError, match=r"2\.5e\+07 cells, which need 5\.2 GB.*at most 2 GB: a larger"
    ) as refused:
        gs.Scene.checked({**room, "grid": whole}, "vast")
    assert "\n" not in str(refused.value)
