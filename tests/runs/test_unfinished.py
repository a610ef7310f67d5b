"""Runs that are interrupted and gone on with end as if they never had been; nothing of them is lost."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from tiny import TINY

import gridslam as gs
from gridslam.runs.parts import INDEX, UNFINISHED, unfinished_part
from gridslam.runs.reservation import reserve
from gridslam.runs.unfinished import read_unfinished
from gridslam.systems.grid import GridSlam

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.usefixtures("no_figures", "ctrl_c"),
]
RUN = ("run", "tiny.toml", "--particles", "100", "--seed", "3")
COSTS = ("seconds_per_step", "peak_memory_mb")
STOPPED = {signal.SIGINT: (130, "interrupted"), signal.SIGTERM: (143, "terminated")}


@pytest.fixture
def tiny(say):
    """The command line in a folder that holds a small scene alone."""
    Path("tiny.toml").write_text(TINY)
    return say


def here():
    return sorted(os.listdir())


def stop_at(monkeypatch, agent, step, number=signal.SIGINT):
    """Send a signal to this process at a step, once."""
    for system in (gs.GridSlam, gs.AdaptiveSlam, gs.VirtualAnchorSlam):
        whole = system.step

        def cut(slam, scan, whole=whole):
            nonlocal agent
            if (slam.agent, scan.step) == (agent, step):
                agent = None
                signal.raise_signal(number)
            return whole(slam, scan)

        monkeypatch.setattr(system, "step", cut)


def content(path):
    """What a file of a run's folder says, but for times and memory."""
    if path.suffix != ".h5":
        text = path.read_text() if path.suffix != ".pgm" else path.read_bytes()
        if path.name == "run.json":
            text = json.loads(text)
            for scores in text["agents"].values():
                assert all(scores.pop(name) > 0 for name in COSTS)
        return text
    found = {}

    def note(name, item):
        found[name, "attributes"] = {key: np.asarray(value).tolist() for key, value in item.attrs.items()}
        if isinstance(item, h5py.Dataset):
            found[name, "values"] = (item.dtype.str, item.shape, item[()].tobytes())

    with h5py.File(path, "r") as file:
        file.visititems(note)
    return repr(found)


def same_runs(one, other):
    names = [{str(p.relative_to(folder)) for p in Path(folder).rglob("*")} for folder in (one, other)]
    assert names[0] == names[1]
    for name in names[0]:
        if (Path(one) / name).is_file():
            assert content(Path(one) / name) == content(Path(other) / name), name


def interrupted(tiny, monkeypatch, *options, agent="agent1", step=1):
    """A run of which the first agent, or another, is through with a few steps."""
    with monkeypatch.context() as patch:
        stop_at(patch, agent, step)
        said = tiny(*RUN, "-o", "out", "--checkpoint", "1", *options)
    assert said.code == 130, said.err
    return said


# ---- bit for bit ------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["grid", "adaptive", "va"])
@pytest.mark.parametrize(("agent", "step", "start"), [("agent1", 1, "drawn"), ("agent2", 0, "exact")])
def test_interrupted_run_that_is_resumed_is_as_if_it_never_was(tiny, monkeypatch, method, agent, step, start):
    options = ("--method", method, "--start", start)
    assert tiny(*RUN, *options, "-o", "whole").code == 0
    said = interrupted(tiny, monkeypatch, *options, "--checkpoint", "2", agent=agent, step=step)
    total = {"agent1": 3, "agent2": 2}[agent]
    line = f"interrupted after {step + 1} of {total} steps of {agent}; to go on: gridslam run --resume out"
    assert said.complaints == [line]
    assert here() == [f".out.{os.getpid()}.part", "tiny.toml", "whole"]
    assert tiny("run", "--resume", "out").code == 0
    assert here() == ["out", "tiny.toml", "whole"]
    assert not list(Path("out").glob(".*"))
    same_runs("whole", "out")


def test_checkpoints_alone_change_nothing(tiny):
    assert tiny(*RUN, "-o", "whole").code == 0
    assert tiny(*RUN, "-o", "out", "--checkpoint", "1").code == 0
    same_runs("whole", "out")


