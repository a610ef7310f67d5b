"""CSV files of measurements: nothing is lost, and every fault is named."""

import re

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from tables import HEADER, ROW, measurements, same, table

from gridslam.checks.network.tables import is_network
from gridslam.errors import InputError, Note
from gridslam.measurements.csv_table import IN_DEGREES, KNOWN, read_csv
from gridslam.measurements.table import Measurements
from gridslam.world.validation import nearest


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


@pytest.mark.parametrize(("columns", "cells"), [("aoa_rad", ""), ("aod_deg,amplitude", ",")])
def test_an_empty_row_of_a_table_without_distances_is_refused_by_what_it_has(tmp_path, columns, cells):
    text = f"step,time_s,anchor,{columns}\n0,0,A,{cells}1\n1,1,A,{cells}\n"
    (tmp_path / "a.csv").write_text(text)
    named = columns.partition(",")[0]
    with pytest.raises(InputError, match=f"line 3: {named}: found nan; allowed: at least one of distance_m"):
        read_csv(tmp_path / "a.csv")


def test_headers_in_other_letters_and_between_blanks_are_taken(tmp_path):
    header = " Step ,Time_s,ANCHOR,Distance_m,AoD_rad, AoA_Deg ,Amplitude,Distance_Std_m"
    (tmp_path / "a.csv").write_text(f"{header}\n0,0,A,3,0.5,90,9,0.1\n")
    table = Measurements.from_csv(tmp_path / "a.csv")
    np.testing.assert_allclose([table.aod_rad[0], table.aoa_rad[0]], [0.5, np.pi / 2])
    np.testing.assert_array_equal(table.distance_std_m, [0.1])
    assert not is_network(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text(f"Agent,{header}\nme,0,0,A,3,0.5,90,9,0.1\n")
    assert is_network(tmp_path / "b.csv")


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("aoa", "aoa_rad"), ("AoA", "aoa_rad"), ("aod", "aod_rad"), ("aoa [rad]", "aoa_rad"),
        ("AoA (deg)", "aoa_deg"), ("time [s]", "time_s"), ("Distance [m]", "distance_m"),
        ("ampl", "amplitude"), ("aoa_grad", "aoa_rad"), ("anchr", "anchor"),
    ],
)  # fmt: skip
def test_a_column_is_told_what_it_probably_means(written, meant, tmp_path):
    assert nearest(written, (*KNOWN, *IN_DEGREES)) == f"{meant} (nearest known)"
    others = [name for name in HEADER.split(",") if name != meant.replace("_deg", "_rad")]
    (tmp_path / "a.csv").write_text(",".join([*others, written]) + f"\n{ROW}\n")
    with pytest.raises(InputError, match=rf"allowed: {meant} \(nearest known\)|time_s, in seconds"):
        Measurements.from_csv(tmp_path / "a.csv")


@pytest.mark.parametrize("written", ["station", "BS", "base_station", "gnb_id", "ap", "tx", "AP name"])
@pytest.mark.parametrize("several", [False, True])
def test_a_column_of_stations_is_told_to_be_that_of_anchors(written, several, tmp_path):
    """A table of several agents may do without anchors: it was called unlabelled."""
    agent, me = ("agent,", "me,") if several else ("", "")
    text = f"{agent}{HEADER.replace('anchor', written)}\n{me}{ROW}\n"
    (tmp_path / "a.csv").write_text(text)
    told = f"found a column '{written}', and no anchor; allowed: anchor, a name of"
    with pytest.raises(InputError, match=told):
        read_csv(tmp_path / "a.csv", several=several)


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


