"""Runs: scores, the folder that a run writes, and what happens when it can't."""

import errno
import json
import os
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from gridslam.errors import InputError, Unwritten
from gridslam.estimates import Estimate, HypothesisEstimate, PathEstimate, SurfaceEstimate
from gridslam.maps.map import Map
from gridslam.measurements.table import Measurements
from gridslam.runs.reservation import check_output
from gridslam.runs.run import Run
from gridslam.runs.run_files import read_run, write_run
from gridslam.runs.step_files import read_steps, write_steps
from gridslam.simulation.image_source import ground_truth
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory

SCENE = """
name = "hall"
[grid]
x_m = [-5.0, 5.0]
y_m = [-4.0, 4.0]
cell_m = 0.5
[materials]
concrete = 0.7
[[anchors]]
name = "A"
position_m = [-2.0, 1.0]
orientation_deg = 0.0
[[walls]]
material = "concrete"
points_m = [[-4.0, 3.25], [4.0, 3.25]]
[[agents]]
name = "agent1"
start_m = [0.0, 0.0]
start_heading_deg = 0.0
waypoints_m = [[0.0, 0.0], [1.0, 0.0]]
step_m = 0.05
[[agents]]
name = "agent2"
start_m = [0.0, -1.0]
start_heading_deg = 0.0
waypoints_m = [[0.0, -1.0], [0.5, -1.0]]
step_m = 0.05
"""
FILES = ["map.h5", "measurements.h5", "steps.h5", "trajectory.tum", "truth.tum"]


@pytest.fixture(scope="module")
def scene():
    return Scene.from_toml(SCENE, "hall.toml")


def some_estimate(step, surfaces, paths):
    draw = np.random.default_rng([step, surfaces, paths])
    table = SurfaceEstimate.from_lines(
        draw.normal(size=(surfaces, 2)),
        np.tile(np.eye(2), (surfaces, 1, 1)),
        *draw.random((3, surfaces)),
        owner=draw.integers(-1, 3, surfaces),
    )
    rows = PathEstimate(
        draw.integers(0, 3, paths),
        draw.integers(-1, 9, (paths, 2)),
        *draw.random((5, paths)),
        draw.normal(size=(paths, 4, 2)),
    )
    covariance = draw.normal(size=(5, 5))
    detected = draw.random(surfaces) < 0.5
    several = HypothesisEstimate(
        draw.random(step), draw.random((step, 2)), draw.random(step), draw.random((step, 2, 2)),
        draw.integers(0, 9, step),
    )  # fmt: skip
    return Estimate(
        step, 0.1 * step, draw.random(2), draw.random(2), 0.3, covariance, table, rows, detected, 9.5, 0.02,
        hypotheses=several,
    )  # fmt: skip


def some_run(scene, agent, error=0.0, **changes):
    track = scene.track(agent)
    position = track.position_m + np.array([error, 0])
    lines = np.array([[np.pi / 2, 3.25], [1.0, 2.0]])
    surfaces = SurfaceEstimate.from_lines(
        lines, np.tile(np.eye(2), (2, 1, 1)), np.ones(2) * 0.7, np.ones(2) * 0.1, np.array([0.9, 0.4])
    )
    grid = Map.blank(scene.grid.origin_m, scene.grid.cell_m, scene.grid.shape, 0.05)
    evidence, observed = np.zeros(grid.shape), np.zeros(grid.shape, bool)
    evidence[14], observed[14], observed[5] = 9.0, True, True  # row 14 is the wall's
    return Run(
        scene=scene,
        agent=agent,
        method="grid",
        seed=3,
        device="cpu",
        estimates=[some_estimate(step, step % 3, step % 4) for step in range(len(track))],
        trajectory=Trajectory(track.time_s, position, track.velocity_mps, track.heading_rad),
        covariance=np.zeros((len(track), 5, 5)),
        surfaces=surfaces,
        map=replace(grid, evidence=evidence, observed=observed),
        seconds_per_step=0.1,
        peak_memory_mb=100.0,
        **changes,
    )


def heard_by(scene, agent, truth=True):
    track = scene.track(agent)
    nan = np.full(2, np.nan)
    return Measurements(
        anchors=scene.anchor_names,
        anchor_position_m=scene.anchor_positions,
        anchor_orientation_rad=scene.anchor_orientations,
        step=np.array([0, 1]),
        time_s=track.time_s[:2],
        anchor=np.array([0, 0]),
        distance_m=np.array([2.0, 3.0]),
        aod_rad=nan,
        aoa_rad=nan,
        amplitude=nan,
        interval_s=1.0,
        steps=len(track),
        truth=track if truth else None,
    )


