"""The command line: what it does, and what it says of bad input."""

import errno
import importlib
import json
import os
import signal
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs
from gridslam.systems.grid import GridSlam

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

HEADER = "step,time_s,anchor,distance_m,aod_rad,aoa_rad,amplitude\n"
ROWS = HEADER + "0,0.0,A,3.1,0.1,0.2,9.0\n1,1.0,B,3.2,0.1,0.2,9.0\n"


@pytest.fixture(scope="module")
def mapped():
    scene = shortened(gs.Scene.load("room"), 4)
    return scene, gs.map_scene(scene, gs.simulate(scene, "agent1", 1), seed=1)


def listing(folder):
    return sorted(str(path.relative_to(folder)) for path in Path(folder).rglob("*"))


# ---- what it does -----------------------------------------------------------------------------------


def test_two_agents_in_turn_leave_a_whole_folder(say, short_room, tmp_path):
    said = say("run", short_room, "-o", "out", "--seed", "3", "--particles", "500")
    assert (said.code, said.err) == (0, "")
    assert "agent2" in said.out
    assert "bound" in said.out
    assert "wrote out" in said.out
    found = listing(tmp_path / "out")
    titles = ("map", "reflection", "rays", "errors")
    assert {f"figures/{a}-{t}.png" for a in ("agent1", "agent2") for t in titles} <= set(found)
    summary = json.loads(Path("out/run.json").read_text())
    assert (summary["particles"], summary["seed"]) == (500, 3)
    assert "particles = 500" in Path("out/scene.toml").read_text()
    for score in summary["agents"].values():
        assert 0 < score["position_bound_m"] < 0.1
        assert 0 < score["heading_bound_deg"] < 10
        assert score["surfaces_true"] == 4
    assert gs.Map.load("out/map.h5").provenance["agents"] == ["agent1", "agent2"]


def test_recorded_measurements_and_a_tum_track_score_like_the_simulation(say, short_room, no_figures):
    assert say("run", short_room, "--agent", "agent1", "-o", "whole").code == 0
    assert say("simulate", short_room, "--agent", "agent1", "-o", "heard.csv").code == 0
    said = say(
        "run", short_room, "--measurements", "heard.csv", "--truth", "whole/agent1/truth.tum", "-o", "again"
    )
    assert said.code == 0, said.err
    one, two = (json.loads(Path(n, "run.json").read_text())["agents"]["agent1"] for n in ("whole", "again"))
    for name in ("position_rmse_m", "position_bound_m", "heading_rmse_deg", "heading_bound_deg"):
        assert two[name] == pytest.approx(one[name], rel=1e-6)
    assert two["map"] == one["map"]
    said = say("run", short_room, "--measurements", "heard.csv", "-o", "blind")
    assert said.code == 0
    blind = json.loads(Path("blind/run.json").read_text())["agents"]["agent1"]
    assert blind["position_rmse_m"] is None
    assert blind["surfaces_detected"] == one["surfaces_detected"]


def test_without_walls_the_track_is_scored_and_the_map_is_not(say, tmp_path):
    scene = shortened(gs.Scene.load("room"), 4)
    gs.simulate(scene, "agent1", 1).to_h5(tmp_path / "heard.h5")
    data = scene.model_dump(exclude_none=True)
    data["walls"], data["agents"][0]["waypoints_m"] = (), None
    data["agents"][0].pop("steps")
    bare = gs.Scene.checked({**data, "agents": [{k: v for k, v in data["agents"][0].items() if v}]}, "bare")
    (tmp_path / "bare.toml").write_text(bare.to_toml())
    said = say("run", "bare.toml", "--measurements", "heard.h5", "-o", "out")
    assert said.code == 0, said.err
    score = json.loads(Path("out/run.json").read_text())["agents"]["agent1"]
    assert score["position_rmse_m"] < 0.5
    assert score["position_bound_m"] is None
    assert score["surfaces_true"] is None
    assert set(score["map"].values()) == {None}
    assert Path("out/figures/agent1-errors.png").exists()


