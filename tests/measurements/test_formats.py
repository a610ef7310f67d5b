"""The CSV and HDF5 files of measurements: nothing is lost, and every fault is named."""

import re
from dataclasses import fields

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tables import COLUMNS, same, table

from gridslam.errors import InputError, Note
from gridslam.measurements.table import Measurements
from gridslam.simulation.image_source import simulate
from gridslam.world.columns import DEVIATIONS, VALUES
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory

HEADER = "step,time_s,anchor,distance_m,aod_rad,aoa_rad,amplitude"


@st.composite
def measurements(draw):
    anchors = draw(st.sampled_from([("A",), ("A", "B"), ('north "1", left', "tür", "3")]))
    count = draw(st.integers(1, 12))
    step = np.cumsum(draw(st.lists(st.integers(0, 2), min_size=count, max_size=count)))
    pace = draw(st.sampled_from([1.0, 0.1, 1 / 3]))
    maybe = st.one_of(st.just(np.nan), st.floats(1e-6, 1e6, allow_subnormal=False))
    angle = st.one_of(st.just(np.nan), st.floats(-3.14, 3.14, allow_subnormal=False))
    column = {name: draw(st.lists(angle, min_size=count, max_size=count)) for name in ("aod_rad", "aoa_rad")}
    column["amplitude"] = draw(st.lists(maybe, min_size=count, max_size=count))
    column["distance_m"] = draw(
        st.lists(st.floats(1e-6, 1e6, allow_subnormal=False), min_size=count, max_size=count)
    )
    for name in draw(st.sets(st.sampled_from(DEVIATIONS))):
        column[name] = draw(st.lists(maybe, min_size=count, max_size=count))
    anchor = draw(st.lists(st.integers(0, len(anchors) - 1), min_size=count, max_size=count))
    return Measurements(anchors=anchors, step=step, time_s=5 + pace * step, anchor=anchor, **column)


# ---- CSV


@pytest.mark.slow
@given(table=measurements())
@settings(max_examples=60, deadline=None)
def test_csv_keeps_every_digit(tmp_path_factory, table):
    path = tmp_path_factory.mktemp("csv") / "heard.csv"
    table.to_csv(path)
    read = Measurements.from_csv(path, table.anchors)
    same(read, table)
    assert len(read) == len(table)


