"""Maps: beliefs, files, other grids."""

import subprocess
import sys
from dataclasses import replace

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from map_samples import BINS, assert_same, random_map
from nav2_maps import FREE, OCCUPIED, UNKNOWN, nav2_load

from gridslam.errors import InputError
from gridslam.maps.map import Map
from gridslam.world.radio import REFLECTION_BINS


def test_unobserved_cells_are_not_reported_as_free():
    grid = Map.blank((0, 0), 0.1, (2, 3), 0.01)
    assert np.isnan(grid.occupancy).all()
    assert not grid.free.any()
    assert not grid.occupied.any()
    assert np.isnan(grid.reflection).all()


def test_evidence_is_added_to_the_prior_in_log_odds():
    grid = replace(
        Map.blank((0, 0), 0.1, (1, 2), 0.1), evidence=[[np.log(9), np.log(27)]], observed=[[True, True]]
    )
    np.testing.assert_allclose(grid.occupancy, [[0.5, 0.75]], rtol=1e-6)
    assert grid.mean_free_path_m == pytest.approx(-0.1 / np.log(0.9))


def test_reflection_is_the_mean_of_the_posterior_not_its_peak():
    cube = np.full((1, 1, BINS), -1e4, np.float32)
    cube[0, 0, [4, 10]] = [0.0, np.log(3.0)]
    grid = replace(Map.blank((0, 0), 0.1, (1, 1), 0.1), coefficient=cube, observed=[[True]])
    low, high = REFLECTION_BINS[[4, 10]]
    mean = 0.25 * low + 0.75 * high
    assert grid.reflection[0, 0] == pytest.approx(mean)
    assert grid.reflection_std[0, 0] == pytest.approx(np.sqrt(0.1875) * (high - low))


def test_query_beyond_the_edge_is_unknown_and_rows_run_with_y():
    grid = replace(
        Map.blank((1, 2), 0.5, (2, 3), 0.1), evidence=np.arange(6).reshape(2, 3), observed=np.ones((2, 3))
    )
    occupancy, reflection = grid.query([[1.1, 2.1], [2.4, 2.9], [0.99, 2.1], [1.1, 3.0], [np.nan, 2.1]])
    np.testing.assert_array_equal(occupancy[:2], grid.occupancy[[0, 1], [0, 2]])
    assert np.isnan(occupancy[2:]).all()
    assert reflection.shape == (5,)
    assert grid.query([1.1, 2.1])[0].shape == ()


@pytest.mark.parametrize(
    "change",
    [
        {"cell_m": 0.0},
        {"cell_m": np.nan},
        {"prior": 1.0},
        {"origin_m": [np.inf, 0]},
        {"observed": np.ones((2, 2))},
        {"coefficient": np.zeros((4, 5, 3))},
        {"surface_reflection": np.ones((7, BINS))},
    ],
)
def test_contradicting_fields_are_refused(change):
    with pytest.raises(InputError, match=f"map: {next(iter(change))}"):
        replace(random_map(0), **change)


@pytest.mark.slow
@given(seed=st.integers(0, 10**6), shape=st.tuples(st.integers(1, 9), st.integers(1, 9)))
@settings(max_examples=20, deadline=None)
def test_saved_map_loads_back_equal(tmp_path_factory, seed, shape):
    grid = random_map(seed, shape)
    path = tmp_path_factory.mktemp("map") / "map.h5"
    grid.save(path)
    again = Map.load(path)
    assert_same(grid, again)
    assert again.provenance == grid.provenance
    assert sorted(p.name for p in path.parent.iterdir()) == ["map.h5"]


def test_map_without_surfaces_or_hits_loads_back(tmp_path):
    Map.blank((0, 0), 0.1, (3, 2), 0.01).save(tmp_path / "map.h5")
    assert_same(Map.load(tmp_path / "map.h5"), Map.blank((0, 0), 0.1, (3, 2), 0.01))
    assert_same(Map.load(tmp_path), Map.load(tmp_path / "map.h5"))  # the folder of a run


def test_file_follows_the_contract_and_is_the_same_each_time(tmp_path):
    grid = random_map(3)
    grid.save(tmp_path / "a.h5")
    grid.save(tmp_path / "b.h5")
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    with h5py.File(tmp_path / "a.h5") as file:
        assert (file.attrs["format"], file.attrs["version"]) == ("gridslam-map", 1)
        np.testing.assert_array_equal(file["grid"].attrs["origin_m"], grid.origin_m)
        np.testing.assert_array_equal(file["grid/occupancy"], grid.occupancy)
        for name in (
            "grid/observed",
            "grid/reflection",
            "grid/reflection_std",
            "surfaces/sfv_m",
            "surfaces/extent_m",
        ):
            assert name in file
        missing = []
        file.visititems(
            lambda name, item: (
                missing.append(name) if isinstance(item, h5py.Dataset) and "unit" not in item.attrs else None
            )
        )
        assert missing == []


