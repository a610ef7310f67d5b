"""Bad input on the command line: one clear line, exit code 2, nothing left behind."""

import os
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from cli_samples import HEADER, ROWS, listing
from refusals import one_line
from scene_samples import shortened

import gridslam as gs
from gridslam.systems.grid import GridSlam

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def refused(result, tmp_path, before, *words):
    one_line(result, *words)
    assert result.complaints[0].startswith("error: ")
    assert "Traceback" not in result.err + result.out
    assert listing(tmp_path) == before


def change(text, old, new):
    assert old in text
    return text.replace(old, new, 1)


SCENE_FAULTS = {
    "unknown key": ("[radio]", "[radio]\ncolour = 3", "radio.colour"),
    "misspelt key": ("bandwidth_hz", "bandwith_hz", "bandwidth_hz (nearest known)"),
    "key of another table": (
        "[radio]",
        "[radio]\nwaypoints_m = []",
        "it under [[agents]]",
    ),
    "misspelt key of an anchor": ("position_m = [-3.1", "positon_m = [-3.1", "anchors[0].positon_m"),
    "zero-length wall": ("[4.0, -3.0]", "[-4.0, -3.0]", "zero length"),
    "unknown material": ('material = "concrete"', 'material = "concret"', "concrete (nearest known)"),
    "coefficient above one": ("concrete = 0.7", "concrete = 1.7", "materials.concrete"),
    "coefficient zero": ("concrete = 0.7", "concrete = 0.0", "materials.concrete"),
    "agent in a wall": ("start_m = [\n    -2.0,", "start_m = [\n    -4.0,", "agents[0].start_m"),
    "agent outside": ("start_m = [\n    -2.0,", "start_m = [\n    -9.0,", "outside the grid"),
    "anchor outside": ("-3.1", "-31.0", "anchors[0].position_m"),
    "NaN": ("-3.1", "nan", "anchors[0].position_m"),
    "infinity": ("cell_m = 0.1", "cell_m = inf", "grid.cell_m"),
    "text for a number": ("cell_m = 0.1", 'cell_m = "small"', "grid.cell_m"),
    "broken TOML": ("[grid]", "[grid", "broken TOML"),
}


@pytest.mark.parametrize("fault", SCENE_FAULTS)
@pytest.mark.parametrize("command", [("run", "-o", "out"), ("check",), ("simulate", "-o", "heard.csv")])
def test_faulty_scene(say, tmp_path, fault, command):
    text = shortened(gs.Scene.load("room"), 4).to_toml().replace("[\n    -3.1,", "[-3.1,")
    text = text.replace("[\n            4.0,\n            -3.0,\n        ]", "[4.0, -3.0]")
    old, new, complaint = SCENE_FAULTS[fault]
    if fault == "zero-length wall":
        start = text.index("points_m")
        text = text[:start] + "points_m = [[-4.0, -3.0], [4.0, -3.0]]\n" + text[text.index("closed") :]
    (tmp_path / "bad.toml").write_text(change(text, old, new))
    refused(say(command[0], "bad.toml", *command[1:]), tmp_path, ["bad.toml"], "bad.toml", complaint)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"[[anchors]]\nname='A'\nposition_m=[1.0,1.0]\n", "grid"),
        (b"[grid]\nx_m=[0.0,1.0]\ny_m=[0.0,1.0]\n", "anchors"),
        (b"\xff\xfe", "UTF-8"),
    ],
)
def test_empty_scene(say, tmp_path, content, word):
    (tmp_path / "bad.toml").write_bytes(content)
    refused(say("run", "bad.toml"), tmp_path, ["bad.toml"], word)


def test_every_fault_of_a_scene_has_a_line_up_to_ten(say, tmp_path):
    bad = """name = 3
[radio]
snr_at_1m_db = "loud"
[grid]
x_m = [-1.0, 10.0]
y_m = [-1.0]
cell_m = -0.1
[[anchors]]
name = "A"
position_m = [0.3, "b"]
[filter]
particlse = 5
"""
    (tmp_path / "bad.toml").write_text(bad)
    result = say("check", "bad.toml")
    assert result.code == 2
    fields = [line.split(": ")[2] for line in result.complaints]
    assert fields == [
        "name", "radio.snr_at_1m_db", "grid.y_m[1]", "grid.cell_m", "anchors[0].position_m[1]",
        "filter.particlse",
    ]  # fmt: skip
    assert all(line.startswith("error: bad.toml: ") for line in result.complaints)
    with pytest.raises(gs.InputError, match=r"bad.toml: name: found 3; allowed: a valid string$"):
        gs.Scene.load("bad.toml")
    anchor = '[[anchors]]\nname = 1\nposition_m = "here"\n'
    (tmp_path / "worse.toml").write_text("[grid]\nx_m=[0.0,1.0]\ny_m=[0.0,1.0]\n" + 12 * anchor)
    result = say("check", "worse.toml")
    assert len(result.complaints) == 10
    assert result.complaints[-1] == "error: worse.toml: found 15 more faults; allowed: none"


