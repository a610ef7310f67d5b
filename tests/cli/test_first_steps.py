"""`run --steps`, scenes without walls, and what `run` says of tables that lost steps."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from interrupted_runs import prepared
from tiny import TINY

import gridslam as gs
from gridslam.measurements.first_steps import first_heard, first_of_scene

runs = pytest.mark.usefixtures("no_figures")


def scored(folder):
    return json.loads((Path(folder) / "run.json").read_text())["agents"]


@pytest.fixture
def tiny(say):
    return prepared(say)


@pytest.fixture
def open_air(say):
    """The same without walls."""
    data = gs.Scene.from_toml(TINY, "tiny").model_dump(exclude_none=True)
    Path("open.toml").write_text(gs.Scene.checked(data | {"walls": []}, "open").to_toml())
    return say


@pytest.mark.slow
@runs
def test_the_first_steps_of_each_agent_are_those_of_the_whole_run(tiny):
    for more, folder in (((), "whole"), (("--steps", 2), "part")):
        assert tiny("run", "tiny.toml", "--agent", "agent1", *more, "-o", folder).code == 0
    whole, part = (scored(folder)["agent1"] for folder in ("whole", "part"))
    assert (whole["steps"], part["steps"], part["interrupted"]) == (3, 2, False)
    assert part["position_bound_m"] is not None
    tracks = [np.loadtxt(f"{folder}/agent1/trajectory.tum") for folder in ("whole", "part")]
    np.testing.assert_allclose(tracks[0][:2], tracks[1], atol=1e-9)
    assert gs.Scene.load("part/scene.toml").agent("agent1").steps == 2
    assert tiny("run", "tiny.toml", "--steps", 50, "-o", "all").code == 0
    assert [one["steps"] for one in scored("all").values()] == [3, 2]


@runs
def test_the_first_steps_of_a_file_are_scored_against_theirs(tiny):
    assert tiny("simulate", "tiny.toml", "-o", "heard.h5").code == 0
    assert tiny("run", "tiny.toml", "--measurements", "heard.h5", "--steps", 2, "-o", "part").code == 0
    part = scored("part")["agent1"]
    assert part["steps"] == 2
    assert part["position_rmse_m"] < 1
    assert part["position_bound_m"] is not None
    told = tiny("run", "tiny.toml", "--steps", 0, "-o", "none")
    assert (told.code, "--steps" in told.err) == (2, True)


@pytest.mark.slow
@runs
def test_steps_are_kept_by_a_run_that_is_gone_on_with(tiny, monkeypatch):
    from gridslam.systems.grid import GridSlam

    step, seen = GridSlam.step, []

    def stop(self, scan):
        seen.append(scan.step)
        if len(seen) == 2:
            raise KeyboardInterrupt
        return step(self, scan)

    monkeypatch.setattr(GridSlam, "step", stop)
    words = ("run", "tiny.toml", "--agent", "agent1", "--steps", 2, "--checkpoint", 1, "-o", "out")
    assert tiny(*words).code == 130
    monkeypatch.setattr(GridSlam, "step", step)
    told = tiny("run", "--resume", "out", "--steps", 3)
    assert (told.code, told.complaints[0].startswith("error: --steps: ")) == (2, True)
    assert tiny("run", "--resume", "out").code == 0
    assert scored("out")["agent1"]["steps"] == 2


def test_what_is_cut_is_what_was_heard_first():
    scene = gs.Scene.from_toml(TINY, "tiny")
    heard = gs.simulate(scene, "agent1", 1)
    cut = first_heard(heard, 2)
    assert (len(cut), len(cut.truth.time_s), cut.step.max()) == (2, 2, 1)
    assert first_heard(heard, 3) is heard
    assert len(gs.simulate(first_of_scene(scene, 2), "agent1", 1)) == 2
    signals = gs.simulate(gs.Scene.load("screen"), "agent1", 1, what="signal")
    few = first_heard(signals, 4)
    np.testing.assert_array_equal(few.samples, signals.samples[:4])


@runs
def test_a_scene_without_walls_is_simulated_as_free_space(open_air):
    """What walls give is told by a run without them, which was refused."""
    told = open_air("simulate", "open.toml", "-o", "heard.csv")
    assert (told.code, "free space" in told.err) == (0, True)
    told = open_air("run", "open.toml", "--seed", 3, "-o", "out")
    assert (told.code, "free space" in told.err) == (0, True)
    for one in scored("out").values():
        assert one["position_bound_m"] > 0
        assert (one["surfaces_true"], one["surfaces_matched"]) == (0, 0)
    assert any("free space" in note for note in json.loads(Path("out/run.json").read_text())["notes"])


@pytest.mark.slow
@pytest.mark.usefixtures("runs_here")
def test_free_space_is_drawn_and_studied_too(open_air, monkeypatch):
    assert open_air("run", "open.toml", "--agent", "agent1", "-o", "out").code == 0
    assert Path("out/figures/agent1-map.png").exists()
    monkeypatch.setattr("gridslam.studies.plots.encoded", lambda *_: b"")  # its numbers are looked at
    told = open_air("study", "open.toml", "--runs", 2, "--workers", 1, "-o", "study")
    assert told.code == 0, told.err
    with Path("study/summary.csv").open(newline="") as file:
        assert all(float(row["position_to_known_map_bound"]) > 0 for row in csv.DictReader(file))


@pytest.mark.slow
@runs
def test_a_table_that_lost_steps_has_the_bound_of_what_is_left_and_a_note(say):
    scene = gs.Scene.load("room")
    gs.simulate(scene, "agent1", 1).to_csv("heard.csv")
    gs.ground_truth(scene, "agent1").trajectory.to_tum("way.tum")
    with open("heard.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    with open("gap.csv", "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(row for row in rows if not 15 <= int(row["step"]) < 40)
    words = ("run", "room", "--truth", "way.tum", "--steps", 50, "--particles", 300, "--measurements")
    bounds = []
    for name in ("heard", "gap"):
        assert say(*words, f"{name}.csv", "-o", name).code == 0
        bounds.append(scored(name)["agent1"]["position_bound_m"])
    assert bounds[1] > 1.5 * bounds[0]
    notes = json.loads(Path("gap/run.json").read_text())["notes"]
    assert "agent1: nothing was heard at 25 of 50 steps, the longest time from step 15 to 39" in notes