def write(directory, scene, agents=("agent1", "agent2"), truth=True, **options):
    runs = [some_run(scene, agent) for agent in agents]
    scores = [run.score(ground_truth(scene, run.agent) if truth else None) for run in runs]
    heard = [heard_by(scene, agent, truth) for agent in agents]
    write_run(directory, scene, runs, heard, scores, {"threads": 2}, **options)


def tree(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_score_without_truth_is_null_where_it_needs_truth(scene):
    scores = some_run(scene, "agent1").score(None)
    assert scores["surfaces_detected"] == 1
    assert scores["steps"] == len(scene.track("agent1"))
    known = {"surfaces_detected", "steps", "interrupted", "seconds_per_step", "peak_memory_mb", "map"}
    known |= {"health", "position_std_m", "heading_std_deg"}
    assert {key for key, value in scores.items() if value is not None} == known
    assert set(scores["map"].values()) == {None}


def test_score_against_the_truth(scene):
    scores = some_run(scene, "agent1", error=0.6).score(ground_truth(scene, "agent1"))
    for name in ("position_rmse_m", "position_p95_m", "final_position_error_m"):
        assert scores[name] == pytest.approx(0.6)
    assert scores["heading_rmse_deg"] == pytest.approx(0)
    assert scores["diverged"] is True
    assert (scores["surfaces_true"], scores["surfaces_detected"]) == (1, 1)
    assert scores["surface_ospa_m"] == pytest.approx(0, abs=1e-9)
    assert scores["map"]["occupied_recall"] == 1
    assert scores["map"]["free_precision"] == 1


def test_known_track_alone_scores_the_track_alone(scene):
    scores = some_run(scene, "agent1", error=0.1).score(scene.track("agent1"))
    assert scores["position_rmse_m"] == pytest.approx(0.1)
    assert scores["diverged"] is False
    assert scores["surfaces_true"] is None
    assert scores["map"]["auc"] is None


def test_steps_read_back_equal_with_and_without_rows(tmp_path):
    written = [some_estimate(*sizes) for sizes in ((0, 0, 0), (1, 3, 2), (2, 0, 5), (3, 2, 0))]
    write_steps(tmp_path / "steps.h5", written)
    again = read_steps(tmp_path / "steps.h5")
    assert len(again) == 4
    for a, b in zip(written, again, strict=True):
        assert np.isnan(b.seconds)
        for name in ("step", "time_s", "position_m", "velocity_mps", "heading_rad", "covariance", "detected"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        for table in ("surfaces", "paths", "hypotheses"):
            for field in fields(getattr(a, table)):
                np.testing.assert_array_equal(
                    getattr(getattr(a, table), field.name), getattr(getattr(b, table), field.name)
                )
    write_steps(tmp_path / "none.h5", [])
    assert read_steps(tmp_path / "none.h5") == []


def test_steps_of_a_file_without_hypotheses_have_none(tmp_path):
    written = [some_estimate(1, 3, 1)]
    assert len(written[0].hypotheses)
    write_steps(tmp_path / "steps.h5", written)
    with h5py.File(tmp_path / "steps.h5", "a") as file:
        del file["hypotheses"]
    (again,) = read_steps(tmp_path / "steps.h5")
    assert not len(again.hypotheses)


def test_steps_of_a_file_without_owners_serve_all_anchors(tmp_path):
    written = [some_estimate(0, 3, 1)]
    assert (written[0].surfaces.owner >= 0).any()
    write_steps(tmp_path / "steps.h5", written)
    with h5py.File(tmp_path / "steps.h5", "a") as file:
        del file["surfaces/owner"]
    (again,) = read_steps(tmp_path / "steps.h5")
    assert again.surfaces.owner.tolist() == [-1, -1, -1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("surfaces/offset", [0, 3, 0, 3, 5]),
        ("paths/offset", [0, 0, 2, 7, 99]),
        ("hypotheses/offset", [0, 0, 9, 9, 9]),
        ("steps/time_s", [0.0, 1.0]),
    ],
)
def test_steps_that_contradict_themselves_are_refused(tmp_path, name, values):
    write_steps(
        tmp_path / "steps.h5",
        [some_estimate(*sizes) for sizes in ((0, 0, 0), (1, 3, 2), (2, 0, 5), (3, 2, 0))],
    )
    with h5py.File(tmp_path / "steps.h5", "a") as file:
        del file[name]
        file[name] = np.array(values)
    with pytest.raises(InputError, match=r"steps\.h5"):
        read_steps(tmp_path / "steps.h5")


def test_folder_holds_what_the_contract_names(tmp_path, scene):
    write(tmp_path / "out", scene)
    found = set(tree(tmp_path / "out"))
    assert {"run.json", "scene.toml", "map.h5", "map.yaml", "map.pgm"} <= found
    assert {f"{agent}/{name}" for agent in ("agent1", "agent2") for name in FILES} <= found
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    summary = json.loads((tmp_path / "out/run.json").read_text())
    assert (summary["scene"], summary["method"], summary["seed"], summary["device"]) == (
        "hall",
        "grid",
        3,
        "cpu",
    )
    assert summary["particles"] == scene.filter.particles
    assert summary["threads"] == 2
    assert summary["versions"]["gridslam"]
    assert list(summary["agents"]) == ["agent1", "agent2"]
    assert summary["agents"]["agent1"]["map"]["occupied_recall"] == 1
    assert (tmp_path / "out/map.h5").read_bytes() == (tmp_path / "out/agent2/map.h5").read_bytes()


def test_repeated_run_writes_the_same_bytes(tmp_path, scene):
    write(tmp_path / "a", scene)
    write(tmp_path / "b", scene)
    assert tree(tmp_path / "a") == tree(tmp_path / "b")


def test_folder_reads_back_for_figures(tmp_path, scene):
    write(tmp_path / "out", scene)
    again = read_run(tmp_path / "out")
    assert again.scene == scene
    assert list(again.agents) == ["agent1", "agent2"]
    own = again.agents["agent1"]
    np.testing.assert_allclose(own.truth.position_m, scene.track("agent1").position_m)
    np.testing.assert_array_equal(own.map.occupied, some_run(scene, "agent1").map.occupied)
    assert len(own.estimates) == len(own.trajectory) == len(own.measurements) == len(scene.track("agent1"))


def test_run_without_truth_has_nulls_and_no_truth_file(tmp_path, scene):
    write(tmp_path / "out", scene, truth=False)
    text = (tmp_path / "out/run.json").read_text()
    assert "NaN" not in text
    assert json.loads(text)["agents"]["agent1"]["position_rmse_m"] is None
    assert not (tmp_path / "out/agent1/truth.tum").exists()
    assert read_run(tmp_path / "out").agents["agent1"].truth is None


def test_existing_folder_is_kept_unless_overwritten(tmp_path, scene):
    write(tmp_path / "out", scene)
    before = tree(tmp_path / "out")
    with pytest.raises(InputError, match="out"):
        write(tmp_path / "out", scene, agents=("agent1",))
    assert tree(tmp_path / "out") == before
    write(tmp_path / "out", scene, agents=("agent1",), overwrite=True)
    assert not (tmp_path / "out/agent2").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_overwrite_never_deletes_what_no_run_wrote(tmp_path, scene):
    (tmp_path / "home").mkdir()
    (tmp_path / "home/thesis.tex").write_text("x")
    for target in (tmp_path / "home", tmp_path / "home/thesis.tex"):
        with pytest.raises(InputError, match="no run wrote"):
            write(target, scene, overwrite=True)
        with pytest.raises(InputError):
            check_output(target)
    assert (tmp_path / "home/thesis.tex").exists()
    check_output(tmp_path / "deep/er")


def test_run_cut_off_while_it_is_written_leaves_the_old_one_and_no_rest(tmp_path, scene, monkeypatch):
    write(tmp_path / "out", scene)
    before = tree(tmp_path / "out")

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Map, "to_nav2", stop)
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "out", scene, agents=("agent1",), overwrite=True)
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "deep/new", scene)
    assert tree(tmp_path / "out") == before
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), ValueError("embedded NUL")])
def test_file_that_cannot_be_written_costs_no_other_and_no_earlier_run(tmp_path, scene, monkeypatch, error):
    def fail(*_):
        raise error

    write(tmp_path / "out", scene)
    before = tree(tmp_path / "out")
    monkeypatch.setattr("gridslam.runs.run_files.write_steps", fail)
    for where, overwrite in (("new", False), ("out", True)):
        with pytest.raises(Unwritten) as caught:
            write(tmp_path / where, scene, overwrite=overwrite)
        files = [fault.where for fault in caught.value.faults[:2]]
        assert files == [str(tmp_path / where / agent / "steps.h5") for agent in ("agent1", "agent2")]
        assert str(error.args[-1]) in caught.value.faults[0].found
    assert tree(tmp_path / "out") == before
    aside = tmp_path / f"out.{os.getpid()}.part"
    assert str(aside) in caught.value.faults[2].found
    for folder in (tmp_path / "new", aside):
        missing = set(before) - set(tree(folder))
        assert {os.path.basename(name) for name in missing} == {"steps.h5"}
    assert len(list(tmp_path.iterdir())) == 3