def test_csv_is_what_the_contract_says(tmp_path):
    Measurements(**table(2, amplitude=[2.5, np.nan])).to_csv(tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text().splitlines() == [
        HEADER,
        "0,0.0,A,1.0,-3.0,3.0,2.5",
        "1,0.5,B,2.0,3.0,-3.0,",
    ]


def test_csv_of_other_programs_is_read(tmp_path):
    header = "\ufeffanchor, time_s ,step,amplitude,aoa_rad,aod_rad,distance_m"
    text = "\r\n".join([header, "B,0.25,3,,,, 4.5", "", "A,1,5,3,0,0,1", ""])
    (tmp_path / "a.csv").write_bytes(text.encode())
    table = Measurements.from_csv(tmp_path / "a.csv", ["A", "B"])
    assert len(table) == 6
    np.testing.assert_array_equal(table.step, [3, 5])
    np.testing.assert_array_equal(table.anchor, [1, 0])
    np.testing.assert_array_equal(table.distance_m, [4.5, 1])
    assert np.isnan(table.amplitude[0])


def test_ranging_alone_is_a_table_of_four_columns(tmp_path):
    (tmp_path / "a.csv").write_text("step,time_s,anchor,distance_m\n0,0,B,3.5\n2,1,A,4.5\n")
    table = Measurements.from_csv(tmp_path / "a.csv")
    assert table.anchors == ("B", "A")  # as they first appear
    np.testing.assert_array_equal(table.distance_m, [3.5, 4.5])
    assert np.isnan([table.aod_rad, table.aoa_rad, table.amplitude]).all()
    table.to_h5(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        for name in ("aod_rad", "aoa_rad", "amplitude"):
            del file[f"measurements/{name}"]
    same(Measurements.from_h5(tmp_path / "a.h5"), table)


ROW = "0,0.0,A,1.0,0.5,0.5,3.0"


@pytest.mark.parametrize(
    ("text", "where", "says"),
    [
        ("", "", "empty file"),
        (HEADER, "", "no rows"),
        (HEADER.replace("aoa_rad", "aoa_grad") + f"\n{ROW}", ": line 1", "aoa_rad"),
        (HEADER + ",aoa_deg\n" + ROW + ",0", ": line 1", "columns 'aoa_rad' and 'aoa_deg'"),
        (HEADER.replace("aoa_rad", "aoa_deg") + "\n0,0,A,1,0,361,3", ": line 2: aoa_deg", "degrees, 360"),
        (f"{HEADER}\n0,nan,A,1,0,0,3", ": line 2: time_s", "finite number"),
        (HEADER.replace("time_s,", "") + "\n0,A,1,0,0,3", ": line 1", "no column 'time_s'"),
        ("step,time_s,anchor,aoa_std_rad\n0,0,A,1", ": line 1", "no measured column"),
        (HEADER + ",step\n" + ROW + ",0", ": line 1", "'step' twice"),
        (HEADER.replace("distance_m", "range") + f"\n{ROW}", ": line 1", "allowed: distance_m, in metres"),
        (HEADER.replace("distance_m", "ToA_ns") + f"\n{ROW}", ": line 1", "times the speed of light"),
        (HEADER.replace("time_s", "time_ms") + f"\n{ROW}", ": line 1", "time_s, in seconds: time_ms / 1000"),
        (HEADER.replace("time_s", "t_us") + f"\n{ROW}", ": line 1", "time_s, in seconds: t_us / 1e6"),
        (HEADER.replace("time_s", "timestamp") + f"\n{ROW}", ": line 1", "allowed: time_s, in seconds"),
        (
            HEADER.replace("distance_m", "distance_cm") + f"\n{ROW}",
            ": line 1",
            "distance_cm / 100",
        ),
        (HEADER.replace("amplitude", "amplitude_db") + f"\n{ROW}", ": line 1", "10 ** (amplitude_db / 20)"),
        (
            HEADER.replace("amplitude", "distance_std") + f"\n{ROW}",
            ": line 1",
            "distance_std_m (nearest",
        ),
        (f"{HEADER}\n{ROW},9", ": line 2", "8 cells"),
        (f"{HEADER}\n{ROW}\n1,1.0,A,1.0", ": line 3", "4 cells"),
        (f"{HEADER}\n{ROW}\n\n1,1.0,A,far,0,0,3", ": line 4: distance_m", "'far'"),
        (f"{HEADER}\n0,0,A,inf,0,0,3", ": line 2: distance_m", "empty cell if not measured"),
        (f"{HEADER}\n0,0,A,nan,NaN,,nan", ": line 2: distance_m", "at least one of"),
        (f"{HEADER}\n0,0,A,1,0,-inf,3", ": line 2: aoa_rad", "finite number"),
        (f"{HEADER}\n0,,A,1,0,0,3", ": line 2: time_s", "finite number"),
        (f"{HEADER}\n0,1e999,A,1,0,0,3", ": line 2: time_s", "finite number"),
        (f"{HEADER}\n0.5,0,A,1,0,0,3", ": line 2: step", "whole number"),
        (f"{HEADER}\n-1,0,A,1,0,0,3", ": line 2: step", "whole number"),
        (f"{HEADER}\n99999999999,0,A,1,0,0,3", ": line 2: step", "9999999"),
        (f"{HEADER}\n0,0,C,1,0,0,3", ": line 2: anchor", "'C'; allowed: A, B"),
        (f"{HEADER}\n0,0,A,,,,", ": line 2: distance_m", "at least one of"),
        (f"{HEADER}\n0,0,A,1,0,87.5,3", ": line 2: aoa_rad", "radians"),
        (f"{HEADER}\n1,0,A,1,0,0,3\n0,1,A,1,0,0,3", ": line 3: step", "rising order"),
        (f"{HEADER}\n{ROW}\n\n1,0.0,A,1,0,0,3", ": line 4: time_s", "rise strictly"),
        (f"{HEADER}\n{ROW}\n0,0.1,A,1,0,0,3", ": line 3: time_s", "one time"),
        (f'{HEADER}\n{ROW}\n0,0.0,"A,1,0,0,3', ": line 3", "CSV row"),
    ],
)
def test_csv_fault_is_told_with_its_line(tmp_path, text, where, says):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        Measurements.from_csv(path, ["A", "B"])
    assert caught.value.where == f"{path}{where}"
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["robot", "tag", "tag_id", "Device", "device_id", "node", "node_id"])
def test_a_column_of_devices_is_answered_with_agent(tmp_path, name):
    path = tmp_path / "a.csv"
    path.write_text(f"{HEADER},{name}\n{ROW},r1\n")
    with pytest.warns(Note, match=rf"column {name} not used \(agent, a name of the scene's \[\[agents\]\]"):
        assert len(Measurements.from_csv(path, ["A", "B"]).step) == 1


@pytest.mark.parametrize(
    ("name", "way"),
    [
        ("snr_db", "10 ** (snr_db / 20)"),
        ("SNR", "SNR ** 0.5"),
        ("rssi_db", "10 ** ((rssi_db - level of the noise in db) / 20)"),
        ("power_dbm", "10 ** ((power_dbm - level of the noise in dbm) / 20)"),
        ("power", "(power / that of the noise) ** 0.5 of powers"),
    ],
)
def test_csv_without_amplitudes_says_what_would_be_some(tmp_path, name, way):
    path = tmp_path / "a.csv"
    path.write_text(HEADER.replace("amplitude", name) + f"\n{ROW}")
    with pytest.warns(Note) as told:
        table = Measurements.from_csv(path, ["A", "B"])
    assert np.isnan(table.amplitude).all()
    line = f"{path}: column {name} not used (amplitude, the root of the SNR: {way})"
    assert [str(note.message) for note in told] == [line]
    path.write_text(f"{HEADER},{name},time_ms\n{ROW},9,9")
    with pytest.warns(Note, match=f"columns {name}, time_ms not used$"):
        Measurements.from_csv(path, ["A", "B"])


@pytest.mark.parametrize(
    ("name", "gone", "meant"),
    [
        ("azimuth", ["aoa_rad"], ["aoa_rad, where it comes from"]),
        ("Azimuth_deg", ["aoa_rad"], ["aoa_deg, where it comes from"]),
        ("bearing", ["aod_rad"], ["aod_rad, where it leaves to"]),
        ("azimuth", ["aod_rad", "aoa_rad"], ["aoa_rad, where it comes from", "aod_rad, where it leaves to"]),
        ("azimuth", [], []),
        ("comment", ["aoa_rad"], []),
    ],
)
def test_a_column_of_angles_that_is_called_otherwise_is_answered_with_those_that_lack(
    tmp_path, name, gone, meant
):
    path = tmp_path / "a.csv"
    rows = dict(zip(HEADER.split(","), ROW.split(","), strict=True))
    rows = {key: cell for key, cell in rows.items() if key not in gone} | {name: "0.5"}
    path.write_text(",".join(rows) + "\n" + ",".join(rows.values()) + "\n")
    with pytest.warns(Note, match=f"column {name} not used") as told:
        Measurements.from_csv(path, ["A", "B"])
    (note,) = (str(one.message) for one in told)
    assert [part in note for part in meant] == [True] * len(meant)
    assert ("(" in note) == bool(meant)


def test_constant_deviations_of_angles_are_columns_in_degrees_too(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"{HEADER},aod_std_deg,aoa_std_deg\n{ROW},3,2\n1,1.0,B,2.0,,0.5,3.0,,2\n")
    table = Measurements.from_csv(path, ["A", "B"])
    np.testing.assert_allclose(np.degrees(table.aoa_std_rad), [2, 2])
    np.testing.assert_allclose(np.degrees(table.aod_std_rad), [3, np.nan])
    path.write_text(f"{HEADER},aoa_std_deg\n{ROW},0\n")
    with pytest.raises(InputError, match=r"line 2: aoa_std_deg: found 0\.0; allowed: a number above 0$"):
        Measurements.from_csv(path, ["A", "B"])


def test_csv_of_spreadsheets_and_of_savetxt_reads_as_a_plain_one(tmp_path):
    """Semicolons with decimal commas, tabs, remarks, degrees, and nan for not measured."""
    plain = (
        "step,time_s,anchor,distance_m,aod_rad,aoa_rad\n0,0.0,A,3.75,,0.5235987755982988\n1,0.5,B,4.5,0.25,\n"
    )
    ways = {
        "plain": plain,
        "semicolons": plain.replace(",", ";").replace(".", ","),
        "tabs": plain.replace(",", "\t"),
        "remarks": "# recorded on Tuesday; by tram, no. 3\n#\n" + plain,
        "nan": plain.replace("A,3.75,,", "A,3.75,nan,").replace("0.25,\n", "0.25,NaN\n"),
        "degrees": plain.replace("aoa_rad", "aoa_deg").replace("0.5235987755982988", "30"),
    }
    read = {}
    for way, text in ways.items():
        (tmp_path / f"{way}.csv").write_text(text)
        read[way] = Measurements.from_csv(tmp_path / f"{way}.csv")
    for way, each in read.items():
        for name in ("step", "time_s", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude"):
            np.testing.assert_allclose(
                getattr(each, name), getattr(read["plain"], name), rtol=1e-15, err_msg=way
            )


def test_csv_that_is_no_text_is_named(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"\x89HDF\r\n\xff")
    for path in (tmp_path / "a.csv", tmp_path / "none.csv", tmp_path):
        with pytest.raises(InputError, match=re.escape(str(path))):
            Measurements.from_csv(path, ["A"])


# ---- HDF5


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
        (lambda f: replace(f, "measurements/step", np.arange(4.0)), ": /measurements/step"),
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


# ---- with the simulator


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


def test_without_steps_every_time_is_one(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time_s,anchor,distance_m\n0.5,A,1\n0.5,B,2\n1.75,A,3\n4,B,4\n")
    with pytest.warns(Note, match="no column step: 3 steps, one for each time"):
        table = Measurements.load(path)
    np.testing.assert_array_equal(table.step, [0, 0, 1, 2])
    np.testing.assert_array_equal(table.time_s, [0.5, 0.5, 1.75, 4.0])