@pytest.mark.parametrize(
    ("text", "where", "says"),
    [
        ("", "", "empty file"),
        (HEADER, "", "no rows"),
        (f"{ROW}\n{ROW}", ": line 1", "no header"),
        (ROW.replace(",", ";").replace(".", ","), ": line 1", "no header"),
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
        (f"{HEADER}\n0,0,A,1,0,0,3\n1,1,A,1,0,0,3\n0,2,A,1,0,0,3", ": line 4: step", "second recording"),
        (f"{HEADER}\n{ROW}\n\n1,0.0,A,1,0,0,3", ": line 4: time_s", "rise strictly"),
        (f"{HEADER}\n{ROW}\n0,0.1,A,1,0,0,3", ": line 3: time_s", "one time"),
        (f'{HEADER}\n{ROW}\n0,0.0,"A,1,0,0,3', ": line 3", "CSV row"),
        (f'{HEADER}\n0,0.0,"A,1,0,0,3\n' + f"{ROW}\n" * 9000, ": line 2", "mark that isn't closed"),
        (f"{HEADER},,\n{ROW},,\n{ROW},,9", ": line 3", "9 cells"),
        ((f"{HEADER}\n{ROW}").replace(",", " "), ": line 1", "set apart by spaces; allowed: commas"),
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


@pytest.mark.filterwarnings("ignore::gridslam.errors.Note")
def test_unsorted_rows_without_steps_are_told_by_their_times(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time_s,anchor,distance_m\n0,A,2\n0.2,A,2\n0.1,A,2")
    with pytest.raises(InputError, match=r"line 4: time_s: found 0.1; allowed: .*sort the rows by time_s"):
        Measurements.from_csv(path, ["A"])


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
        "remarks between": plain.replace("1,0.5", "# pause, of 3 s\n1,0.5"),
        "nameless columns": plain.replace("\n", ",,\n"),
        "an empty row first": ",,,,,\n" + plain,
        "empty rows": plain.replace("1,0.5", ",,,,,\n1,0.5") + " , ,,,,\n,,,,,\n",
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


@pytest.mark.parametrize(
    "cell", ["1.234.5", "1,234.5", "1.234,5", "1 234.5", "1'234.5", "-1,234,567", "1\u202f234,5"]
)
@pytest.mark.parametrize("apart", [",", ";"])
def test_marks_between_thousands_are_named_with_line_column_and_cell(tmp_path, cell, apart):
    path = tmp_path / "a.csv"
    written = f'"{cell}"' if apart == "," else cell
    path.write_text(
        apart.join(("step", "time_s", "anchor", "distance_m")) + f"\n0{apart}0{apart}A{apart}{written}\n"
    )
    with pytest.raises(InputError) as caught:
        Measurements.from_csv(path, ["A"])
    assert caught.value.where == f"{path}: line 2: distance_m"
    assert caught.value.found == f"{cell!r}, with several marks"
    assert "one decimal mark, and none between thousands" in caught.value.allowed


def test_a_point_among_decimal_commas_is_not_guessed_at(tmp_path):
    """1.234 is a thousand to whoever writes 0,1, and one and a bit to others."""
    path, head = tmp_path / "a.csv", "step;time_s;anchor;distance_m;aoa_rad"
    path.write_text(f"{head}\n0;0;A;1,5;0,1\n1;1;A;1.234;0,1\n")
    with pytest.raises(
        InputError, match=r"line 3: distance_m: found '1\.234', and '1,5' in line 2; allowed: one"
    ):
        Measurements.from_csv(path, ["A"])
    path.write_text(f"{head}\n0;0;A.1;1.5;0.1\n1;1;A.1;1.234;0.1\n")
    np.testing.assert_array_equal(Measurements.from_csv(path, ["A.1"]).distance_m, [1.5, 1.234])
    path.write_text(f"{head}\n0;0;A.1;1,5;0,1\n")
    np.testing.assert_array_equal(Measurements.from_csv(path, ["A.1"]).distance_m, [1.5])


def test_csv_that_is_no_text_is_named(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"\x89HDF\r\n\xff")
    for path in (tmp_path / "a.csv", tmp_path / "none.csv", tmp_path):
        with pytest.raises(InputError, match=re.escape(str(path))):
            Measurements.from_csv(path, ["A"])


def test_without_steps_every_time_is_one(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time_s,anchor,distance_m\n0.5,A,1\n0.5,B,2\n1.75,A,3\n4,B,4\n")
    with pytest.warns(Note, match="no column step: 3 steps, one for each time"):
        table = Measurements.load(path)
    np.testing.assert_array_equal(table.step, [0, 0, 1, 2])
    np.testing.assert_array_equal(table.time_s, [0.5, 0.5, 1.75, 4.0])