def test_recorded_measurements_and_a_map_go_on_bit_for_bit_from_another_folder(tiny, monkeypatch):
    options = recorded(tiny)
    assert tiny(*RUN, *options, "-o", "whole").code == 0
    interrupted(tiny, monkeypatch, *options, agent="agent2", step=0)
    Path("elsewhere").mkdir()
    with monkeypatch.context() as patch:
        patch.chdir("elsewhere")
        assert tiny("run", "--resume", "../out").code == 0
    same_runs("whole", "out")


@pytest.mark.parametrize("number", STOPPED)
def test_run_may_be_interrupted_again_and_again(tiny, monkeypatch, number):
    assert tiny(*RUN, "-o", "whole").code == 0
    interrupted(tiny, monkeypatch, step=0)
    code, word = STOPPED[number]
    for agent, step in (("agent1", 1), ("agent2", 0)):
        with monkeypatch.context() as patch:
            stop_at(patch, agent, step, number)
            said = tiny("run", "--resume", "out")
        assert (said.code, len(said.complaints)) == (code, 1)
        assert said.err.startswith(f"{word} after {step + 1} of ")
    assert tiny("run", "--resume", "out").code == 0
    same_runs("whole", "out")


def test_run_that_was_through_but_for_its_scores_is_scored(tiny, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    assert tiny(*RUN, "-o", "whole").code == 0
    with monkeypatch.context() as patch:
        patch.setattr("gridslam.cli.main._scores", stop)
        said = tiny(*RUN, "-o", "out", "--checkpoint", "1")
    assert (said.code, len(said.complaints)) == (130, 1)
    assert "after 2 of 2 steps of agent2" in said.err
    monkeypatch.setattr(GridSlam, "step", None)  # nothing is left to do
    assert tiny("run", "--resume", "out").code == 0
    same_runs("whole", "out")


KILLED = """
import sys, gridslam.cli.main as c, gridslam.viewers.plots as p
from gridslam.runs.unfinished import Unfinished as u
commit, count = u._commit, 0
def wait(*args):
    global count
    count += 1
    if count == LAST:
        print("here", flush=True)
        sys.stdin.read()
    return commit(*args)
u._commit = wait
p.draw_all = lambda folder: []
c.main()
"""


def killed(last, *words):
    """Number of the process of a run that is killed where its checkpoint no. `last` is about to count."""
    code, pipe = KILLED.replace("LAST", str(last)), subprocess.PIPE
    run = subprocess.Popen(
        [sys.executable, "-c", code, *words], stdin=pipe, stdout=pipe, stderr=pipe, text=True
    )
    said = run.stdout.readline()
    run.kill()
    told = run.communicate()[1]
    assert (said, run.returncode) == ("here\n", -signal.SIGKILL), told
    return run.pid


@pytest.mark.slow
def test_killed_run_loses_no_more_than_the_steps_since_its_checkpoint(tiny):
    """Checkpoints: 1 nothing, 2 agent1 begins, 3 to 5 its steps, 6 agent2 begins, 7 and 8 its steps.

    Those of a run that goes on: one for each step that is left, and one where agent2 begins.
    """
    assert tiny(*RUN, "-o", "whole").code == 0
    start, resume = (*RUN, "-o", "out", "--checkpoint", "1"), ("run", "--resume", "out")
    for last, words, done in ((3, start, 0), (5, resume, 3)):
        process = killed(last, *words)
        assert here() == [f".out.{process}.part", ".out.run-lock", "tiny.toml", "whole"]
        assert sum(agent.done for agent in read_unfinished("out").agents) == done
    with reserve("neighbour"):
        assert unfinished_part("out") is not None
    assert tiny("run", "--resume", "out").code == 0
    assert here() == ["out", "tiny.toml", "whole"]
    same_runs("whole", "out")


# ---- refusals ---------------------------------------------------------------------------------------


def refused(tiny, *words):
    """Why a command is refused, after which the unfinished run is still whole."""
    before = unfinished_files()
    said = tiny(*words)
    assert (said.code, len(said.complaints)) == (2, 1), said
    assert unfinished_files() == before
    return said.err


def unfinished_files():
    return {path.name: path.read_bytes() for path in Path().glob(".*.part/.unfinished/*")}


@pytest.mark.parametrize(
    "words",
    [
        ("room",), ("--agent", "agent2"), ("--method", "va"), ("--particles", "101"), ("--seed", "4"),
        ("--start", "exact"), ("--device", "gpu"), ("--map", "map.h5"), ("--measurements", "heard.csv"),
        ("--same-frame",), ("-o", "other"),
    ],
)  # fmt: skip
def test_option_that_contradicts_is_refused(tiny, monkeypatch, words):
    interrupted(tiny, monkeypatch)
    reason = refused(tiny, "run", *words, "--resume", "out")
    assert f"error: {words[0] if len(words) > 1 or words[0][0] == '-' else 'SCENE'}: found" in reason
    same = (*RUN, "-o", "out", "--agent", "agent1", "--agent", "agent2", "--start", "drawn")
    assert tiny(*same, "--checkpoint", "2", "--threads", "1", "--resume", "out").code == 0


def test_unfinished_run_is_neither_replaced_unasked_nor_swept(tiny, monkeypatch):
    interrupted(tiny, monkeypatch)
    reason = refused(tiny, *RUN, "-o", "out")
    assert (
        "an unfinished run; allowed: to go on with it (gridslam run --resume out), or --overwrite" in reason
    )
    refused(tiny, *RUN, "-o", "out", "--overwrite", "--measurements", "nothing.csv")
    assert tiny(*RUN, "-o", "other").code == 0
    said = tiny(*RUN, "-o", "out", "--overwrite")
    assert (said.code, said.complaints) == (0, ["note: the unfinished run into out is overwritten"])
    assert here() == ["other", "out", "tiny.toml"]
    same_runs("other", "out")
    assert "no unfinished run" in refused(tiny, "run", "--resume", "out")


def test_run_that_is_at_work_is_not_resumed(tiny, monkeypatch):
    interrupted(tiny, monkeypatch)
    with reserve("out", resume=True):
        assert "a run at work on it" in refused(tiny, "run", "--resume", "out")


@pytest.mark.parametrize("file", ["tiny.toml", "heard.csv", "true.tum", "first/map.h5"])
@pytest.mark.parametrize("gone", [False, True])
def test_source_that_has_changed_or_is_gone_is_refused(tiny, monkeypatch, file, gone):
    options = recorded(tiny)
    interrupted(tiny, monkeypatch, *options, agent="agent2", step=0)
    path = Path(file)
    before = path.read_bytes()
    if gone:
        path.unlink()
    else:
        text = before.replace(b"0.7\n", b"0.6\n") if file == "tiny.toml" else before.replace(b"1", b"2", 1)
        path.write_bytes(text if file != "first/map.h5" else Path("other.h5").read_bytes())
    assert path.name in refused(tiny, "run", "--resume", "out") or file == "tiny.toml"
    path.write_bytes(before)
    assert tiny("run", "--resume", "out").code == 0


def recorded(tiny):
    """Options of a run from files alone, which are written."""
    assert tiny(*RUN, "--agent", "agent1", "-o", "first").code == 0
    assert tiny("simulate", "tiny.toml", "--agent", "agent2", "-o", "heard.csv").code == 0
    gs.Scene.load("tiny.toml").track("agent2").to_tum("true.tum")
    changed = gs.Map.load("first/map.h5")
    replace(changed, evidence=changed.evidence + 1).save("other.h5")
    files = ("--measurements", "heard.csv", "--truth", "true.tum", "--map", "first/map.h5")
    return "--agent", "agent2", *files


def test_damaged_checkpoint_is_refused_whatever_is_damaged(tiny, monkeypatch):
    interrupted(tiny, monkeypatch)
    folder = unfinished_part("out") / UNFINISHED
    names = sorted(os.listdir(folder))
    pieces = {f"0-{kind}" for n in (1, 2) for kind in (f"health-{n}.json", f"steps-{n}.h5")}
    assert set(names) == {INDEX, "0-filter-2.h5", "0-measurements.h5", *pieces}
    for name in names:
        whole = (folder / name).read_bytes()
        for spoilt in (whole[: len(whole) // 2], whole[:-40] + b"x" + whole[-39:], b""):
            (folder / name).write_bytes(spoilt)
            assert f"{name}: found damaged content" in refused(tiny, "run", "--resume", "out")
        (folder / name).write_bytes(whole)
    index = json.loads((folder / INDEX).read_bytes())
    for changed in ({"version": 99}, {"gridslam": "0.0.1"}, {"format": "other"}):
        (folder / INDEX).write_text(json.dumps(index | changed))
        assert f"{INDEX}: found" in refused(tiny, "run", "--resume", "out")
    (folder / INDEX).write_text(json.dumps(index))
    assert tiny("run", "--resume", "out").code == 0


def test_filter_checkpoint_of_another_version_is_refused(tiny, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("gridslam.systems.checkpoint.VERSION", 1)
        interrupted(tiny, patch)
    assert "version: found 1" in refused(tiny, "run", "--resume", "out")


OWN = """
class Own:
    def __init__(self, scene, prior_map=None, agent=None, seed=0):
        raise AssertionError("work")

    def step(self, scan):
        raise AssertionError("work")

    def map(self):
        raise AssertionError("work")
"""


def test_method_that_cannot_be_saved_is_told_before_any_work(tiny):
    Path("unsaved.py").write_text(OWN)
    said = tiny(*RUN, "--method", "unsaved:Own", "-o", "out", "--checkpoint", "1")
    assert said.code == 2
    assert said.complaints == [
        "error: --checkpoint: found method 'unsaved:Own', which has no 'save'; allowed: one that has"
    ]
    assert "out" not in here()


def test_disk_that_is_full_costs_the_steps_since_the_checkpoint_alone(tiny, monkeypatch):
    assert tiny(*RUN, "-o", "whole").code == 0

    def full(slam, path):
        if slam.state.step == 2:
            raise OSError(28, "No space left on device")
        whole(slam, path)

    whole = GridSlam.save
    with monkeypatch.context() as patch:
        patch.setattr(GridSlam, "save", full)
        said = tiny(*RUN, "-o", "out", "--checkpoint", "1")
    assert (said.code, len(said.complaints)) == (2, 1)
    assert "No space left" in said.err
    assert tiny("run", "--resume", "out").code == 0
    same_runs("whole", "out")


def test_files_that_cannot_be_written_at_the_end_are_written_by_resume(tiny, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    assert tiny(*RUN, "-o", "whole").code == 0
    with monkeypatch.context() as patch:
        patch.setattr("gridslam.runs.run_files.write_steps", fail)
        said = tiny(*RUN, "-o", "out", "--checkpoint", "1")
    assert (said.code, len(said.complaints)) == (2, 3)
    assert said.complaints[-1].endswith("gridslam run --resume out")
    assert here() == [f".out.{os.getpid()}.part", "tiny.toml", "whole"]
    assert tiny("run", "--resume", "out").code == 0
    same_runs("whole", "out")


def test_unfinished_run_that_was_to_replace_another_is_told_and_resumed(tiny, monkeypatch):
    assert tiny(*RUN, "-o", "whole").code == 0
    assert tiny("run", "tiny.toml", "--agent", "agent2", "-o", "out").code == 0
    interrupted(tiny, monkeypatch, "--overwrite")
    reason = refused(tiny, *RUN, "-o", "out")
    assert "an unfinished run to replace it" in reason
    assert "gridslam run --resume out" in reason
    assert tiny("run", "--resume", "out").code == 0
    same_runs("whole", "out")


def test_run_without_a_folder_of_its_own_keeps_off_an_unfinished_one(tiny, monkeypatch):
    with monkeypatch.context() as patch:
        stop_at(patch, "agent1", 1)
        said = tiny(*RUN, "--checkpoint", "1")
    assert said.complaints[-1].endswith(f"gridslam run --resume {Path('runs/tiny-1')}")
    assert tiny(*RUN).code == 0
    assert tiny("run", "--resume", "runs/tiny-1").code == 0
    same_runs("runs/tiny-1", "runs/tiny-2")
