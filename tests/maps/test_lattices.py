"""Maps on grids of any cell and origin: which cells are taken over, in hand-over and in fusion."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from map_samples import assert_same, random_map

from gridslam.maps.fusion import fuse
from gridslam.maps.map import Map

CELLS = st.floats(0.03, 0.4)
SHIFTS = st.tuples(*[st.floats(-0.35, 0.35)] * 2)
ORIGIN = np.array([-0.3, 1.7])


def covering(cell, shift):
    """Origin, cell and shape of a grid that covers `random_map` and more, shifted by less than a cell."""
    origin = ORIGIN - 2 * max(cell, 0.1) + np.array(shift) * cell
    return (
        origin,
        cell,
        tuple(int(n) for n in np.ceil(np.array([0.4, 0.5]) / cell + 2 * max(1, 0.1 / cell) + 3)),
    )


def centres(origin, cell, shape):
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return np.asarray(origin) + (np.stack([columns, rows], -1) + 0.5) * cell


@given(seed=st.integers(0, 10**6), cell=CELLS, shift=SHIFTS)
@settings(max_examples=60, deadline=None)
def test_a_map_is_the_same_there_and_back_over_finer_or_equal_cells(seed, cell, shift):
    grid = random_map(seed)
    cell = min(cell, grid.cell_m)
    back = grid.resample(*covering(cell, shift)).resample(grid.origin_m, grid.cell_m, grid.shape)
    for name in ("evidence", "coefficient", "observed"):
        np.testing.assert_array_equal(getattr(back, name), getattr(grid, name))
    assert back.prior == pytest.approx(grid.prior, rel=1e-9)
    assert_same(grid.resample(grid.origin_m, grid.cell_m, grid.shape), grid)


@given(seed=st.integers(0, 10**6), half=st.tuples(*[st.integers(-5, 5)] * 2), noise=st.floats(-1e-12, 1e-12))
@settings(max_examples=30, deadline=None)
def test_half_a_cell_there_and_back_is_no_step(seed, half, noise):
    grid = random_map(seed)
    origin = grid.origin_m - 0.3 + 0.05 * np.array(half) + noise
    back = grid.resample(origin, grid.cell_m, (11, 12)).resample(grid.origin_m, grid.cell_m, grid.shape)
    np.testing.assert_array_equal(back.evidence, grid.evidence)


@given(seed=st.integers(0, 10**6), cell=CELLS, shift=SHIFTS, level=st.floats(-8, 8, width=32))
@settings(max_examples=60, deadline=None)
def test_constant_evidence_stays_and_nothing_is_observed_beyond_the_source(seed, cell, shift, level):
    grid = random_map(seed)
    flat = replace(grid, evidence=np.where(grid.observed, np.float32(level), 0))
    new = flat.resample(*covering(cell, shift))
    assert (new.evidence == np.where(new.observed, np.float32(level), 0)).all()
    assert new.mean_free_path_m == pytest.approx(grid.mean_free_path_m)
    # whatever is observed has an observed cell within half of the larger cell
    far = np.abs(
        centres(*covering(cell, shift))[:, :, None] - centres(ORIGIN, 0.1, grid.shape)[grid.observed]
    )
    near = (far.max(axis=-1) <= 0.5 * max(cell, 0.1) + 1e-6).any(axis=-1)
    np.testing.assert_array_equal(new.observed & ~near, False)


@given(seed=st.integers(0, 10**6), cell=CELLS, shift=SHIFTS)
@settings(max_examples=60, deadline=None)
def test_no_occupied_cell_is_lost_and_none_is_invented(seed, cell, shift):
    grid = random_map(seed)
    new = grid.resample(*covering(cell, shift))
    assert new.observed.any() == grid.observed.any()
    assert set(new.evidence[new.observed]) <= set(grid.evidence[grid.observed])
    places = centres(ORIGIN, 0.1, grid.shape)[grid.occupied]
    if cell >= 0.1:
        row, column = np.moveaxis(new.index(places + 1e-9)[0], -1, 0)
        assert (new.evidence[row, column] >= grid.evidence[grid.occupied]).all()


def test_a_wall_of_one_cell_stays_one_cell_thick_where_grids_are_shifted():
    evidence = np.full((3, 8), -4.0)
    evidence[:, 4] = 5.0
    wall = replace(Map.blank((0, 0), 0.1, (3, 8), 0.01), evidence=evidence, observed=np.ones((3, 8)))
    for shift in (0.03, 0.05, 0.08):
        new = wall.resample((-0.2 + shift, 0), 0.1, (3, 12))
        assert (new.occupied.sum(axis=1) == 1).all()
    coarse = wall.resample((0, 0), 0.23, (1, 3))
    np.testing.assert_array_equal(coarse.occupied, [[False, True, False]])


@pytest.mark.parametrize(("cell", "origin"), [(0.1, (0.05, 0.0)), (0.23, (-0.31, 0.02)), (0.15, (0.0, 0.07))])
def test_maps_on_other_lattices_fuse_and_those_of_the_finest_cells_stay(cell, origin):
    fine = random_map(1, (6, 7), 0.1, (0.0, 0.0))
    other = random_map(2, (4, 5), cell, origin, prior=-np.expm1(cell / 0.1 * np.log1p(-0.01)))
    fused = fuse([other, fine], same_frame=True)
    assert_same(fused, fuse([fine, other], same_frame=True))
    assert fused.cell_m == 0.1
    low, high = np.minimum(fine.origin_m, other.origin_m), np.maximum(fine.corner_m, other.corner_m)
    assert (fused.origin_m <= low + 1e-9).all()
    assert (fused.corner_m >= high - 1e-9).all()
    carried = [grid.resample(fused.origin_m, 0.1, fused.shape) for grid in (fine, other)]
    np.testing.assert_allclose(fused.evidence, carried[0].evidence + carried[1].evidence, rtol=1e-6)
    back = carried[0].resample(fine.origin_m, 0.1, fine.shape)
    np.testing.assert_array_equal(back.evidence, fine.evidence)
    kept = carried[1].resample(other.origin_m, other.cell_m, other.shape)
    np.testing.assert_array_equal(kept.evidence, other.evidence)