def test_map_of_other_cells_is_resampled_and_said(say, short_room, no_figures, mapped):
    _, run = mapped
    run.map.resample(run.map.origin_m, 0.2, (38, 48)).save("coarse.h5")
    said = say("run", short_room, "--agent", "agent2", "--map", "coarse.h5", "-o", "out")
    assert said.code == 0
    assert said.complaints == [
        "note: coarse.h5: 48 x 38 cells of 0.2 m resampled to the scene's 96 x 76 cells of 0.1 m"
    ]
    assert gs.Map.load("out/map.h5").cell_m == 0.1
    assert say("run", short_room, "--agent", "agent2", "--map", "out/map.h5", "-o", "next").err == ""


def test_later_agents_are_judged_by_the_tracks_of_all_so_far(say, short_room, no_figures, monkeypatch):
    seen = []
    whole = gs.Run.score
    monkeypatch.setattr(
        gs.Run, "score", lambda run, *truths: seen.append((run.agent, *truths)) or whole(run, *truths)
    )
    assert say("run", short_room, "-o", "both").code == 0
    assert say("run", short_room, "--agent", "agent2", "--map", "both/agent1/map.h5", "-o", "on").code == 0
    assert [name for name, *_ in seen] == ["agent1", "agent2", "agent2"]
    (_, first, none), (_, own, earlier), (_, _, inherited) = seen
    assert none == []
    for others in (earlier, inherited):
        assert len(others) == 1
        np.testing.assert_array_equal(others[0].paths.points, first.paths.points)
    assert len(own.paths) > 0


def test_export_writes_nav2_pictures_and_tables(say, mapped, tmp_path):
    mapped[1].map.save(tmp_path / "map.h5")
    Path("robot").mkdir()
    Path("robot/keep.txt").write_text("x")
    said = say("export", "map.h5", "-o", "robot")
    assert said.code == 0
    assert set(os.listdir("robot")) == {
        "keep.txt", "map.yaml", "map.pgm", "reflection.yaml", "reflection.pgm",
        "occupancy.png", "reflection.png", "cells.csv", "surfaces.csv", "surfaces.geojson",
    }  # fmt: skip
    for name in ("occupancy", "reflection"):
        assert Path(f"robot/{name}.png").read_bytes().startswith(b"\x89PNG")
    assert len(Path("robot/surfaces.csv").read_text().splitlines()) == 1 + len(mapped[1].map.surfaces)
    assert listing(tmp_path) == sorted(["map.h5", "robot", *(f"robot/{n}" for n in os.listdir("robot"))])


def test_check_says_what_a_file_is(say, mapped, tmp_path):
    scene, run = mapped
    run.map.save(tmp_path / "map.h5")
    (tmp_path / "scene.toml").write_text(scene.to_toml())
    heard = gs.simulate(scene, "agent1", 1)
    heard.to_h5(tmp_path / "heard.h5")
    heard.to_csv(tmp_path / "heard.csv")
    words = {
        "map.h5": ("map by agent1", "96 x 76", f"{len(run.map.surfaces)} surfaces"),
        "scene.toml": ("scene room", "2 anchors", "96 x 76"),
        "heard.h5": ("4 steps", "anchors A, B", "true track"),
        "heard.csv": ("4 steps", "anchors A, B"),
    }
    for name, expected in words.items():
        said = say("check", name)
        assert (said.code, said.err) == (0, "")
        assert len(said.out.strip().splitlines()) == 1 or name.startswith("heard")
        for word in expected:
            assert word in said.out


def test_scenes_are_listed_one_per_line(say):
    said = say("scenes")
    assert [line.split(":")[0] for line in said.out.strip().splitlines()] == gs.bundled_scenes()


def test_simulate_writes_one_file_per_agent(say, short_room, tmp_path):
    assert say("simulate", short_room, "--agent", "agent1", "--agent", "agent2", "-o", "heard.h5").code == 0
    assert listing(tmp_path) == ["heard-agent1.h5", "heard-agent2.h5", "short.toml"]


# ---- Ctrl-C and full disks --------------------------------------------------------------------------


def interrupted_at(monkeypatch, agent, step, stop):
    """Make `stop` happen in the middle of a step."""
    whole = GridSlam.step

    def cut(slam, scan):
        if (slam.agent, scan.step) == (agent, step):
            stop()
        return whole(slam, scan)

    monkeypatch.setattr(GridSlam, "step", cut)


