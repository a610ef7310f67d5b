"""The command line: what it does, and what it says of bad input."""

import errno
import importlib
import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from cli_samples import listing
from scene_samples import shortened

import gridslam as gs
from gridslam.systems.grid import GridSlam

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

# ---- what it does -----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_two_agents_in_turn_leave_a_whole_folder(say, short_room, tmp_path):
    result = say("run", short_room, "-o", "out", "--seed", "3", "--particles", "500")
    assert (result.code, result.err) == (0, "")
    assert "agent2" in result.out
    assert "bound" in result.out
    assert "wrote out" in result.out
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


@pytest.mark.slow
def test_recorded_measurements_and_a_tum_track_score_like_the_simulation(say, short_room, no_figures):
    assert say("run", short_room, "--agent", "agent1", "--start", "exact", "-o", "whole").code == 0
    assert say("simulate", short_room, "--agent", "agent1", "-o", "heard.csv").code == 0
    result = say(
        "run", short_room, "--measurements", "heard.csv", "--truth", "whole/agent1/truth.tum", "-o", "again"
    )
    assert result.code == 0, result.err
    one, two = (json.loads(Path(n, "run.json").read_text())["agents"]["agent1"] for n in ("whole", "again"))
    for name in ("position_rmse_m", "position_bound_m", "heading_rmse_deg", "heading_bound_deg"):
        assert two[name] == pytest.approx(one[name], rel=1e-6)
    assert two["map"] == one["map"]
    result = say("run", short_room, "--measurements", "heard.csv", "-o", "blind")
    assert result.code == 0
    blind = json.loads(Path("blind/run.json").read_text())["agents"]["agent1"]
    assert blind["position_rmse_m"] is None
    assert blind["surfaces_detected"] == one["surfaces_detected"]


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_without_walls_the_track_is_scored_and_the_map_is_not(say, tmp_path):
    scene = shortened(gs.Scene.load("room"), 4)
    gs.simulate(scene, "agent1", 1).to_h5(tmp_path / "heard.h5")
    data = scene.model_dump(exclude_none=True)
    data["walls"], data["agents"][0]["waypoints_m"] = (), None
    data["agents"][0].pop("steps")
    bare = gs.Scene.checked({**data, "agents": [{k: v for k, v in data["agents"][0].items() if v}]}, "bare")
    (tmp_path / "bare.toml").write_text(bare.to_toml())
    result = say("run", "bare.toml", "--measurements", "heard.h5", "-o", "out")
    assert result.code == 0, result.err
    score = json.loads(Path("out/run.json").read_text())["agents"]["agent1"]
    assert score["position_rmse_m"] < 0.5
    assert score["position_bound_m"] is None
    assert score["surfaces_true"] is None
    assert set(score["map"].values()) == {None}
    assert Path("out/figures/agent1-errors.png").exists()


@pytest.mark.slow
def test_map_of_other_cells_is_resampled_and_said(say, short_room, no_figures, mapped):
    _, run = mapped
    run.map.resample(run.map.origin_m, 0.23, (34, 42)).save("coarse.h5")
    result = say("run", short_room, "--agent", "agent2", "--map", "coarse.h5", "-o", "out")
    assert result.code == 0
    assert result.complaints == [
        "note: coarse.h5: 42 x 34 cells of 0.23 m resampled to the scene's 96 x 76 cells of 0.1 m"
    ]
    assert gs.Map.load("out/map.h5").cell_m == 0.1
    again = ("run", short_room, "--agent", "agent2", "--seed", 1)
    assert say(*again, "--map", "out/map.h5", "-o", "next").err == ""


@pytest.mark.slow
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


@pytest.mark.slow
def test_export_of_a_map_without_free_cells_notes_that_no_planner_can_use_it(say):
    gs.Map.of_scene(gs.Scene.load("room")).save("blank.h5")
    result = say("export", "blank.h5", "-o", "robot")
    none = "no free cells, as of methods that map none or where too little is measured"
    assert (result.code, result.complaints) == (0, [f"note: blank.h5: {none}: no map for a planner"])


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_export_and_run_say_that_a_method_without_cells_draws_walls_where_they_were_hit(say):
    assert say("run", "room", "--steps", "12", "--method", "adaptive", "-o", "lines").code == 0
    notes = json.loads(Path("lines/run.json").read_text())["notes"]
    assert any("maps no cells: walls are drawn and exported where paths were" in note for note in notes)
    result = say("export", "lines", "-o", "robot")
    assert "; walls go as far as paths were reflected by them: no map" in " ".join(result.complaints)


