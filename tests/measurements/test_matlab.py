"""MATLAB files, version 5 to 7.3: the same table as from CSV, and no file that claims more than it holds."""

import re
import struct
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from tables import same, table

from gridslam.errors import InputError
from gridslam.measurements.table import Measurements

VECTORS = {name: values for name, values in table(6).items() if name != "anchors"}


def cell(words):
    return np.array([*words, None], dtype=object)[:-1].reshape(-1, 1)


def columns(**changes):
    """As MATLAB holds a table: columns, anchors counted from 1."""
    whole = VECTORS | {"anchor": VECTORS["anchor"] + 1}
    return {name: np.reshape(v, (-1, 1)) for name, v in (whole | changes).items() if v is not None}


def write_73(path, variables, group=None):
    """As MATLAB writes version 7.3: arrays transposed, text as codes, cells as references."""
    with h5py.File(path, "w", userblock_size=512) as file:
        where = file.create_group(group) if group else file

        def put(place, name, value):
            if value.dtype == object:
                links = []
                for number, word in enumerate(value.ravel()):
                    codes = np.array([[ord(c)] for c in word], dtype=np.uint16)
                    links.append(file.create_dataset(f"#refs#/{name}{number}", data=codes).ref)
                place.create_dataset(name, data=np.reshape(links, value.shape).T, dtype=h5py.ref_dtype)
                return
            place.create_dataset(name, data=value.T).attrs["MATLAB_class"] = np.bytes_("double")

        for name, value in variables.items():
            put(file if name == "anchors" else where, name, value)
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(512))


def write_5(path, variables, group=None, packed=True):
    own = {name: value for name, value in variables.items() if name != "anchors"}
    rest = {name: value for name, value in variables.items() if name == "anchors"}
    savemat(path, ({group: own} if group else own) | rest, do_compression=packed)


@pytest.mark.slow
@pytest.mark.parametrize("write", [write_5, write_73])
@pytest.mark.parametrize("group", [None, "measurements"])
@pytest.mark.parametrize(
    "anchor", [None, cell([("north", "tür 2")[k] for k in VECTORS["anchor"]])], ids=["numbers", "names"]
)
def test_every_version_gives_the_table_of_the_csv_file(tmp_path, write, group, anchor):
    names = ("north", "tür 2")
    changes = {} if anchor is None else {"anchor": anchor}
    write(tmp_path / "a.mat", columns(**changes) | {"anchors": cell(names)}, group)
    wanted = Measurements(**table(6, anchors=names))
    for read in (
        Measurements.from_mat(tmp_path / "a.mat"),
        Measurements.from_mat(tmp_path / "a.mat", names),
        Measurements.load(tmp_path / "a.mat"),
    ):
        same(read, wanted)
        assert read.anchors == names


@pytest.mark.parametrize("write", [write_5, write_73])
def test_anchors_without_names_are_numbered_and_missing_columns_not_measured(tmp_path, write):
    write(tmp_path / "a.mat", columns(aod_rad=None, amplitude=None, distance_std_m=np.full(6, 0.1)))
    read = Measurements.from_mat(tmp_path / "a.mat")
    assert read.anchors == ("1", "2")
    assert np.isnan(read.aod_rad).all()
    assert np.isnan(read.amplitude).all()
    np.testing.assert_array_equal(read.distance_std_m, np.full(6, 0.1))


@pytest.mark.slow
@pytest.mark.parametrize("write", [write_5, write_73])
@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"step": None}, ""),
        ({"distance_m": None, "aod_rad": None, "aoa_rad": None, "amplitude": None}, ""),
        ({"aoa_rad": np.zeros(5)}, ": aoa_rad"),
        ({"aoa_rad": np.full(6, 80.0)}, ": aoa_rad(1)"),
        ({"aoa_rad": np.zeros(6) + 1j}, ": aoa_rad"),
        ({"step": np.arange(6) + 0.5}, ": step"),
        ({"step": np.full(6, np.nan)}, ": step"),
        ({"anchor": np.zeros(6)}, ": anchor"),
        ({"anchor": np.full(6, 3)}, ": anchor"),
        ({"anchor": np.full(6, 1e300)}, ": anchor"),
        ({"anchor": cell(["C"] * 6)}, ": anchor"),
    ],
)
def test_fault_is_told_with_its_variable(tmp_path, write, changes, where):
    path = tmp_path / "a.mat"
    write(path, columns(**changes))
    with pytest.raises(InputError) as caught:
        Measurements.from_mat(path, ["A", "B"])
    assert caught.value.where == f"{path}{where}"
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("write", [write_5, write_73])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 0.7, 0.99])
def test_file_cut_short_is_refused(tmp_path, write, share):
    path = tmp_path / "a.mat"
    write(path, columns())
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(InputError) as caught:
        Measurements.from_mat(path)
    assert caught.value.where.startswith(str(path))