def test_ctrl_c_finishes_the_step_and_keeps_what_was_done(
    say, short_room, no_figures, ctrl_c, monkeypatch, tmp_path
):
    interrupted_at(monkeypatch, "agent1", 2, lambda: signal.raise_signal(signal.SIGINT))
    said = say("run", short_room, "-o", "out")
    assert said.code == 130
    assert said.complaints == ["interrupted after 3 of 5 steps of agent1: out holds what was done"]
    summary = json.loads(Path("out/run.json").read_text())
    assert list(summary["agents"]) == ["agent1"]
    assert (summary["agents"]["agent1"]["steps"], summary["agents"]["agent1"]["interrupted"]) == (3, True)
    assert len(gs.Trajectory.from_tum("out/agent1/trajectory.tum")) == 3
    assert gs.Map.load("out/map.h5").observed.any()
    assert listing(tmp_path)[0] == "out"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_impatient_ctrl_c_loses_the_agent_on_its_way_alone(say, short_room, no_figures, ctrl_c, monkeypatch):
    def twice():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    interrupted_at(monkeypatch, "agent2", 1, twice)
    said = say("run", short_room, "-o", "out")
    assert said.code == 130
    assert said.complaints == ["interrupted after 5 of 5 steps of agent1: out holds what was done"]
    assert list(json.loads(Path("out/run.json").read_text())["agents"]) == ["agent1"]


def test_ctrl_c_while_nothing_is_done_leaves_nothing(say, short_room, monkeypatch, tmp_path):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("gridslam.simulate"), "true_paths", stop)
    said = say("run", short_room, "-o", "out")
    assert (said.code, said.complaints) == (130, ["interrupted"])
    assert listing(tmp_path) == ["short.toml"]


def test_ctrl_c_while_drawing_keeps_the_run(say, short_room, monkeypatch):
    def stop(folder):
        raise KeyboardInterrupt

    monkeypatch.setattr("gridslam.plots.draw_all", stop)
    said = say("run", short_room, "--agent", "agent1", "-o", "out")
    assert said.code == 130
    assert "out holds what was done" in said.err
    assert gs.Map.load("out/map.h5").observed.any()


@pytest.mark.parametrize(
    "words",
    [
        ("run", "short.toml", "--agent", "agent1", "-o", "out"),
        ("simulate", "short.toml", "-o", "heard.csv"),
        ("simulate", "short.toml", "-o", "heard.h5"),
        ("export", "map.h5", "-o", "out"),
    ],
)
def test_full_disk_is_one_line_and_nothing_half_written(
    say, short_room, no_figures, mapped, monkeypatch, tmp_path, words
):
    mapped[1].map.save(tmp_path / "map.h5")
    before = listing(tmp_path)

    def full(path, content):
        with open(path, "wb") as file:
            file.write(content[:10])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    said = say(*words)
    assert said.code == 2
    assert len(said.complaints) == 1
    assert "No space left on device" in said.err
    assert words[-1] in said.err
    assert listing(tmp_path) == before