CSV_FAULTS = {
    "empty": ("", "empty file"),
    "no rows": (HEADER, "no rows"),
    "missing column": (ROWS.replace("time_s,", ""), "no column 'time_s'"),
    "unknown column": (ROWS.replace("distance_m", "distance"), "distance_m (nearest known)"),
    "milliseconds": (
        ROWS.replace("time_s", "time_ms"),
        "no time_s; allowed: time_s, in seconds: time_ms / 1000",
    ),
    "time of another name": (ROWS.replace("time_s", "t_unix"), "time_s, in seconds (rename it)"),
    "decimal commas between commas": (ROWS.replace("3.2", '"3,2"'), "'3,2', a decimal comma"),
    "steps out of order": (HEADER + "1,1.0,A,3,0,0,9\n0,0.0,A,3,0,0,9\n", "line 3"),
    "times that stand still": (HEADER + "0,1.0,A,3,0,0,9\n1,1.0,A,3,0,0,9\n", "time_s"),
    "unknown anchor": (ROWS.replace("B", "Z"), "'Z'"),
    "NaN": (ROWS.replace("1.0,", "nan,"), "time_s"),
    "infinity": (ROWS.replace("3.2", "inf"), "line 3: distance_m"),
    "text": (ROWS.replace("3.2", "far"), "'far'"),
    "short row": (ROWS + "2,2.0,A\n", "line 4"),
    "negative distance": (ROWS.replace("3.2", "-3.2"), "distance_m"),
}


def test_all_headers_that_are_not_known_are_told_at_once(say, tmp_path):
    (tmp_path / "bad.csv").write_text(ROWS.replace("time_s", "t_unix").replace("anchor", "anchr"))
    result = say("check", "bad.csv")
    assert result.code == 2
    assert [line.partition("; ")[2] for line in result.complaints] == [
        "allowed: time_s, in seconds (rename it)",
        "allowed: anchor (nearest known)",
    ]


def test_utf_16_is_told_by_its_name(say, tmp_path):
    (tmp_path / "bad.csv").write_text(ROWS, encoding="utf-16")
    result = say("check", "bad.csv")
    assert result.complaints == ["error: bad.csv: found UTF-16 text; allowed: UTF-8: save it as CSV UTF-8"]


@pytest.mark.parametrize("fault", ["steps out of order", "times that stand still", "negative distance"])
def test_a_table_that_is_refused_is_not_accused_of_more(say, tmp_path, fault):
    """Amplitudes of 9 beside distances of 3 m were, against the scene, before the one error line."""
    (tmp_path / "bad.csv").write_text(CSV_FAULTS[fault][0])
    (tmp_path / "long.csv").write_text(
        HEADER
        + "".join(f"{k},{k}.0,{a},3,0,0,0.001\n" for k in range(40) for a in "AB")
        + "39,2.0,A,3,0,0,9\n"
    )
    for name in ("bad.csv", "long.csv"):
        result = say("check", name, "--scene", "room")
        assert (result.code, len(result.complaints), "suspect" in result.out) == (2, 1, False)


@pytest.mark.parametrize("fault", CSV_FAULTS)
def test_faulty_csv(say, tmp_path, fault):
    content, word = CSV_FAULTS[fault]
    (tmp_path / "bad.csv").write_text(content)
    result = say("run", "room", "--measurements", "bad.csv", "-o", "out")
    refused(result, tmp_path, ["bad.csv"], "bad.csv", word)


