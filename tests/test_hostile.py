"""Hostile files of every format: refused in one line or read, never a traceback, never without end.

`describe` reads a table twice, unchecked and through `Measurements`.
"""

import json

import h5py
import numpy as np
import pytest
from described_files import FILES, LAYOUTS, write_all
from hostile import CASES, FEWER, FEWEST, damaged, harmless, retold
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.io import savemat
from tables import table

from gridslam.checks.verdicts.diagnose import describe
from gridslam.errors import InputError
from gridslam.importers import geojson
from gridslam.importers.floorplans import plan_of
from gridslam.io.hdf5_guard import seal
from gridslam.measurements.hdf5_table import KIND
from gridslam.measurements.table import Measurements
from gridslam.world.scene import Scene
from gridslam.world.scene_files import BUNDLED

VECTORS = {name: np.asarray(values) for name, values in table(8).items() if name != "anchors"}
ROWS = ["step,time_s,anchor,distance_m,aod_rad,aoa_rad,amplitude"]
ROWS += [f"{k},{0.5 * k},{'AB'[k % 2]},{1 + k / 8},{k / 4 - 1},{1 - k / 4},{2 + k}" for k in range(8)]
TABLE = "\n".join(ROWS) + "\n"
SCENE = (BUNDLED / "room.toml").read_text(encoding="utf-8")
PLAN = json.dumps(
    {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "geometry": {"type": "Polygon", "coordinates": [[[0, 0], [8, 0], [8, 6], [0, 0]]]},
                "properties": {"material": "brick", "reflection": 0.4},
            },
            {"type": "Feature", "geometry": {"type": "LineString", "coordinates": [[1, 1], [2.5, 1]]}},
        ],
    }
)
DRAWN = """0 SECTION 2 HEADER 9 $ACADVER 1 AC1009 9 $INSUNITS 70 6 0 ENDSEC 0 SECTION 2 BLOCKS 0 BLOCK 8 0 2 B
70 0 10 0.0 20 0.0 30 0.0 3 B 0 LINE 8 0 10 0.0 20 0.0 11 1.0 21 0.0 0 ENDBLK 8 0 0 ENDSEC 0 SECTION 2
ENTITIES 0 LINE 8 WALLS 10 0.0 20 0.0 11 8.0 21 0.0 0 ARC 8 GLASS 10 3.0 20 5.0 40 2.0 50 10.0 51 80.0
0 POLYLINE 8 WALLS 66 1 70 1 0 VERTEX 8 0 10 0.0 20 0.0 42 0.5 0 VERTEX 8 0 10 4.0 20 0.0 0 SEQEND
0 INSERT 8 WALLS 2 B 10 1.0 20 2.0 41 2.0 50 30.0 70 2 71 2 44 1.0 45 1.0 0 CIRCLE 8 X 10 1.0 20 2.0 40 0.5
0 ENDSEC 0 EOF"""
DRAWING = "\n".join(DRAWN.split()) + "\n"


@pytest.mark.slow
@CASES
@given(content=damaged(SCENE.encode()) | retold(SCENE))
@example(content=SCENE.replace("step_m = 0.05", "step_m = 1e-320").encode())
@example(content=b"a = " + b"[" * 3000)
def test_scene(tmp_path, content):
    harmless(Scene.load, tmp_path / "a.toml", content)


@pytest.mark.slow
@CASES
@pytest.mark.filterwarnings("ignore::gridslam.errors.Note")  # of columns that aren't used
@given(content=damaged(TABLE.encode()) | retold(TABLE))
def test_csv(tmp_path, content):
    harmless(describe, tmp_path / "a.csv", content)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    Measurements(**table(8)).to_h5(folder / "a.h5")
    columns = {name: values.reshape(-1, 1) for name, values in VECTORS.items()}
    savemat(folder / "5.mat", {"measurements": columns | {"anchor": columns["anchor"] + 1}})
    savemat(folder / "6.mat", columns | {"anchor": columns["anchor"] + 1}, do_compression=True)
    with h5py.File(folder / "7.mat", "w") as file:
        for name, values in columns.items():
            file[name] = (values + (name == "anchor")).T
    with h5py.File(folder / "a.h5") as new, h5py.File(folder / "old.h5", "w") as file:
        for name in ("measurements", "anchors"):
            new.copy(name, file)
        file.attrs.update(new.attrs)
    return folder


@pytest.mark.slow
@FEWER  # where the seal is gone, a case starts a process
@given(data=st.data())
def test_h5_damaged(tmp_path, good, data):
    harmless(describe, tmp_path / "a.h5", data.draw(damaged((good / "a.h5").read_bytes())))


@pytest.mark.slow
@CASES
@given(data=st.data(), name=st.sampled_from(("5.mat", "6.mat")))
def test_mat_damaged(tmp_path, good, data, name):
    harmless(describe, tmp_path / "a.mat", data.draw(damaged((good / name).read_bytes())))


@pytest.mark.slow
@FEWEST
@given(data=st.data(), name=st.sampled_from(("7.mat", "old.h5")))
def test_hdf5_of_others_damaged(tmp_path, good, data, name):
    harmless(describe, tmp_path / f"a{name[-4:]}", data.draw(damaged((good / name).read_bytes())))


