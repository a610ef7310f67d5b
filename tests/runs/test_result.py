"""The folder that a run writes, and what happens when it can't."""

import errno
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import run_samples
from run_samples import hall, some_measurements, some_run, tree, write

from gridslam.errors import InputError, Unwritten
from gridslam.maps.map import Map
from gridslam.runs.reservation import check_output
from gridslam.runs.run import Run
from gridslam.runs.run_files import read_run, write_run

FILES = ["map.h5", "measurements.h5", "steps.h5", "trajectory.tum", "truth.tum"]


@pytest.fixture(scope="module")
def scene():
    return hall()


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


def test_methods_that_draw_no_particles_say_so(tmp_path, scene):
    run = some_run(scene, "agent1", method="direct")
    write_run(tmp_path / "out", scene, [run], [some_measurements(scene, "agent1")], [None], {})
    assert json.loads((tmp_path / "out/run.json").read_text())["particles"] is None


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
    at_hand = read_run(tmp_path / "out", {"agent1": own.map})  # a map that is there isn't read twice
    assert at_hand.agents["agent1"].map is own.map is not again.agents["agent2"].map


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

    monkeypatch.setattr(Map, "nav2_files", stop)
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
    write_run(
        tmp_path / "out", scene, [run], [some_measurements(scene, "agent1")], [None], {"threads": np.int64(2)}
    )
    summary = json.loads((tmp_path / "out/run.json").read_text())
    assert summary["agents"]["agent1"]["seconds_per_step"] is None
    assert summary["agents"]["agent1"]["peak_memory_mb"] is None
    assert summary["threads"] == 2


@pytest.mark.slow
def test_full_disk_is_told_file_by_file_and_the_rest_kept(tmp_path):
    pytest.importorskip("resource")  # not on Windows
    code = (
        "import resource, signal, sys, run_samples as t; from gridslam.errors import Unwritten\n"
        "scene = t.hall()\n"
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
        cwd=Path(run_samples.__file__).parent,
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
    runs, measurements = [some_run(scene, a) for a in agents], [some_measurements(scene, a) for a in agents]
    monkeypatch.setattr(Path, "mkdir", full)
    monkeypatch.setattr(Run, "score", scored)
    with pytest.raises(Unwritten) as caught:
        write_run(tmp_path / "out", scene, runs, measurements, [None, None], {})
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


def test_picture_that_cannot_be_written_is_named_and_costs_no_figure_and_no_picture(
    tmp_path, scene, monkeypatch
):
    write_bytes = Path.write_bytes

    def full(path, content):
        if "reflection.pgm" in path.name:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write_bytes(path, content)

    def draw(folder):
        (folder / "figures").mkdir()
        (folder / "figures" / "agent1-map.png").touch()
        raise Unwritten([InputError(str(folder / "figures" / "agent1-rays.png"), "no fonts", "some")])

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(Unwritten) as caught:
        write(tmp_path / "out", scene, draw=draw)
    names = ["reflection.pgm", "figures/agent1-rays.png"]
    assert [fault.where for fault in caught.value.faults] == [str(tmp_path / "out" / name) for name in names]
    found = {"map.pgm", "map.yaml", "reflection.yaml", "run.json", "figures/agent1-map.png"}
    assert found <= set(tree(tmp_path / "out"))


@pytest.mark.parametrize("name", ["../up", "a/b", "", "map.h5", ".hidden", "figures"])
def test_agent_whose_name_is_no_folder_is_refused(tmp_path, scene, name):
    run = replace(some_run(scene, "agent1"), agent=name)
    with pytest.raises(InputError, match="agent"):
        write_run(tmp_path / "out", scene, [run], [some_measurements(scene, "agent1")], [None], {})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"agents": 3}', '{"agents": {}}'])
def test_folder_that_is_no_run_is_refused(tmp_path, damage):
    with pytest.raises(InputError, match=r"run\.json"):
        read_run(tmp_path)
    (tmp_path / "run.json").write_text(damage)
    with pytest.raises(InputError, match=r"run\.json"):
        read_run(tmp_path)