@pytest.mark.slow
def test_export_writes_nav2_pictures_and_tables(say, mapped, tmp_path):
    mapped[1].map.save(tmp_path / "map.h5")
    Path("robot").mkdir()
    Path("robot/keep.txt").write_text("x")
    result = say("export", "map.h5", "-o", "robot")
    assert (result.code, result.complaints) == (0, [])
    assert set(os.listdir("robot")) == {
        "keep.txt", "map.yaml", "map.pgm", "map.png", "reflection.yaml", "reflection.pgm",
        "occupancy.png", "reflection.png", "cells.csv", "surfaces.csv", "surfaces.geojson",
    }  # fmt: skip
    for name in ("map", "occupancy", "reflection"):
        assert Path(f"robot/{name}.png").read_bytes().startswith(b"\x89PNG")
    rows = Path("robot/surfaces.csv").read_text().splitlines()[1:]
    assert {float(row.split(",")[0]) for row in rows} == set(mapped[1].map.surfaces.identity.tolist())
    before = sorted(["map.h5", "robot", *(f"robot/{n}" for n in os.listdir("robot"))])
    assert listing(tmp_path) == before
    result = say("export", "map.h5", "-o", "nav2.tif")
    assert (result.code, len(result.complaints)) == (2, 1)
    assert "the name of a folder" in result.err
    assert listing(tmp_path) == before


def test_check_says_what_a_file_is(say, mapped, tmp_path):
    scene, run = mapped
    run.map.save(tmp_path / "map.h5")
    (tmp_path / "scene.toml").write_text(scene.to_toml())
    measurements = gs.simulate(scene, "agent1", 1)
    measurements.to_h5(tmp_path / "heard.h5")
    measurements.to_csv(tmp_path / "heard.csv")
    words = {
        "map.h5": ("map by agent1", "96 x 76", f"{len(run.map.surfaces)} surfaces"),
        "scene.toml": ("scene room", "2 anchors", "96 x 76"),
        "heard.h5": ("4 steps", "anchors A, B", "true track"),
        "heard.csv": ("4 steps", "anchors A, B"),
    }
    for name, expected in words.items():
        result = say("check", name)
        assert (result.code, result.err) == (0, "")
        assert len(result.out.strip().splitlines()) == 1 or name != "map.h5"
        for word in expected:
            assert word in result.out


def test_scenes_are_listed_one_per_line(say):
    result = say("scenes")
    assert [line.split(":")[0] for line in result.out.strip().splitlines()] == gs.bundled_scenes()


def test_simulate_writes_one_file_for_all_agents(say, short_room, tmp_path):
    both = "--agent", "agent1", "--agent", "agent2"
    assert "(room, agent1, agent2, seed 0)\n" in say("simulate", short_room, *both, "-o", "heard.h5").out
    assert "  simulated: room, agent1, agent2, seed 0\n" in say("check", "heard.h5").out
    assert say("simulate", short_room, *both, "--unlabelled", "-o", "heard.csv").code == 0
    assert listing(tmp_path) == ["heard.csv", "heard.h5", "short.toml"]
    measurements = gs.NetworkMeasurements.from_h5(tmp_path / "heard.h5")
    assert measurements.agents == ("agent1", "agent2")
    assert (tmp_path / "heard.csv").read_text().splitlines()[1].startswith("0,0.0,agent1,,")


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
    result = say("run", short_room, "-o", "out")
    assert result.code == 130
    assert result.complaints == ["interrupted after 3 of 5 steps of agent1: out holds what was done"]
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
    result = say("run", short_room, "-o", "out")
    assert result.code == 130
    assert result.complaints == [
        "interrupted after all 5 steps of agent1, before the last of agent2: out holds what was done"
    ]
    assert list(json.loads(Path("out/run.json").read_text())["agents"]) == ["agent1"]


def test_ctrl_c_while_nothing_is_done_leaves_nothing(say, short_room, monkeypatch, tmp_path):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("gridslam.simulation.image_source"), "true_paths", stop)
    result = say("run", short_room, "-o", "out")
    assert (result.code, result.complaints) == (130, ["interrupted"])
    assert listing(tmp_path) == ["short.toml"]


def test_ctrl_c_while_drawing_keeps_the_run(say, short_room, monkeypatch):
    def stop(folder, run):
        raise KeyboardInterrupt

    monkeypatch.setattr("gridslam.viewers.plots.draw_all", stop)
    result = say("run", short_room, "--agent", "agent1", "-o", "out")
    assert result.code == 130
    assert result.complaints == [
        "interrupted in drawing, after the last step: out holds all but figures (gridslam plot out)"
    ]
    assert gs.Map.load("out/map.h5").observed.any()


def test_ctrl_c_while_scoring_keeps_the_run(say, short_room, no_figures, monkeypatch):
    """No step is missing, so none is counted: what is missing is named."""

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("gridslam.cli.run._scores", stop)
    result = say("run", short_room, "--agent", "agent1", "-o", "out")
    assert (result.code, result.complaints) == (
        130, ["interrupted in scoring, after the last step: out holds all but scores by the truth and notes"],
    )  # fmt: skip
    assert not json.loads(Path("out/run.json").read_text())["agents"]["agent1"]["interrupted"]


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
    result = say(*words)
    assert result.code == 2
    assert len(result.complaints) == 1
    assert "No space left on device" in result.err
    assert words[-1] in result.err
    assert listing(tmp_path) == before


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_disk_full_at_the_figures_keeps_the_rest(say, short_room, monkeypatch):
    write = Path.write_bytes

    def full(path, content):
        if path.suffix == ".png":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    result = say("run", short_room, "--agent", "agent1", "-o", "out")
    assert result.code == 2
    assert len(result.complaints) == 1
    assert "out/figures: found No space left on device" in result.err
    assert gs.Map.load("out/map.h5").observed.any()
    assert not Path("out/figures").exists()