def test_old_run_returns_when_the_new_one_cannot_take_its_place(tmp_path, scene, monkeypatch):
    write(tmp_path / "out", scene)
    before = tree(tmp_path / "out")
    rename = Path.rename

    def refuse(path, target):
        if target == tmp_path / "out" and ".old" not in path.name:
            raise PermissionError(13, "Permission denied")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(InputError, match="Permission denied"):
        write(tmp_path / "out", scene, agents=("agent1",), overwrite=True)
    assert tree(tmp_path / "out") == before
    aside = tmp_path / f"out.{os.getpid()}.part"
    assert list(read_run(aside).agents) == ["agent1"]
    assert sorted(tmp_path.iterdir()) == [tmp_path / "out", aside]


def test_number_that_is_none_is_null_in_json(tmp_path, scene):
    run = replace(some_run(scene, "agent1"), seconds_per_step=float("nan"), peak_memory_mb=np.float64("inf"))
    write_run(tmp_path / "out", scene, [run], [heard_by(scene, "agent1")], [None], {"threads": np.int64(2)})
    summary = json.loads((tmp_path / "out/run.json").read_text())
    assert summary["agents"]["agent1"]["seconds_per_step"] is None
    assert summary["agents"]["agent1"]["peak_memory_mb"] is None
    assert summary["threads"] == 2