def test_disk_full_at_the_figures_keeps_the_rest(say, short_room, monkeypatch):
    def full(path, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("gridslam.plots.write_bytes", full)
    said = say("run", short_room, "--agent", "agent1", "-o", "out")
    assert said.code == 2
    assert len(said.complaints) == 1
    assert "out/figures: found No space left on device" in said.err
    assert gs.Map.load("out/map.h5").observed.any()
    assert not Path("out/figures").exists()


# ---- bad input --------------------------------------------------------------------------------------


def refused(said, tmp_path, before, *words):
    assert said.code == 2, said
    assert len(said.complaints) == 1, said.err
    assert said.complaints[0].startswith("error: ")
    assert "Traceback" not in said.err + said.out
    for word in words:
        assert word in said.err
    assert listing(tmp_path) == before


def change(text, old, new):
    assert old in text
    return text.replace(old, new, 1)


SCENE_FAULTS = {
    "unknown key": ("[radio]", "[radio]\ncolour = 3", "radio.colour"),
    "misspelt key": ("bandwidth_hz", "bandwith_hz", "bandwidth_hz (nearest known)"),
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
    old, new, said = SCENE_FAULTS[fault]
    if fault == "zero-length wall":
        start = text.index("points_m")
        text = text[:start] + "points_m = [[-4.0, -3.0], [4.0, -3.0]]\n" + text[text.index("closed") :]
    (tmp_path / "bad.toml").write_text(change(text, old, new))
    refused(say(command[0], "bad.toml", *command[1:]), tmp_path, ["bad.toml"], "bad.toml", said)


@pytest.mark.parametrize(
    ("content", "word"),
    [(b"", "grid"), (b"[grid]\nx_m=[0.0,1.0]\ny_m=[0.0,1.0]\n", "anchors"), (b"\xff\xfe", "UTF-8")],
)
def test_empty_scene(say, tmp_path, content, word):
    (tmp_path / "bad.toml").write_bytes(content)
    refused(say("run", "bad.toml"), tmp_path, ["bad.toml"], word)


CSV_FAULTS = {
    "empty": ("", "empty file"),
    "no rows": (HEADER, "no rows"),
    "missing column": (ROWS.replace("time_s,", ""), "no column 'time_s'"),
    "unknown column": (ROWS.replace("distance_m", "distance"), "distance_m (nearest known)"),
    "steps out of order": (HEADER + "1,1.0,A,3,0,0,9\n0,0.0,A,3,0,0,9\n", "line 3"),
    "times that stand still": (HEADER + "0,1.0,A,3,0,0,9\n1,1.0,A,3,0,0,9\n", "time_s"),
    "unknown anchor": (ROWS.replace("B", "Z"), "'Z'"),
    "NaN": (ROWS.replace("3.2", "nan"), "line 3: distance_m"),
    "infinity": (ROWS.replace("3.2", "inf"), "line 3: distance_m"),
    "text": (ROWS.replace("3.2", "far"), "'far'"),
    "short row": (ROWS + "2,2.0,A\n", "line 4"),
    "negative distance": (ROWS.replace("3.2", "-3.2"), "distance_m"),
}


@pytest.mark.parametrize("fault", CSV_FAULTS)
def test_faulty_csv(say, tmp_path, fault):
    content, word = CSV_FAULTS[fault]
    (tmp_path / "bad.csv").write_text(content)
    said = say("run", "room", "--measurements", "bad.csv", "-o", "out")
    refused(said, tmp_path, ["bad.csv"], "bad.csv", word)


def damaged(folder, mapped):
    """Files that aren't what they should be, by name."""
    scene, run = mapped
    heard = gs.simulate(scene, "agent1", 1)
    heard.to_h5(folder / "heard.h5")
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


@pytest.mark.parametrize(
    ("words", "word"), FILE_FAULTS, ids=lambda w: w if isinstance(w, str) else " ".join(w)
)
def test_faulty_file(say, tmp_path, mapped, words, word):
    damaged(tmp_path, mapped)
    refused(say(*words), tmp_path, listing(tmp_path), word)


@pytest.mark.parametrize(
    ("origin", "cell", "shape", "word"),
    [
        ((-4.8, -3.8), 0.07, (109, 138), "bad.h5: cell_m"),
        ((-4.83, -3.8), 0.1, (76, 96), "bad.h5: origin_m"),
        ((100.2, 100.2), 0.1, (10, 10), "bad.h5: extent"),
    ],
)
def test_map_that_fits_no_cell_of_the_scene(say, tmp_path, origin, cell, shape, word):
    gs.Map.blank(origin, cell, shape, 0.01).save(tmp_path / "bad.h5")
    refused(say("run", "room", "--map", "bad.h5"), tmp_path, ["bad.h5"], word)


OPTION_FAULTS = [
    (("run", "nowhere"), "canyon"),
    (("run", "missing.toml"), "missing.toml"),
    (("run", "room", "--agent", "nobody"), "agent1"),
    (("run", "room", "--agent", "agent1", "--agent", "agent1"), "each agent once"),
    (("run", "room", "--method", "magic"), "grid"),
    (("run", "room", "--particles", "0"), "filter.particles"),
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
    said = say()
    assert "simulate" in said.out
    assert said.err == ""


def test_line_break_in_a_name_makes_no_second_line(say, tmp_path):
    refused(say("check", "two\nlines.toml"), tmp_path, [], "two lines.toml")