ODD = {
    "text": np.array([b"x"] * 8),
    "nothing": np.zeros(0),
    "one": np.float64(1),
    "square": np.zeros((8, 8)),
    "row": np.zeros((1, 8)),
    "complex": np.zeros(8) + 1j,
    "pairs": np.zeros(8, [("a", "f8"), ("b", "i4")]),
    "large": np.full(8, 2**63, np.uint64),
    "least": np.full(8, -(2**63), np.int64),
    "nan": np.full(8, np.nan),
    "infinite": np.full(8, -np.inf),
    "falling": np.arange(8)[::-1],
    "bool": np.ones(8, bool),
    "longer": np.ones(9),
    "huge": None,
    "words": None,
    "group": None,
    "gone": None,
}


def put_odd(place, name, kind):
    """One dataset of another kind than it should be."""
    if name in place:
        del place[name]
    if kind == "huge":
        place.create_dataset(name, shape=(10**12,), dtype=float, chunks=(1024,))
    elif kind == "words":
        place.create_dataset(name, data=["A"] * 8, dtype=h5py.string_dtype())
    elif kind == "group":
        place.create_group(name)
    elif kind != "gone":
        place[name] = ODD[kind]


def sealed(path):
    """As if written here: read without another process, which takes long."""
    content = path.read_bytes()
    return content + seal(content)


@pytest.mark.slow
@FEWER
@given(swaps=st.dictionaries(st.sampled_from([*VECTORS, "aoa_std_rad"]), st.sampled_from([*ODD]), min_size=1))
def test_h5_of_other_content(tmp_path, good, swaps):
    path = tmp_path / "a.h5"
    path.write_bytes((good / "a.h5").read_bytes())
    with h5py.File(path, "r+") as file:
        for name, kind in swaps.items():
            put_odd(file["measurements"], name, kind)
    harmless(describe, path, sealed(path))


PLACES = [
    (name, f"{group.name}/{one.name}".strip("/"))
    for name, layout in LAYOUTS.items()
    for group in layout.groups
    for one in group.datasets
    if "@" not in one.name
]
"""Datasets of maps, steps, signals, clocks and measurements."""


@pytest.fixture(scope="module")
def described(tmp_path_factory):
    return write_all(tmp_path_factory.mktemp("described"))


@pytest.mark.slow
@FEWER
@given(where=st.sampled_from(PLACES), kind=st.sampled_from([*ODD]))
def test_described_files_of_other_content(tmp_path, described, where, kind):
    name, place = where
    path = tmp_path / "a.h5"
    path.write_bytes((described / f"{name}.h5").read_bytes())
    with h5py.File(path, "r+") as file:
        put_odd(file, place, kind)
    harmless(FILES[name][2], path, sealed(path))


@pytest.mark.slow
@FEWER
@given(
    swaps=st.dictionaries(
        st.sampled_from([*VECTORS, "anchors", "measurements"]), st.sampled_from([*ODD]), min_size=1
    )
)
def test_mat_of_other_content(tmp_path, good, swaps):
    path = tmp_path / "a.mat"
    path.write_bytes((good / "7.mat").read_bytes())
    with h5py.File(path, "r+") as file:
        for name, kind in swaps.items():
            put_odd(file, name, kind)
    harmless(describe, path, sealed(path))


def test_header_that_promises_all_rows_is_refused_before_memory_is_taken(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["format"], file.attrs["version"] = KIND, 1
        group = file.create_group("measurements")
        for name in VECTORS:
            group.create_dataset(
                name, shape=(10**12,), dtype="i8" if name in "step anchor" else "f8", chunks=(64,)
            )
        file.create_group("anchors").create_dataset("name", data=["A"], dtype=h5py.string_dtype())
    with pytest.raises(InputError, match="1000000000000"):
        Measurements.from_h5(tmp_path / "a.h5")


def read_plan(path):
    plan_of(geojson.read_walls(path), path.name, name="x").toml()


@pytest.mark.slow
@CASES
@given(content=damaged(PLAN.encode()) | retold(PLAN))
@example(content=b"[" * 3000)
@example(content=PLAN.replace("0.4", "9" * 400).encode())
def test_geojson(tmp_path, content):
    harmless(read_plan, tmp_path / "a.geojson", content)


@pytest.mark.slow
@CASES
@given(content=damaged(DRAWING.encode()) | retold(DRAWING))
def test_dxf(tmp_path, content):
    pytest.importorskip("ezdxf")
    from gridslam.importers.dxf import read_walls

    def read(path):
        lines, _ = read_walls(path)
        plan_of(lines, path.name, name="x").toml()

    harmless(read, tmp_path / "a.dxf", content)


def test_good_files_are_read(tmp_path, good):
    """What the damaged ones are made of."""
    ezdxf = pytest.importorskip("ezdxf")
    assert ezdxf
    from gridslam.importers.dxf import read_walls

    (tmp_path / "a.dxf").write_text(DRAWING)
    assert len(read_walls(tmp_path / "a.dxf")[0]) == 8
    for path in good.iterdir():
        assert len(Measurements.load(path)) == 8
    (tmp_path / "a.csv").write_text(TABLE)
    assert len(Measurements.from_csv(tmp_path / "a.csv")) == 8