@pytest.mark.slow
def test_full_disk_is_told_file_by_file_and_the_rest_kept(tmp_path):
    pytest.importorskip("resource")  # not on Windows
    code = (
        "import resource, signal, sys, test_result as t; from gridslam.errors import Unwritten\n"
        "from gridslam.world.scene import Scene; scene = Scene.from_toml(t.SCENE, 'x')\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000))\n"
        "try: t.write(sys.argv[1], scene)\n"
        "except Unwritten as error: print(*error.faults, sep='\\n'); sys.exit(0)\n"
        "sys.exit(3)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "out"],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parent,
    )
    assert done.returncode == 0, done.stderr
    missing = {line.partition(": found File too large")[0] for line in done.stdout.splitlines()}
    assert str(tmp_path / "out/map.h5") in missing
    assert not any(Path(name).exists() for name in missing)
    assert {"run.json", "scene.toml", "agent1/trajectory.tum"} <= set(tree(tmp_path / "out"))
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_folder_or_score_that_fails_costs_no_other_agent(tmp_path, scene, monkeypatch):
    mkdir, score = Path.mkdir, Run.score

    def full(path, *words, **options):
        if path.name == "agent2":
            raise OSError(errno.ENOSPC, "No space left on device")
        mkdir(path, *words, **options)

    def scored(run, *words):
        if run.agent == "agent1":
            raise ValueError("no such bound")
        return score(run, *words)

    agents = ("agent1", "agent2")
    runs, heard = [some_run(scene, a) for a in agents], [heard_by(scene, a) for a in agents]
    monkeypatch.setattr(Path, "mkdir", full)
    monkeypatch.setattr(Run, "score", scored)
    with pytest.raises(Unwritten) as caught:
        write_run(tmp_path / "out", scene, runs, heard, [None, None], {})
    faults = [(Path(fault.where).name, fault.found) for fault in caught.value.faults]
    assert faults == [("run.json", "ValueError: no such bound"), ("agent2", "No space left on device")]
    steps = {
        name: table.get("steps")
        for name, table in json.loads((tmp_path / "out/run.json").read_text())["agents"].items()
    }
    assert steps == {"agent1": None, "agent2": len(runs[1].estimates)}
    assert {"scene.toml", "map.h5", "agent1/map.h5", "agent1/trajectory.tum"} <= set(tree(tmp_path / "out"))


def test_figure_that_fails_does_not_cost_the_results(tmp_path, scene):
    def draw(folder):
        assert (folder / "run.json").exists()
        raise RuntimeError("no fonts")

    with pytest.raises(RuntimeError, match="no fonts"):
        write(tmp_path / "out", scene, draw=draw)
    assert read_run(tmp_path / "out").summary["scene"] == "hall"


@pytest.mark.parametrize("name", ["../up", "a/b", "", "map.h5", ".hidden", "figures"])
def test_agent_whose_name_is_no_folder_is_refused(tmp_path, scene, name):
    run = replace(some_run(scene, "agent1"), agent=name)
    with pytest.raises(InputError, match="agent"):
        write_run(tmp_path / "out", scene, [run], [heard_by(scene, "agent1")], [None], {})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"agents": 3}', '{"agents": {}}'])
def test_folder_that_is_no_run_is_refused(tmp_path, damage):
    with pytest.raises(InputError, match=r"run\.json"):
        read_run(tmp_path)
    (tmp_path / "run.json").write_text(damage)
    with pytest.raises(InputError, match=r"run\.json"):
        read_run(tmp_path)