def damaged(folder, mapped):
    """Files that aren't what they should be, by name."""
    scene, run = mapped
    measurements = gs.simulate(scene, "agent1", 1)
    measurements.to_h5(folder / "heard.h5")
    run.map.save(folder / "map.h5")
    for name in ("heard", "map"):
        whole = (folder / f"{name}.h5").read_bytes()
        (folder / f"{name}-cut.h5").write_bytes(whole[: len(whole) // 2])
    with h5py.File(folder / "foreign.h5", "w") as file:
        file["x"] = np.arange(3)
    (folder / "text.h5").write_text("not HDF5")
    (folder / "empty.h5").write_text("")
    moved = scene.model_dump(exclude_none=True)
    moved["anchors"][1]["position_m"] = (2.0, -2.0)
    other = gs.Scene.checked(moved, "moved")
    gs.simulate(other, "agent1", 1).to_h5(folder / "moved.h5")
    (folder / "track.tum").write_text("0 0 0 0 0 0 0 1\n1 0.1 0 0 0 0 0 1\n")
    (folder / "broken.tum").write_text("0 0 0 0\n")


FILE_FAULTS = [
    (("run", "room", "--measurements", "heard-cut.h5"), "heard-cut.h5"),
    (("run", "room", "--measurements", "foreign.h5"), "foreign.h5: format"),
    (("run", "room", "--measurements", "text.h5"), "text.h5"),
    (("run", "room", "--measurements", "empty.h5"), "empty.h5"),
    (("run", "room", "--measurements", "map.h5"), "gridslam-measurements"),
    (("run", "room", "--measurements", "missing.csv"), "missing.csv"),
    (("run", "room", "--measurements", "moved.h5"), "anchor 'B' at [2.0, -2.0] m"),
    (("run", "canyon", "--measurements", "heard.h5"), "A, B, C"),
    (("run", "--measurements", "heard.h5"), "SCENE: found none, with heard.h5"),
    (("run", "room", "--measurements", "heard.h5", "--truth", "track.tum"), "0 to 3 s"),
    (("run", "room", "--measurements", "heard.h5", "--truth", "broken.tum"), "line 1"),
    (("run", "room", "--measurements", "heard.h5", "--truth", "missing.tum"), "missing.tum"),
    (("run", "room", "--truth", "track.tum"), "--measurements"),
    (("run", "canyon", "--agent", "agent1", "--agent", "agent2", "--measurements", "heard.h5"), "one agent"),
    (("run", "room", "--map", "map-cut.h5"), "map-cut.h5"),
    (("run", "room", "--map", "foreign.h5"), "foreign.h5: format"),
    (("run", "room", "--map", "empty.h5"), "empty.h5"),
    (("run", "room", "--map", "heard.h5"), "gridslam-map"),
    (("run", "room", "--map", "missing.h5"), "missing.h5"),
    (("run", "canyon", "--map", "map.h5"), "map.h5: frame: found anchor 'A' at (-3.1, 2.2) m"),
    (("export", "map-cut.h5", "-o", "out"), "map-cut.h5"),
    (("export", "missing.h5", "-o", "out"), "missing.h5"),
    (("export", "map.h5", "-o", "text.h5"), "text.h5"),
    (("check", "foreign.h5"), "foreign.h5"),
    (("check", "text.h5"), "text.h5"),
    (("check", "heard-cut.h5"), "heard-cut.h5"),
    (("check", "missing.h5"), "missing.h5"),
    (("check", "."), "run.json"),
    (("plot", "."), "run.json"),
    (("simulate", "room", "-o", "heard.mat"), "heard.mat"),
    (("simulate", "room", "-o", "no/such/heard.csv"), "heard.csv"),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "word"), FILE_FAULTS, ids=lambda w: w if isinstance(w, str) else " ".join(w)
)
def test_faulty_file(say, tmp_path, mapped, words, word):
    damaged(tmp_path, mapped)
    refused(say(*words), tmp_path, listing(tmp_path), word)


@pytest.mark.parametrize(
    ("origin", "cell", "shape", "word"),
    [
        ((100.2, 100.2), 0.1, (10, 10), "bad.h5: extent"),
        ((100.23, 100.2), 0.07, (10, 10), "bad.h5: extent"),
    ],
)
def test_map_that_fits_no_cell_of_the_scene(say, tmp_path, origin, cell, shape, word):
    gs.Map.blank(origin, cell, shape, 0.01).save(tmp_path / "bad.h5")
    refused(say("run", "room", "--map", "bad.h5", "--same-frame"), tmp_path, ["bad.h5"], word)


OPTION_FAULTS = [
    (
        ("run", "room", "--measurements", "a.csv", "--measurements=b.csv"),
        "--measurements: found 2 files for 0 --agents",
    ),
    (("run", "room", "--truth", "a.tum", "--map", "a.h5", "--map=b.h5"), "--map: found 2 values"),
    (("simulate", "room", "-o", "a.csv", "--output", "b.csv"), "--output: found 2 values"),
    (("scene", "new", "-o", "a.toml", "-o", "b.toml"), "--output: found 2 values"),
    (("run", "nowhere"), "canyon"),
    (("run", "missing.toml"), "missing.toml"),
    (("run", "room", "--agent", "nobody"), "agent1"),
    (("run", "room", "--agent", "agent1", "--agent", "agent1"), "each agent once"),
    (("run", "room", "--method", "gird"), "grid (nearest known)"),
    (("run", "room", "--method", "gird"), "; all: grid, adaptive, va, "),
    (("run", "room", "--particles", "0"), "--particles"),
    (("run", "heard.csv"), "--measurements heard.csv"),
    (("export", "nowhere", "-o", "out"), "a run's folder"),
    (("run", "room", "--particles", "many"), "--particles"),
    (("run", "room", "--seed", "-1"), "--seed"),
    (("run", "room", "--threads", "0"), "--threads"),
    (("run", "room", "--device", "abacus"), "abacus"),
    (("run", "room", "--particle", "3"), "--particle"),
    (("run", "room", "extra"), "extra"),
    (("simulate", "room"), "--output"),
    (("simulate", "room", "--agent", "nobody", "-o", "a.csv"), "agent1"),
    (("fly",), "fly"),
]


@pytest.mark.parametrize(
    ("words", "word"), OPTION_FAULTS, ids=lambda w: w if isinstance(w, str) else " ".join(w)
)
def test_faulty_option(say, tmp_path, words, word):
    refused(say(*words), tmp_path, [], word)


def test_scene_without_agents(say, tmp_path):
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    data["agents"] = []
    (tmp_path / "none.toml").write_text(gs.Scene.checked(data, "none").to_toml())
    for words in (("run", "none.toml"), ("simulate", "none.toml", "-o", "a.csv")):
        refused(say(*words), tmp_path, ["none.toml"], "agents")


def test_a_scene_is_called_by_its_file_not_by_the_name_in_it(say, tmp_path):
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    data |= {"name": "lab", "walls": []}
    for agent in data["agents"]:
        del agent["waypoints_m"]
    (tmp_path / "bare.toml").write_text(gs.Scene.checked(data, "bare").to_toml())
    for words in (
        ("run", "bare.toml"),
        ("run", "bare.toml", "--agent", "x"),
        ("simulate", "bare.toml", "-o", "a.csv"),
    ):
        assert say(*words).err.startswith("error: bare.toml: ")


def test_a_run_that_is_finished_is_not_gone_on_with(say, tmp_path):
    (tmp_path / "done").mkdir()
    (tmp_path / "done" / "run.json").write_text("{}")
    refused(say("run", "--resume", "done"), tmp_path, listing(tmp_path), "finished")


def test_output_that_cannot_be_written_is_refused_before_the_run(say, short_room, tmp_path, monkeypatch):
    Path("file").write_text("x")
    Path("thesis").mkdir()
    Path("thesis/main.tex").write_text("x")
    monkeypatch.setattr(GridSlam, "step", None)  # it would be a TypeError, not one line
    for words in (("file/out",), ("file",), ("thesis",), ("thesis", "--overwrite"), ("file", "--overwrite")):
        refused(say("run", short_room, "-o", *words), tmp_path, listing(tmp_path), words[0])
    if sys.platform == "linux":
        refused(say("run", short_room, "-o", "/proc/out"), tmp_path, listing(tmp_path), "/proc/out")
    if hasattr(os, "geteuid") and os.geteuid() != 0:
        Path("locked").mkdir(mode=0o500)
        refused(say("run", short_room, "-o", "locked/out"), tmp_path, listing(tmp_path), "Permission denied")


def test_no_command_shows_the_help(say):
    result = say()
    assert "simulate" in result.out
    assert result.err == ""


def test_line_break_in_a_name_makes_no_second_line(say, tmp_path):
    refused(say("check", "two\nlines.toml"), tmp_path, [], "two lines.toml")
