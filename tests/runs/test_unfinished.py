"""Runs that are interrupted and gone on with end as if they never had been; nothing of them is lost."""

import os
import shutil
from pathlib import Path

import pytest
from interrupted_runs import (
    RUN,
    STOPPED,
    here,
    interrupted,
    killed,
    prepared,
    recorded,
    refused,
    same_runs,
    stop_at,
)

from gridslam.runs.parts import unfinished_part
from gridslam.runs.reservation import reserve
from gridslam.runs.unfinished import read_unfinished
from gridslam.systems.grid import GridSlam

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.usefixtures("no_figures", "ctrl_c"),
]


@pytest.fixture
def tiny(say):
    return prepared(say)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Runs that nothing interrupted, by their options."""
    return tmp_path_factory.mktemp("whole"), {}


@pytest.fixture
def whole(tiny, kept):
    """Folder of the run that nothing interrupted, which is made once for each set of options."""

    def made(*options):
        folder, known = kept
        if options not in known:
            path = folder / str(len(known))
            assert tiny(*RUN, *options, "-o", path).code == 0
            known[options] = path
        return known[options]

    return made


slow = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "agent", "step", "start"),
    [
        ("grid", "agent1", 1, "drawn"),
        pytest.param("grid", "agent2", 0, "exact", marks=slow),
        pytest.param("adaptive", "agent2", 0, "exact", marks=slow),
        pytest.param("va", "agent1", 1, "drawn", marks=slow),
    ],
)
def test_interrupted_run_that_is_resumed_is_as_if_it_never_was(
    tiny, whole, monkeypatch, method, agent, step, start
):
    options = ("--method", method, "--start", start)
    result = interrupted(tiny, monkeypatch, *options, "--checkpoint", "2", agent=agent, step=step)
    total = {"agent1": 3, "agent2": 2}[agent]
    line = f"interrupted after {step + 1} of {total} steps of {agent}; to go on: gridslam run --resume out"
    assert result.complaints == [line]
    assert here() == [f".out.{os.getpid()}.part", "tiny.toml"]
    assert tiny("run", "--resume", "out").code == 0
    assert here() == ["out", "tiny.toml"]
    assert not list(Path("out").glob(".*"))
    same_runs(whole(*options), "out")


@pytest.mark.slow
def test_checkpoints_alone_change_nothing(tiny, whole):
    assert tiny(*RUN, "-o", "out", "--checkpoint", "1").code == 0
    same_runs(whole(), "out")


@pytest.mark.slow
def test_recorded_measurements_and_a_map_go_on_bit_for_bit_from_another_folder(tiny, monkeypatch):
    options = recorded(tiny)
    assert tiny(*RUN, *options, "-o", "whole").code == 0
    interrupted(tiny, monkeypatch, *options, agent="agent2", step=0)
    Path("elsewhere").mkdir()
    with monkeypatch.context() as patch:
        patch.chdir("elsewhere")
        assert tiny("run", "--resume", "../out").code == 0
    same_runs("whole", "out")


@pytest.mark.slow
def test_run_may_be_interrupted_again_and_again(tiny, whole, monkeypatch):
    interrupted(tiny, monkeypatch, step=0)
    for (agent, step), (number, (code, word)) in zip(
        (("agent1", 1), ("agent2", 0)), STOPPED.items(), strict=True
    ):
        with monkeypatch.context() as patch:
            stop_at(patch, agent, step, number)
            result = tiny("run", "--resume", "out")
        assert (result.code, len(result.complaints)) == (code, 1)
        assert result.err.startswith(f"{word} after {step + 1} of ")
    assert tiny("run", "--resume", "out").code == 0
    same_runs(whole(), "out")


@pytest.mark.slow
def test_run_that_was_through_but_for_its_scores_is_scored(tiny, whole, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("gridslam.cli.run._scores", stop)
        result = tiny(*RUN, "-o", "out", "--checkpoint", "1")
    assert (result.code, len(result.complaints)) == (130, 1)
    assert "after all 2 steps of agent2" in result.err
    monkeypatch.setattr(GridSlam, "step", None)  # nothing is left to do
    assert tiny("run", "--resume", "out").code == 0
    same_runs(whole(), "out")


@pytest.mark.slow
def test_killed_run_loses_no_more_than_the_steps_since_its_checkpoint(tiny, whole):
    """Checkpoints: 1 nothing, 2 agent1 begins, 3 to 5 its steps, 6 agent2 begins, 7 and 8 its steps.

    Those of a run that goes on: one for each step that is left, and one where agent2 begins. Of a method that
    starts at once, in each process; the others go on bit for bit above.
    """
    method = ("--method", "kept_sights:KeptSights")
    start, resume = (*RUN, *method, "-o", "out", "--checkpoint", "1"), ("run", "--resume", "out")
    for last, words, done in ((3, start, 0), (5, resume, 3)):
        process = killed(last, *words)
        assert here() == [f".out.{process}.part", ".out.run-lock", "tiny.toml"]
        assert sum(agent.done for agent in read_unfinished("out").agents) == done
    with reserve("neighbour"):
        assert unfinished_part("out") is not None
    assert tiny("run", "--resume", "out").code == 0
    assert here() == ["out", "tiny.toml"]
    same_runs(whole(*method), "out")


@pytest.mark.slow
def test_disk_that_is_full_costs_the_steps_since_the_checkpoint_alone(tiny, whole, monkeypatch):
    def full(slam, path):
        if slam.state.step == 2:
            raise OSError(28, "No space left on device")
        save(slam, path)

    save = GridSlam.save
    with monkeypatch.context() as patch:
        patch.setattr(GridSlam, "save", full)
        result = tiny(*RUN, "-o", "out", "--checkpoint", "1")
    assert (result.code, len(result.complaints)) == (2, 1)
    assert "No space left" in result.err
    assert tiny("run", "--resume", "out").code == 0
    same_runs(whole(), "out")


@pytest.mark.slow
def test_files_that_cannot_be_written_at_the_end_are_written_by_resume(tiny, whole, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("gridslam.runs.run_files.write_steps", fail)
        result = tiny(*RUN, "-o", "out", "--checkpoint", "1")
    assert (result.code, len(result.complaints)) == (2, 3)
    assert result.complaints[-1].endswith("gridslam run --resume out")
    assert here() == [f".out.{os.getpid()}.part", "tiny.toml"]
    assert tiny("run", "--resume", "out").code == 0
    same_runs(whole(), "out")


@pytest.mark.slow
def test_unfinished_run_that_was_to_replace_another_is_told_and_resumed(tiny, whole, monkeypatch):
    assert tiny("run", "tiny.toml", "--agent", "agent2", "-o", "out").code == 0
    interrupted(tiny, monkeypatch, "--overwrite")
    reason = refused(tiny, *RUN, "-o", "out")
    assert "an unfinished run to replace it" in reason
    assert "gridslam run --resume out" in reason
    for asked in (("check", "out"), ("export", "out", "-o", "robot")):
        result = tiny(*asked)
        assert result.code == 0
        assert "an unfinished run that was to replace this one waits" in " ".join(result.err.split())
    shutil.rmtree("robot")
    assert tiny("run", "--resume", "out").code == 0
    same_runs(whole(), "out")


@pytest.mark.slow
def test_run_without_a_folder_of_its_own_keeps_off_an_unfinished_one(tiny, monkeypatch):
    with monkeypatch.context() as patch:
        stop_at(patch, "agent1", 1)
        result = tiny(*RUN, "--checkpoint", "1")
    assert result.complaints[-1].endswith(f"gridslam run --resume {Path('runs/tiny-1')}")
    assert tiny(*RUN).code == 0
    assert tiny("run", "--resume", "runs/tiny-1").code == 0
    same_runs("runs/tiny-1", "runs/tiny-2")
