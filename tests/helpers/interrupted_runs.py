"""Runs of a tiny scene that are interrupted, and what their folders say."""

import json
import os
import shutil
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
from gridslam.runs.unfinished import Unfinished

RUN = ("run", "tiny.toml", "--particles", "100", "--seed", "3")
STOPPED = {signal.SIGINT: (130, "interrupted"), signal.SIGTERM: (143, "terminated")}
COSTS = ("seconds_per_step", "peak_memory_mb")


def prepared(say):
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
            text = item.dtype.kind == "O"  # whose bytes are addresses
            values = item[()].tolist() if text else item[()].tobytes()
            found[name, "values"] = (item.dtype.str, item.shape, values)

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
    often = () if "--checkpoint" in options else ("--checkpoint", "1")
    with monkeypatch.context() as patch:
        stop_at(patch, agent, step)
        result = tiny(*RUN, "-o", "out", *often, *options)
    assert result.code == 130, result.err
    return result


def recorded(tiny):
    """Options of a run from files alone, which are written."""
    assert tiny(*RUN, "--agent", "agent1", "-o", "first").code == 0
    assert tiny("simulate", "tiny.toml", "--agent", "agent2", "-o", "heard.csv").code == 0
    gs.Scene.load("tiny.toml").track("agent2").to_tum("true.tum")
    changed = gs.Map.load("first/map.h5")
    replace(changed, evidence=changed.evidence + 1).save("other.h5")
    files = ("--measurements", "heard.csv", "--truth", "true.tum", "--map", "first/map.h5")
    return "--agent", "agent2", *files


def refused(tiny, *words):
    """Why a command is refused, after which the unfinished run is still whole."""
    before = unfinished_files()
    result = tiny(*words)
    assert (result.code, len(result.complaints)) == (2, 1), result
    assert unfinished_files() == before
    return result.err


def unfinished_files():
    return {path.name: path.read_bytes() for path in Path().glob(".*.part/.unfinished/*")}


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
p.draw_all = lambda folder, run=None: []
c.main()
"""


def as_if_killed(say, last, *words):
    """What a run leaves that is killed where its checkpoint no. `last` is about to count, without a process.

    It is stopped there, and what its folder held comes back: stopped runs write a checkpoint more.
    """
    commit, count, kept = Unfinished._commit, 0, Path("kept")

    def stop(*args):
        nonlocal count
        count += 1
        if count == last:
            (part,) = Path().glob(".out.*.part")
            shutil.copytree(part, kept)
            raise KeyboardInterrupt
        return commit(*args)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Unfinished, "_commit", stop)
        assert say(*words).code == 130
    (part,) = Path().glob(".out.*.part")
    shutil.rmtree(part)
    kept.rename(part)


def killed(last, *words):
    """Number of the process of a run that is killed where its checkpoint no. `last` is about to count."""
    code, pipe = KILLED.replace("LAST", str(last)), subprocess.PIPE
    found = os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(Path(__file__).parent)])}
    run = subprocess.Popen(
        [sys.executable, "-c", code, *words], stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=found
    )
    first_line = run.stdout.readline()
    run.kill()
    errors = run.communicate()[1]
    assert (first_line, run.returncode) == ("here\n", -signal.SIGKILL), errors
    return run.pid
