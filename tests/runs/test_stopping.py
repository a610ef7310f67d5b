"""Runs that are asked to stop, by whatever signal and whenever: what they have is kept or nothing is left."""

import json
import os
import shutil
import signal
from contextlib import nullcontext
from pathlib import Path

import pytest
from interrupted_runs import here, prepared

import gridslam as gs
from gridslam.runs import reservation
from gridslam.runs.reservation import reserve
from gridslam.runs.run_files import read_run
from gridslam.systems.grid import GridSlam

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
RUN = ("run", "tiny.toml", "--particles", "100", "-o", "out")


@pytest.fixture
def tiny(say):
    return prepared(say)


def stop_at(monkeypatch, number, step=1):
    whole = GridSlam.step

    def cut(slam, scan):
        if (slam.agent, scan.step) == ("agent1", step):
            signal.raise_signal(number)
        return whole(slam, scan)

    monkeypatch.setattr(GridSlam, "step", cut)


def test_sigterm_is_ctrl_c_with_an_exit_code_of_its_own(tiny, no_figures, ctrl_c, monkeypatch):
    stop_at(monkeypatch, signal.SIGTERM)
    result = tiny(*RUN)
    assert result.code == 143
    assert result.complaints == ["terminated after 2 of 3 steps of agent1: out holds what was done"]
    assert json.loads(Path("out/run.json").read_text())["agents"]["agent1"]["steps"] == 2
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_sigterm_while_nothing_is_done_leaves_nothing(tiny, monkeypatch):
    def stop(*_, **__):
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr("gridslam.runs.map_scene.map_scene", stop)
    result = tiny(*RUN)
    assert (result.code, result.complaints) == (143, ["terminated"])
    assert here() == ["tiny.toml"]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signal_while_files_are_written_lets_them_be(tiny, no_figures, ctrl_c, monkeypatch, number, code):
    whole = gs.Trajectory.to_tum

    def cut(track, path):
        signal.raise_signal(number)
        whole(track, path)

    monkeypatch.setattr(gs.Trajectory, "to_tum", cut)
    assert tiny(*RUN).code == code
    assert list(read_run("out").agents) == ["agent1", "agent2"]


def test_ctrl_c_while_the_viewer_gets_a_map_loses_no_agent(tiny, no_figures, monkeypatch):
    class View:
        def follow(self, name, truth):
            return None

        def show_map(self, grid):
            raise KeyboardInterrupt

    monkeypatch.setattr("gridslam.cli.run.view_of", lambda *_: nullcontext(View()))
    assert tiny(*RUN, "--rerun").code == 130
    assert list(read_run("out").agents) == ["agent1"]
    assert len(read_run("out").agents["agent1"].estimates) == 3


@pytest.mark.slow
@pytest.mark.parametrize("option", [(), ("--overwrite",)])
@pytest.mark.parametrize("moment", ["check", "rename", "second rename", "figures"])
def test_ctrl_c_while_the_folder_gets_its_name_costs_nothing(tiny, ctrl_c, monkeypatch, moment, option):
    renames, rename, check, rmtree = [], Path.rename, reservation.check_output, shutil.rmtree

    def asked(at):
        if at == moment and Path("x").exists():
            Path("x").unlink()
            signal.raise_signal(signal.SIGINT)

    def renamed(path, to):
        asked(("rename", "second rename")[len(renames) % 2])
        renames.append(to)
        return rename(path, to)

    def checked(*words):
        asked("check")
        check(*words)

    def removed(path, **options):
        asked("figures")
        rmtree(path, **options)

    def draw(folder, run):
        Path("x").touch()
        if moment == "figures":
            raise KeyboardInterrupt

    if option:
        monkeypatch.setattr("gridslam.viewers.plots.draw_all", lambda folder, run=None: [])
        assert tiny(*RUN, "--seed", 1).code == 0
    renames.clear()
    monkeypatch.setattr("gridslam.viewers.plots.draw_all", draw)
    monkeypatch.setattr(Path, "rename", renamed)
    monkeypatch.setattr(reservation, "check_output", checked)
    monkeypatch.setattr(shutil, "rmtree", removed)
    result = tiny(*RUN, "--seed", 2, *option)
    Path("x").unlink(missing_ok=True)
    assert result.code == (0 if moment == "second rename" and not option else 130)
    assert here() == ["out", "tiny.toml"]
    assert read_run("out").summary["seed"] == 2
    assert list(read_run("out").agents) == ["agent1", "agent2"]


