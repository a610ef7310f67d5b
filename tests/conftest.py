"""What several tests share: the command line in this process, and a scene that takes a second."""

import gc
import os
import signal
import sys
from collections import Counter
from typing import NamedTuple

import pytest
from hypothesis import settings
from scene_samples import shortened
from threadpoolctl import threadpool_limits

import gridslam as gs
from gridslam.io import hdf5_guard

# a loaded machine refuses no whole file; what the limit does is tested with a limit of its own
hdf5_guard.START_S = 120.0
# the same code passes or fails every time, on busy machines, too: no example has a deadline; other examples
# are looked for with GRIDSLAM_EXAMPLES=other
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("other", derandomize=False, deadline=None)
settings.load_profile(os.environ.get("GRIDSLAM_EXAMPLES", "same"))


class FromTheEnd(pytest.Dir):
    """A folder that is read from its last file to its first."""

    def collect(self):
        return reversed([*super().collect()])


def pytest_collect_directory(path, parent):
    """Every other process begins at the end: each reads what another one has compiled already, so that no
    file of a fresh copy is compiled by all of them."""
    if os.environ.get("PYTEST_XDIST_WORKER", "")[-1:] in (*"13579",):
        return FromTheEnd.from_parent(parent, path=path)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """In processes side by side, files of most slow tests come first: none is left to one process alone at
    the end. All of them have to have the same order, too."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
        every = Counter(item.path for item in items)
        items.sort(key=lambda item: (-slow[item.path], -every[item.path], item.path))


def pytest_collection_finish():
    """What is imported by now stays: nobody looks through it again, nor at each 700 objects that are new."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 10)


def pytest_sessionfinish():
    """At its end pytest looks five times through all objects for files that nobody closed, and Python once
    more: here once, and what is left is left alone. But Taichi, which keeps what it compiled as it goes."""
    if "taichi" in sys.modules:
        sys.modules["taichi"].reset()
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def one_blas_thread():
    """As within a step: tests of parts of steps call them bare, and threads that wait for each other spin."""
    with threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture(autouse=True)
def unsynced(monkeypatch):
    """Nobody waits for the disk, some thirty times a run; `tests/io/test_durable.py` tells that we do."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)


class CommandResult(NamedTuple):
    code: int
    out: str
    err: str

    @property
    def complaints(self):
        return self.err.strip().splitlines()


@pytest.fixture
def say(tmp_path, monkeypatch, capsys):
    """Call the command line in an empty folder: `say("run", "room")` gives exit code, stdout, stderr."""
    from gridslam.cli.main import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])  # to which commands add their working folder

    def call(*words):
        monkeypatch.setattr("sys.argv", ["gridslam", *map(str, words)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main()
        return CommandResult(stop.value.code, *capsys.readouterr())

    return call


@pytest.fixture
def short_room(tmp_path):
    """Path of a scene file: `room`, five steps, two agents."""
    path = tmp_path / "short.toml"
    path.write_text(shortened(gs.Scene.load("room"), 5, agents=2).to_toml())
    return path


@pytest.fixture
def blank_figures(monkeypatch):
    """Figures are made and are files of their names, but aren't drawn, which takes longer than the
    filter: for tests that look at names alone."""
    for room in ("viewers.plots", "viewers.export_figures", "studies.plots"):
        monkeypatch.setattr(f"gridslam.{room}.encoded", lambda *_: b"\x89PNG")


@pytest.fixture
def no_figures(monkeypatch, blank_figures):
    """Leave out the figures of runs, and reading what they would show; those of exports are blank."""
    monkeypatch.setattr("gridslam.viewers.plots.draw_all", lambda folder, *_, **__: [])
    monkeypatch.setattr("gridslam.cli.run_end._read_back", lambda *_: None)


@pytest.fixture
def runs_here(monkeypatch):
    """Runs of studies are done in this process; `tests/studies/test_study_workers.py` starts others."""
    from gridslam.studies.workers import LocalWorkers

    monkeypatch.setattr(LocalWorkers, "run", lambda self, work, tasks: enumerate(map(work, tasks)))


@pytest.fixture
def ctrl_c():
    """Ctrl-C as a terminal has it: a shell lets jobs in the background ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
