"""HDF5 files of measurements: nothing is lost, and every fault is named."""

import re
from dataclasses import fields

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from tables import COLUMNS, HEADER, ROW, measurements, same, table

from gridslam.errors import InputError
from gridslam.measurements.table import Measurements
from gridslam.simulation.image_source import simulate
from gridslam.world.columns import VALUES
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory


def full():
    track = Trajectory([0.0, 0.5], [[1, 2], [3, 4]], [[0, 1], [1, 0]], [0.1, 0.2])
    return Measurements(
        **table(aoa_std_rad=[0.1, np.nan, 0.2, 0.3], amplitude=[2, 3, np.nan, 4]),
        anchor_position_m=[[1.0, 2.0], [3.0, 4.0]],
        anchor_orientation_rad=[0.5, -0.5],
        interval_s=0.25,
        steps=9,
        truth=track,
    )


@pytest.mark.slow
@given(table=measurements())
@settings(max_examples=25, deadline=None)
def test_h5_keeps_every_digit(tmp_path_factory, table):
    path = tmp_path_factory.mktemp("h5") / "heard.h5"
    table.to_h5(path)
    read = Measurements.from_h5(path)
    same(read, table)
    assert (read.anchors, read.interval_s, len(read)) == (table.anchors, table.interval_s, len(table))
    assert read.truth is read.anchor_position_m is None


def test_h5_keeps_anchors_steps_and_truth(tmp_path):
    full().to_h5(tmp_path / "a.h5")
    read = Measurements.from_h5(tmp_path / "a.h5")
    same(
        read,
        full(),
        [f.name for f in fields(Measurements) if f.name in COLUMNS or f.name.startswith("anchor_")],
    )
    assert (read.anchors, read.interval_s, read.steps, read.truth) == (("A", "B"), 0.25, 9, full().truth)


def test_h5_layout_is_the_contracts(tmp_path):
    full().to_h5(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        assert (file.attrs["format"], file.attrs["version"]) == ("gridslam-measurements", 1)
        found = {}
        file.visititems(
            lambda name, item: found.update({name: item}) if isinstance(item, h5py.Dataset) else None
        )
        assert all(item.attrs["unit"] for item in found.values())
        units = {name: item.attrs["unit"] for name, item in found.items()}
        assert file["anchors/name"].asstr()[:].tolist() == ["A", "B"]
    wanted = {f"measurements/{name}" for name in HEADER.split(",")} | {"measurements/aoa_std_rad"}
    wanted |= {f"anchors/{name}" for name in ("name", "position_m", "orientation_rad")}
    wanted |= {f"truth/{name}" for name in ("time_s", "position_m", "velocity_mps", "heading_rad")}
    assert set(units) == wanted
    assert (units["measurements/aoa_rad"], units["truth/velocity_mps"]) == ("rad", "m/s")


def test_silence_survives_h5(tmp_path):
    Measurements(**table(0), steps=5, interval_s=2.0).to_h5(tmp_path / "a.h5")
    assert [scan.time_s for scan in Measurements.from_h5(tmp_path / "a.h5")] == [0, 2, 4, 6, 8]


def edit(path, change):
    full().to_h5(path)
    with h5py.File(path, "r+") as file:
        change(file)


def replace(file, name, values):
    del file[name]
    file[name] = values


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "where"),
    [
        (lambda f: f.attrs.__setitem__("format", "gridslam-map"), ": format"),
        (lambda f: f.attrs.__delitem__("format"), ": format"),
        (lambda f: f.attrs.__setitem__("version", 99), ": version"),
        (lambda f: f.__delitem__("measurements"), ": /measurements"),
        (lambda f: f.__delitem__("anchors"), ": /anchors"),
        (lambda f: [f.__delitem__(f"measurements/{name}") for name in VALUES], ": /measurements"),
        (lambda f: replace(f, "measurements/aoa_rad", np.zeros(3)), ": /measurements/aoa_rad"),
        (lambda f: replace(f, "measurements/aoa_rad", np.array([b"x"] * 4)), ": /measurements/aoa_rad"),
        (lambda f: replace(f, "measurements/step", np.arange(4) / 2), ": /measurements/step[1]"),
        (lambda f: replace(f, "measurements/step", np.arange(4)[::-1]), ": /measurements/step[1]"),
        (lambda f: replace(f, "measurements/anchor", np.full(4, 7)), ": /measurements/anchor[0]"),
        (lambda f: replace(f, "measurements/time_s", np.zeros(4)), ": /measurements/time_s[1]"),
        (lambda f: replace(f, "anchors/position_m", np.zeros((2, 4))), ": /anchors/position_m"),
        (lambda f: replace(f, "anchors/name", np.arange(2)), ": /anchors/name"),
        (lambda f: replace(f, "truth/position_m", np.zeros((3, 2))), ": /truth/position_m"),
    ],
)
def test_h5_fault_is_told_with_its_dataset(tmp_path, change, where):
    path = tmp_path / "a.h5"
    edit(path, change)
    with pytest.raises(InputError) as caught:
        Measurements.from_h5(path)
    assert caught.value.where == f"{path}{where}"
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        lambda f: f["measurements"].attrs.__setitem__("steps", 10**15),
        lambda f: f["measurements"].attrs.__setitem__("steps", "many"),
        lambda f: f["measurements"].attrs.__setitem__("interval_s", np.nan),
        lambda f: replace(f, "truth/heading_rad", np.full(2, np.nan)),
        lambda f: replace(f, "anchors/name", np.array(["A", "A"], dtype=h5py.string_dtype())),
        lambda f: replace(f, "anchors/name", np.array([b"\xff", b"A"], dtype=h5py.string_dtype("ascii", 4))),
    ],
)
def test_h5_with_faulty_extras_is_refused_and_named(tmp_path, change):
    path = tmp_path / "a.h5"
    edit(path, change)
    with pytest.raises(InputError) as caught:
        Measurements.from_h5(path)
    assert caught.value.where.startswith(str(path))


