"""`check` reads all that the project writes, and says of damaged files what is wrong with them."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from feature_samples import learned
from tiny import TINY

import gridslam as gs
from gridslam.runs.clock_track import ClockTrack
from gridslam.runs.network_files import write_clocks, write_csv
from gridslam.runs.parts import INDEX, UNFINISHED


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run's folder and an export of its map."""
    import sys

    from gridslam.cli.main import main

    folder = tmp_path_factory.mktemp("made")
    (folder / "tiny.toml").write_text(TINY)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("gridslam.viewers.plots.draw_all", lambda folder, run=None: [])
        for words in (["run", "tiny.toml", "-o", "out"], ["simulate", "tiny.toml", "-o", "heard.csv"]):
            patch.setattr(sys, "argv", ["gridslam", *words])
            with pytest.raises(SystemExit) as stop:
                main()
            assert stop.value.code == 0
    return folder


@pytest.mark.parametrize(
    ("name", "described"),
    [
        ("out", "run of tiny by grid: agent1 (3 steps, "),
        ("out/run.json", "run of tiny by grid: agent1 (3 steps, "),
        ("out/scene.toml", "scene tiny: 2 anchors, 1 wall of 4 pieces, 2 agents"),
        ("out/map.h5", "map by agent1, agent2: 48 x 38 cells of 0.2 m"),
        ("out/map.yaml", "nav2 map: 48 x 38 cells of 0.2 m, lower left corner at -4.8, -3.8 m; "),
        ("out/map.pgm", "nav2 map: 48 x 38 cells of 0.2 m, "),
        ("out/reflection.yaml", "percents in "),
        ("out/agent1/steps.h5", "estimates over 3 steps (steps 0 to 2, 0 to 2 s): at the end "),
        ("out/agent1/trajectory.tum", "track: 3 poses, 0 to 2 s, "),
        ("out/agent2/truth.tum", "track: 2 poses, 0 to 1 s, "),
        ("out/agent1/measurements.h5", "measurements"),
        ("heard.csv", "measurements"),
        ("room", "scene room: 2 anchors, 1 wall of 4 pieces, "),
    ],
)
@pytest.mark.slow
def test_every_file_of_a_run_is_told(say, made, name, described):
    result = say("check", made / name if name != "room" else name)
    assert (result.code, result.err) == (0, "")
    assert described in result.out


def test_a_run_that_was_cut_short_says_so(say, made, tmp_path):
    short = shutil.copytree(made / "out", tmp_path / "short")
    summary = json.loads((short / "run.json").read_text())
    summary["agents"]["agent1"]["interrupted"] = True
    (short / "run.json").write_text(json.dumps(summary))
    assert "agent1 (cut short, 3 of 3 steps, " in say("check", short).out


@pytest.mark.parametrize("command", ["check", "report"])
def test_an_unfinished_run_is_no_missing_file(say, tmp_path, command):
    rest = tmp_path / ".out.7.part" / UNFINISHED
    rest.mkdir(parents=True)
    (rest / INDEX).write_text("{}")
    result = say(command, tmp_path / "out")
    assert result.code == 2
    assert result.err.endswith(f"to go on with it (gridslam run --resume {tmp_path / 'out'})\n")


def test_scene_tells_where_no_anchor_is_in_sight(say):
    result = say("check", "hall")
    sights = "an anchor in sight at 91% of them (A 51%, B 65%), at none from step 100 to 139"
    assert f"agent1: 450 steps, {sights}" in result.out
    assert repr(gs.Scene.load("hall")) == "<Scene hall: 2 anchors, 5 walls, 1 agent>"


@pytest.mark.slow
def test_every_file_that_a_run_leaves_can_be_checked(say, made):
    for path in (made / "out").rglob("*.*"):
        assert say("check", path).code == 0, path


@pytest.mark.slow
def test_tables_pictures_and_plans_of_an_export_can_be_checked(say, made):
    assert say("export", made / "out" / "map.h5", "-o", "there").code == 0
    results = {path.name: say("check", path) for path in Path("there").iterdir()}
    assert {result.code for result in results.values()} == {0}, results
    assert "table of observed cells of a map: " in results["cells.csv"].out
    assert "table of surfaces of a map: " in results["surfaces.csv"].out
    assert "GeoJSON: " in results["surfaces.geojson"].out
    whole = say("check", "there")
    assert (whole.code, whole.out.splitlines()[0]) == (0, "export of a map:")
    assert {line.split(": ")[0] for line in whole.out.splitlines()} >= {
        "map.yaml",
        "cells.csv",
        "surfaces.geojson",
    }
    with Path("there/cells.csv").open("a") as file:
        file.write("1,2\n")
    result = say("check", "there/cells.csv")
    assert (result.code, len(result.complaints)) == (2, 1)
    assert "found 2 cells; allowed: 5, as the header" in result.err
    assert say("check", "there").err == result.err
    Path("there/map.pgm").unlink()
    result = say("check", "there")
    assert (result.code, len(result.complaints)) == (2, 1)
    assert "map.pgm" in result.err