def test_other_files_are_refused(tmp_path):
    (tmp_path / "text.mat").write_text("step,time_s\n" * 50)
    with h5py.File(tmp_path / "other.mat", "w") as file:
        file["x"] = 1
    for name in ("text.mat", "other.mat", "none.mat", "."):
        with pytest.raises(InputError):
            Measurements.from_mat(tmp_path / name)


def claim(content, count):
    """Let the first array of a version 5 file claim `count` rows."""
    place = content.index(struct.pack("<II", 5, 8)) + 8
    return content[:place] + struct.pack("<i", count) + content[place + 4 :]


@pytest.mark.parametrize("group", [None, "measurements"])
@pytest.mark.parametrize("count", [2**30, 2**31 - 1])
def test_array_that_claims_more_than_the_file_holds_is_refused(tmp_path, group, count):
    path = tmp_path / "a.mat"
    write_5(path, columns(), group, packed=False)
    path.write_bytes(claim(path.read_bytes(), count))
    with pytest.raises(InputError, match="elements"):
        Measurements.from_mat(path)


def test_packed_zeros_are_refused_before_they_fill_the_memory(tmp_path, monkeypatch):
    monkeypatch.setattr("gridslam.measurements.matlab.LARGEST_MAT_BYTES", 2**20)
    write_5(tmp_path / "a.mat", columns())
    content = (tmp_path / "a.mat").read_bytes()[:128]
    bomb = zlib.compress(bytes(2**24))
    (tmp_path / "a.mat").write_bytes(content + struct.pack("<II", 15, len(bomb)) + bomb)
    with pytest.raises(InputError, match="too large"):
        Measurements.from_mat(tmp_path / "a.mat")


def test_absurd_dataset_is_refused(tmp_path):
    write_73(tmp_path / "a.mat", columns(aoa_rad=None))
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file.create_dataset("aoa_rad", shape=(1, 10**12), dtype=float, chunks=(1, 1024))
    with pytest.raises(InputError, match="1000000000000 values"):
        Measurements.from_mat(tmp_path / "a.mat")


def tutorial_lines(struct=False):
    """The variables of the tutorial's MATLAB lines, read by MATLAB's own grammar of numbers and columns."""
    page = (Path(__file__).parents[2] / "docs/tutorials/matlab.md").read_text(encoding="utf-8")
    block = re.search(r"```matlab\n(.*?)```", page, re.S)[1]
    *assigned, saved = block.strip().splitlines()
    cells = re.findall(r"(\w+) = \[([^\]]*)\];", " ".join(assigned))
    found = {
        name: np.array([[float(v.replace("NaN", "nan"))] for v in text.split(";")]) for name, text in cells
    }
    words = saved.rstrip(";").split()
    assert words[:2] == ["save", "heard.mat"]
    assert sorted(words[2:]) == sorted(found)
    return {"measurements": found} if struct else found


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize(("version", "struct"), [("5", False), ("5, packed", True), ("7.3", False)])
def test_the_tutorials_lines_lead_from_a_matlab_file_to_a_map(say, tmp_path, version, struct):
    """Files as MATLAB writes them, made without MATLAB: `savemat`, and h5py by version 7.3's conventions."""
    found = tutorial_lines(struct)
    if version == "7.3":
        write_73(tmp_path / "heard.mat", tutorial_lines(), "measurements" if struct else None)
    else:
        savemat(tmp_path / "heard.mat", found, do_compression="packed" in version)
    measurements = Measurements.from_mat("heard.mat", ("A", "B"))
    assert measurements.anchor.tolist() == [0, 1, 0]
    np.testing.assert_allclose(measurements.aod_rad, [-0.49, np.nan, -0.5])
    assert say("check", "heard.mat", "--scene", "room").code == 0
    done = say("run", "room", "--measurements", "heard.mat", "--particles", "64", "-o", "matlab")
    assert done.code == 0
    with h5py.File("matlab/agent1/steps.h5") as steps, h5py.File("matlab/map.h5") as mapped:
        assert steps["/steps/position_m"].shape == (2, 2)
        assert mapped["/grid/occupancy"].ndim == 2
    assert say("export", "matlab", "-o", "tables").code == 0
    assert len(Path("tables/agent1-track.csv").read_text().splitlines()) == 3