def test_h5_that_promises_absurdly_many_rows_is_refused_before_memory_is_asked_for(tmp_path):
    def inflate(file):
        for name in list(file["measurements"]):
            kind = file[f"measurements/{name}"].dtype
            del file[f"measurements/{name}"]
            file["measurements"].create_dataset(name, shape=(10**13,), dtype=kind, chunks=(1024,))

    edit(tmp_path / "a.h5", inflate)
    with pytest.raises(InputError, match=r"/measurements/step.*10000000000000 values"):
        Measurements.from_h5(tmp_path / "a.h5")


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.6, 0.95])
def test_truncated_h5_is_refused(tmp_path, share):
    path = tmp_path / "a.h5"
    full().to_h5(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=re.escape(str(path))):
        Measurements.from_h5(path)


def test_foreign_files_are_refused(tmp_path):
    (tmp_path / "a.h5").write_text(f"{HEADER}\n{ROW}\n")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["x"] = 1
    for name in ("a.h5", "b.h5", "none.h5", "."):
        with pytest.raises(InputError, match=re.escape(str(tmp_path))):
            Measurements.from_h5(tmp_path / name)


def test_simulated_measurements_survive_both_files(tmp_path):
    scene = Scene.load("room")
    table = simulate(scene, "agent1", seed=3)
    table.to_h5(tmp_path / "a.h5")
    table.to_csv(tmp_path / "a.csv")
    from_h5, from_csv = (
        Measurements.from_h5(tmp_path / "a.h5"),
        Measurements.from_csv(tmp_path / "a.csv", ["A", "B"]),
    )
    same(from_h5, table)
    same(from_csv, table)
    assert from_h5.truth == scene.track("agent1")
    np.testing.assert_array_equal(from_h5.anchor_position_m, scene.anchor_positions)
    np.testing.assert_allclose(from_h5.anchor_orientation_rad, scene.anchor_orientations)
    assert len(from_h5) == len(table) == 150