def fill_and_finish(place, text):
    (place.part / "run.json").write_text(text)
    place.finish()


@pytest.mark.parametrize("last", [1, 2, 3])
def test_interrupt_that_nothing_holds_back_loses_neither_run(tmp_path, monkeypatch, last):
    monkeypatch.chdir(tmp_path)
    with reserve("out") as place:
        fill_and_finish(place, "old")
    rename, count = Path.rename, []

    def cut(path, to):
        count.append(to)
        if len(count) == 1 and last == 3:  # after it, not before
            rename(path, to)
        if len(count) == last or last == 3:
            monkeypatch.setattr(Path, "rename", rename)
            raise KeyboardInterrupt
        return rename(path, to)

    monkeypatch.setattr(Path, "rename", cut)
    with pytest.raises(KeyboardInterrupt), reserve("out", overwrite=True) as new:
        fill_and_finish(new, "new")
    assert here() == ["out", f"out.{os.getpid()}.part"]
    assert [Path(name, "run.json").read_text() for name in here()] == ["old", "new"]
    assert [os.listdir(name) for name in here()] == [["run.json"]] * 2


# ---- files ------------------------------------------------------------------------------------------


def test_file_that_cannot_be_written_costs_no_other_and_is_one_line(tiny, monkeypatch):
    drawn = []

    def fail(*_):
        raise ValueError("no\nsuch text")

    def draw(folder, run):
        drawn.extend((name, len(found.estimates) > 0) for name, found in run.agents.items())

    monkeypatch.setattr("gridslam.viewers.plots.draw_all", draw)
    monkeypatch.setattr("gridslam.runs.run_files.write_steps", fail)
    result = tiny(*RUN)
    assert result.code == 2
    assert [line.split(": found")[0].rpartition("/out/")[2] for line in result.complaints] == [
        "agent1/steps.h5",
        "agent2/steps.h5",
    ]
    assert "surfaces" in result.out  # the table
    assert drawn == [("agent1", True), ("agent2", True)]
    assert gs.Map.load("out/map.h5").observed.any()
    assert set(os.listdir("out/agent2")) == {"measurements.h5", "trajectory.tum", "truth.tum", "map.h5"}
    assert here() == ["out", "tiny.toml"]


@pytest.mark.slow
def test_no_command_replaces_a_file_unasked(tiny, no_figures):
    assert tiny(*RUN).code == 0
    assert tiny("simulate", "tiny.toml", "-o", "a.csv").code == 0
    assert tiny("export", "out/map.h5", "-o", "robot").code == 0
    two = ("--agent", "agent1", "--agent", "agent2")
    Path("b.h5").write_text("x")  # one file of all agents
    files = [path for path in Path().rglob("*") if path.is_file()]
    before = {path: path.read_bytes() for path in files}
    commands = (
        ("simulate", "tiny.toml", "-o", "a.csv", "--seed", "1"),
        ("simulate", "tiny.toml", "-o", "b.h5", *two),
        ("export", "out/map.h5", "-o", "robot"),
        ("export", "out/map.h5", "-o", "out"),
        ("bench", "--json", "a.csv"),
    )
    for words in commands:
        result = tiny(*words)
        assert (result.code, len(result.complaints)) == (2, 1), words
        assert "something of this name" in result.err
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before
    for words in commands[:3]:
        assert tiny(*words, "--overwrite").code == 0
    assert Path("a.csv").read_bytes() != before[Path("a.csv")]
