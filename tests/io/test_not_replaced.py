"""What is written by a name takes the place of its own kind, and of no other file."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from map_samples import surfaces
from tables import table
from tiny import TINY

import gridslam as gs
from gridslam.errors import InputError
from gridslam.importers.geojson import write_surfaces
from gridslam.maps.map import Map
from gridslam.measurements.table import Measurements
from gridslam.world.trajectory import Trajectory

GRID = Map.blank((0, 0), 0.5, (6, 6), 0.5)
HEARD = Measurements(**table(8))
TRACK = Trajectory([0.5], [[1.0, -2.0]], [[0, 0]], [0.5])
FOREIGN = {
    "a table": b"t,x,y\n0,1,2\n",
    "a nav2 map": b"image: map.pgm\nmode: trinary\nresolution: 0.05\norigin: [-1, -2, 0]\nnegate: 0\n"
    b"occupied_thresh: 0.65\nfree_thresh: 0.196\n",
    "GeoJSON": json.dumps({"type": "FeatureCollection", "features": []}).encode(),
}
WRITERS = {
    "map.h5": GRID.save,
    "heard.h5": HEARD.to_h5,
    "heard.csv": HEARD.to_csv,
    "way.tum": TRACK.to_tum,
    "walls.geojson": lambda path: write_surfaces(path, surfaces([(0.5, 6.0)])),
}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("what", FOREIGN)
def test_files_of_others_stay(tmp_path, name, what):
    path = tmp_path / name
    path.write_bytes(FOREIGN[what])
    with pytest.raises(
        InputError, match=re.escape(f"{path}: found ") + ".*not replaced; allowed: a new name"
    ):
        WRITERS[name](path)
    assert path.read_bytes() == FOREIGN[what]
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", WRITERS)
def test_what_was_written_before_and_empty_files_are_replaced(tmp_path, name):
    path = tmp_path / name
    path.touch()
    WRITERS[name](path)
    before = path.read_bytes()
    assert before
    WRITERS[name](path)
    assert path.read_bytes() == before


def test_hdf5_of_other_kinds_stays(tmp_path):
    HEARD.to_h5(tmp_path / "heard.h5")
    GRID.save(tmp_path / "map.h5")
    with h5py.File(tmp_path / "lab.h5", "w") as file:
        file["x"] = np.arange(3)
    for name, write, found in (
        ("heard.h5", GRID.save, "gridslam-measurements"),
        ("map.h5", HEARD.to_h5, "gridslam-map"),
        ("lab.h5", GRID.save, "HDF5 of another program"),
    ):
        before = (tmp_path / name).read_bytes()
        with pytest.raises(InputError, match=f"{name}: found {found}, which is not replaced"):
            write(tmp_path / name)
        assert (tmp_path / name).read_bytes() == before


def test_a_checkpoint_is_no_map(tmp_path):
    scene = gs.Scene.from_toml(TINY, "tiny")
    gs.AdaptiveSlam(scene).save(tmp_path / "slam.h5")
    gs.AdaptiveSlam(scene, seed=1).save(tmp_path / "slam.h5")
    with pytest.raises(InputError, match=r"slam.h5: found gridslam-checkpoint"):
        GRID.save(tmp_path / "slam.h5")


@pytest.mark.parametrize("name", ["map.yaml", "map.pgm", "reflection.pgm"])
def test_nav2_maps_of_other_programs_stay_and_nothing_is_written_beside_them(tmp_path, name):
    (tmp_path / name).write_bytes(FOREIGN["a nav2 map"])
    with pytest.raises(InputError, match=rf"{name}: found another file of this name, which is not replaced"):
        GRID.to_nav2(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_own_nav2_maps_and_tables_are_replaced_and_other_tables_stay(tmp_path):
    for _ in range(2):
        GRID.to_nav2(tmp_path)
        GRID.to_csv(tmp_path)
    cells = Path(tmp_path / "cells.csv")
    cells.write_text("a,b\n")
    with pytest.raises(InputError, match=r"cells.csv: found another file of this name"):
        GRID.to_csv(tmp_path)
    assert cells.read_text() == "a,b\n"


def test_own_files_that_an_editor_or_a_spreadsheet_wrote_back_are_replaced(tmp_path):
    HEARD.to_csv(tmp_path / "heard.csv")
    TRACK.to_tum(tmp_path / "way.tum")
    own, way = (tmp_path / "heard.csv").read_text(), (tmp_path / "way.tum").read_text()
    for changed in ("\ufeff" + own, own.replace(",", ";"), own.replace("step", '"step"', 1)):
        (tmp_path / "heard.csv").write_text(changed, encoding="utf-8")
        HEARD.to_csv(tmp_path / "heard.csv")
    (tmp_path / "way.tum").write_bytes(way.replace("\n", "\r\n").encode())
    TRACK.to_tum(tmp_path / "way.tum")
    assert (tmp_path / "way.tum").read_text() == way


def test_a_nav2_map_that_was_cut_short_is_written_again(tmp_path):
    GRID.to_nav2(tmp_path)
    for name in ("map.pgm", "reflection.pgm", "reflection.yaml"):
        (tmp_path / name).unlink()
    GRID.to_nav2(tmp_path)
    assert (tmp_path / "reflection.pgm").stat().st_size > 0