def test_map_of_other_software_with_the_contract_alone_is_understood(tmp_path):
    grid = random_map(5)
    grid.save(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5", "a") as file:
        for name in ("grid/evidence", "grid/coefficient", "grid/coefficient_cell", "provenance"):
            del file[name]
        for name in ("line", "line_cov", "identity", "owner", "reflection_posterior"):
            del file[f"surfaces/{name}"]
    again = Map.load(tmp_path / "map.h5")
    np.testing.assert_allclose(again.occupancy, grid.occupancy, rtol=0, atol=2e-6)
    np.testing.assert_allclose(again.surfaces.line, grid.surfaces.line)
    np.testing.assert_allclose(again.surfaces.line_cov, grid.surfaces.line_cov, atol=1e-15)
    assert ((np.isnan(again.reflection)) == (np.isnan(grid.reflection))).all()


def test_truncated_file_is_one_clear_line(tmp_path):
    path = tmp_path / "map.h5"
    random_map(1, (30, 30)).save(path)
    content = path.read_bytes()
    for size in (0, 7, 200, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:size])
        with pytest.raises(InputError, match=r"map\.h5") as caught:
            Map.load(path)
        assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damage", "where"),
    [
        (lambda f: f.attrs.__setitem__("format", "gridslam-steps"), "format"),
        (lambda f: f.attrs.__setitem__("version", 2), "version"),
        (lambda f: f.attrs.__delitem__("version"), "version"),
        (lambda f: f.__delitem__("grid"), "grid"),
        (lambda f: f.__delitem__("grid/observed"), "observed"),
        (lambda f: f["grid"].attrs.__delitem__("cell_m"), "cell_m"),
        (lambda f: f["grid"].attrs.__setitem__("cell_m", -1.0), "cell_m"),
        (lambda f: f["grid"].attrs.__setitem__("cell_m", "wide"), "cell_m"),
        (lambda f: f["grid/coefficient_cell"].__setitem__((0, 0), 99), "coefficient_cell"),
        (lambda f: f["grid/evidence"].__setitem__((0, 0), np.nan), "grid"),
    ],
)
def test_foreign_or_contradicting_file_is_refused(tmp_path, damage, where):
    random_map(1).save(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5", "a") as file:
        damage(file)
    with pytest.raises(InputError, match=where):
        Map.load(tmp_path / "map.h5")


@pytest.mark.parametrize("name", ["observed", "evidence"])
def test_absurd_size_is_refused_before_memory_is_asked_for(tmp_path, name):
    random_map(1).save(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5", "a") as file:
        del file[f"grid/{name}"]
        kind = bool if name == "observed" else np.float32
        file["grid"].create_dataset(name, (10**7, 10**7), kind, chunks=(100, 100))
    with pytest.raises(InputError, match=name):
        Map.load(tmp_path / "map.h5")


def test_missing_file_and_unwritable_folder_are_input_errors(tmp_path):
    with pytest.raises(InputError, match="no file"):
        Map.load(tmp_path / "none.h5")
    with pytest.raises(InputError, match="No such file"):
        random_map(1).save(tmp_path / "nowhere" / "map.h5")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError):
        random_map(1).to_nav2(tmp_path / "file")


@pytest.mark.slow
def test_full_disk_leaves_the_old_file_and_no_rest(tmp_path):
    pytest.importorskip("resource")  # not on Windows
    random_map(1).save(tmp_path / "map.h5")
    before = (tmp_path / "map.h5").read_bytes()
    code = (
        "import resource, signal, sys; from gridslam import InputError, Map\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); grid = Map.load(sys.argv[1])\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n"
        "try: grid.save(sys.argv[1])\n"
        "except InputError as error: sys.exit(0 if 'too large' in str(error) else 3)"
    )
    assert subprocess.run([sys.executable, "-c", code, tmp_path / "map.h5"]).returncode == 0
    assert [p.name for p in tmp_path.iterdir()] == ["map.h5"]
    assert (tmp_path / "map.h5").read_bytes() == before


@given(
    seed=st.integers(0, 10**6),
    origin=st.tuples(*[st.floats(-1e4, 1e4, allow_subnormal=False)] * 2),
    cell=st.sampled_from([0.1, 1 / 3, 0.05, 1e-5]),
)
@settings(max_examples=20, deadline=None)
def test_nav2_reads_back_the_same_cells_and_frame(tmp_path_factory, seed, origin, cell):
    folder = tmp_path_factory.mktemp("nav2")
    grid = random_map(seed, (6, 7), cell, origin)
    grid.to_nav2(folder, raw=True)
    meta, values = nav2_load(folder, "map")
    np.testing.assert_array_equal(values == OCCUPIED, grid.occupied)
    np.testing.assert_array_equal(values == FREE, grid.free)
    np.testing.assert_array_equal(values == UNKNOWN, ~grid.observed)
    assert (meta["resolution"], meta["origin"]) == (cell, [*origin, 0.0])
    _, percent = nav2_load(folder, "reflection")
    np.testing.assert_array_equal(percent == UNKNOWN, np.isnan(grid.reflection))
    np.testing.assert_allclose(percent[percent >= 0] / 100, grid.reflection[percent >= 0], atol=0.00501)


def test_first_image_row_is_the_highest_y(tmp_path):
    grid = replace(
        Map.blank((0, 0), 0.1, (2, 2), 0.1), evidence=[[9, -9], [0, 0]], observed=[[True, True], [False] * 2]
    )
    grid.to_nav2(tmp_path)
    assert (tmp_path / "map.pgm").read_bytes() == b"P5\n2 2\n255\n" + bytes([205, 205, 0, 254])


def test_csv_lists_cell_centres_and_leaves_unknown_empty(tmp_path):
    random_map(2).to_csv(tmp_path)
    head, *rows = (tmp_path / "cells.csv").read_text().splitlines()
    assert head == "x_m,y_m,occupancy,reflection,reflection_std"
    assert len(rows) == random_map(2).observed.sum()
    assert any(row.endswith(",,") for row in rows)
    x, y, occupancy = (float(v) for v in rows[0].split(",")[:3])
    assert occupancy == pytest.approx(random_map(2).query([x, y])[0], rel=1e-6)
    assert len((tmp_path / "surfaces.csv").read_text().splitlines()) == 2


@given(
    seed=st.integers(0, 10**6),
    factor=st.integers(1, 4),
    shift=st.tuples(*[st.integers(-2, 2)] * 2),
    shape=st.tuples(*[st.integers(3, 7)] * 2),
)
@settings(max_examples=30, deadline=None)
def test_nested_finer_grid_and_back_loses_nothing(seed, factor, shift, shape):
    grid = random_map(seed)
    origin = grid.origin_m + grid.cell_m * np.array(shift)
    fine = grid.resample(origin, grid.cell_m / factor, (shape[0] * factor, shape[1] * factor))
    back = fine.resample(origin, grid.cell_m, shape)
    direct = grid.resample(origin, grid.cell_m, shape)
    for name in ("evidence", "coefficient", "observed"):
        np.testing.assert_array_equal(getattr(back, name), getattr(direct, name))
    assert back.prior == pytest.approx(grid.prior, rel=1e-12)
    assert fine.mean_free_path_m == pytest.approx(grid.mean_free_path_m)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    centres = origin + (np.stack([columns, rows], -1) + 0.5) * grid.cell_m
    np.testing.assert_array_equal(direct.query(centres)[0], grid.query(centres)[0])


def test_coarse_cell_takes_over_its_most_occupied_part():
    grid = replace(
        Map.blank((0, 0), 0.1, (2, 4), 0.01),
        evidence=[[-3, 5, -2, 0], [-1, -4, -6, 0]],
        observed=[[True, True, True, False], [True, True, True, False]],
    )
    coarse = grid.resample((0, 0), 0.2, (1, 2))
    np.testing.assert_array_equal(coarse.evidence, [[5, -2]])
    assert coarse.prior == pytest.approx(1 - 0.99**2)


@pytest.mark.parametrize(
    ("origin", "cell", "where"),
    [
        ((0, 0), -0.1, "cell_m"),
        ((50, 0), 0.1, "extent"),
        ((0.4, 0), 0.1, "extent"),
    ],
)
def test_grid_that_does_not_fit_is_refused(origin, cell, where):
    with pytest.raises(InputError, match=where):
        Map.blank((0, 0), 0.1, (4, 4), 0.01).resample(origin, cell, (4, 4))