@pytest.mark.parametrize("name", ["features.csv", "unexplained.csv"])
def test_places_of_paths_can_be_checked(say, name):
    grid = replace(gs.Map.blank([0.0, 0.0], 0.5, (4, 4), 0.05), features=learned([[1.0, 2.0]]))
    grid.to_csv(".")
    if name != "features.csv":  # as an export calls them where a method learns none
        Path("features.csv").rename(name)
    result = say("check", name)
    assert (result.code, result.out.strip()) == (0, "table of features of a map: 1 row")


def test_checkpoint_is_told(say):
    slam = gs.GridSlam(gs.Scene.from_toml(TINY, "tiny"))
    slam.save("state.h5")
    result = say("check", "state.h5")
    assert (result.code, result.out) == (0, "checkpoint of grid in tiny, after 0 steps of agent1\n")


def test_clocks_are_told(say):
    time = np.array([0.0, 1.0])
    offsets = np.array([[0.0, 0.0], [1e-9, 3e-9]])
    spread = np.zeros((2, 2, 2))
    track = ClockTrack(("A", "me"), 1, np.arange(2), time, offsets, spread, np.zeros((2, 1), bool))
    write_clocks("clocks.h5", track)
    write_csv("clocks.csv", track)
    line = "offsets of 2 clocks (A, me) over 2 steps: at the end 2 ns (0.6 m) apart\n"
    assert say("check", "clocks.h5").out == line
    assert say("check", "clocks.csv").out == "table of offsets of clocks: 4 rows\n"


@pytest.mark.parametrize("content", ["{", "[1]", '{"format": "other"}'])
def test_other_json_is_refused_in_one_line(say, content):
    Path("other.json").write_text(content)
    result = say("check", "other.json")
    assert (result.code, len(result.complaints)) == (2, 1)
    assert "allowed: GeoJSON, a run.json or what bench --json wrote" in result.err


def test_study_is_told(say, made):
    Path("study").mkdir()
    head, run = '{"format": "gridslam-study", "agents": []}', '{"key": {}, "agents": {}}'
    Path("study/study.jsonl").write_text("\n".join([head, run, run, ""]))
    for path in ("study", "study/study.jsonl"):
        assert "study: 2 finished runs" in say("check", path).out
    Path("study/study.jsonl").write_text("{")
    assert say("check", "study").code == 2


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("map.pgm", lambda content: content[:-1]),
        ("map.pgm", lambda content: b"P2" + content[2:]),
        ("map.pgm", lambda content: b"P5 99999999 1 255\n0"),
        ("map.yaml", lambda content: content.replace(b"resolution: 0.2", b"resolution: wide")),
        ("map.yaml", lambda content: content.replace(b"origin", b"begin")),
        ("map.yaml", lambda content: b"\xff" + content),
        ("agent1/steps.h5", lambda content: content[: len(content) // 2]),
        ("agent1/trajectory.tum", lambda content: b"1 2 3\n"),
    ],
)
def test_damaged_file_is_refused_in_one_line(say, made, name, spoil):
    for other in ("map.yaml", "map.pgm", name):
        Path(other).parent.mkdir(exist_ok=True)
        Path(other).write_bytes((made / "out" / other).read_bytes())
    spoilt = spoil(Path(name).read_bytes())
    assert spoilt != Path(name).read_bytes()
    Path(name).write_bytes(spoilt)
    result = say("check", name)
    assert (result.code, len(result.complaints)) == (2, 1), result


@pytest.mark.slow
@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"# Read me\n", "nothing that gridslam reads"),
        (b"\x89HDF\r\n\x1a\n" + bytes(40), "HDF5 that is damaged or cut short"),
        (bytes(1024) + b"\x89HDF\r\n\x1a\n" + bytes(40), "HDF5 that is damaged or cut short"),
        (bytes(1000) + b"\x89HDF\r\n\x1a\n" + bytes(40), "nothing that gridslam reads"),
    ],
)
def test_other_content_is_called_what_it_is(say, tmp_path, content, says):
    (tmp_path / "README.md").write_bytes(content)
    result = say("check", tmp_path / "README.md")
    assert (result.code, len(result.complaints)) == (2, 1)
    assert says in result.err


def test_scene_isnt_called_a_damaged_map(say, tmp_path):
    (tmp_path / "walk.toml").write_text('name = "walk"\n')
    said = say("export", "walk.toml", "-o", "robot")
    assert (said.code, said.complaints) == (
        2, ["error: walk.toml: found a .toml file without HDF5 in it; allowed: a gridslam-map file (.h5)"],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "start"), [("a.png", b"\x89PNG\r\n"), ("report.html", b"<!doctype html>\n<html>")]
)
def test_pictures_and_pages_are_nothing_to_check_and_others_of_that_name_are_refused(
    say, tmp_path, name, start
):
    (tmp_path / name).write_bytes(start + bytes(20))
    result = say("check", tmp_path / name)
    assert result.code == 0
    assert "nothing in it to check" in result.out
    (tmp_path / name).write_bytes(b"step,time_s")
    result = say("check", tmp_path / name)
    assert (result.code, len(result.complaints)) == (2, 1)
    assert "another content than its name says" in result.err
