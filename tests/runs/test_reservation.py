"""Two runs and one folder, and runs that died: nothing is lost."""

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from interrupted_runs import here, prepared
from tiny import TINY

from gridslam.errors import InputError
from gridslam.runs.parts import INDEX, MARK, UNFINISHED, sign
from gridslam.runs.reservation import reserve, reserve_free
from gridslam.runs.run_files import read_run
from gridslam.systems.grid import GridSlam

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
OWN = "own_method:SightFilter"
RUN = ("run", "tiny.toml", "--particles", "100", "-o", "out")


@pytest.fixture
def tiny(say):
    return prepared(say)


@pytest.fixture(scope="module")
def dead():
    """Number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


# ---- two runs, one folder ---------------------------------------------------------------------------


@pytest.mark.slow
def test_of_two_runs_at_once_the_second_is_refused_and_the_first_is_whole(tmp_path):
    """Each stops where it would draw, until the other is as far or has ended; the method starts at once."""
    (tmp_path / "tiny.toml").write_text(TINY)
    code = (
        "import sys, gridslam.viewers.plots as p, gridslam.cli.main as c\n"
        "p.draw_all = lambda folder, run=None: (print('drawing', flush=True), sys.stdin.read(), [])[2]\n"
        "c.main()"
    )
    runs = []
    for seed in (5, 6):
        command = [
            sys.executable,
            "-c",
            code,
            *RUN,
            "--seed",
            str(seed),
            "--method",
            "own_method:SightFilter",
        ]
        pipe, search = subprocess.PIPE, os.pathsep.join([str(EXAMPLES), *sys.path])
        run = subprocess.Popen(
            command, cwd=tmp_path, stdin=pipe, stdout=pipe, stderr=pipe, text=True,
            env=os.environ | {"PYTHONPATH": search},
        )  # fmt: skip
        runs.append(run)
        while run.stdout.readline() not in ("drawing\n", ""):
            pass
    errors = [run.communicate()[1] for run in runs]
    assert [run.returncode for run in runs] == [0, 2], errors
    assert json.loads((tmp_path / "out/run.json").read_text())["seed"] == 5
    assert len(errors[1].strip().splitlines()) == 1
    assert sorted(os.listdir(tmp_path)) == ["out", "tiny.toml"]


@pytest.mark.parametrize("option", [(), ("--overwrite",)])
def test_folder_in_use_is_refused_before_any_work(tiny, monkeypatch, option):
    monkeypatch.setattr(GridSlam, "step", None)  # it would be a TypeError, not one line
    with reserve("out"):
        before = here()
        result = tiny(*RUN, *option)
        assert (result.code, len(result.complaints)) == (2, 1)
        assert f"out: found a run at work on it (process {os.getpid()})" in result.err
        assert here() == before
    assert here() == ["tiny.toml"]


@pytest.mark.slow
@pytest.mark.parametrize("option", [(), ("--overwrite",)])
@pytest.mark.parametrize("kind", ["folder", "file"])
def test_what_appears_meanwhile_stays_and_so_does_the_run(tiny, monkeypatch, kind, option):
    def meanwhile(folder, run):
        if kind == "file":
            Path("out").write_text("x")
        else:
            Path("out").mkdir()
            Path("out/thesis.tex").write_text("x")

    monkeypatch.setattr("gridslam.viewers.plots.draw_all", meanwhile)
    result = tiny(*RUN, *option)
    kept = f"out.{os.getpid()}.part"
    assert (result.code, len(result.complaints)) == (2, 1)
    assert str(Path(kept).resolve()) in result.err
    assert (Path("out") if kind == "file" else Path("out/thesis.tex")).read_text() == "x"
    assert here() == ["out", kept, "tiny.toml"]
    assert list(read_run(kept).agents) == ["agent1", "agent2"]


def test_runs_without_a_folder_of_their_own_take_different_ones(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with reserve_free(Path("runs"), "a/../b") as one, reserve_free(Path("runs"), "a/../b") as two:
        assert [one.target.name, two.target.name] == ["a_.._b-1", "a_.._b-2"]
        one.part.joinpath("run.json").touch()
        one.finish()
        assert {one.target.parent, two.target.parent} == {tmp_path / "runs"}
    assert os.listdir("runs") == ["a_.._b-1"]


# ---- runs that died ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_killed_run_blocks_nobody_and_is_told(tiny, no_figures):
    code = (
        "import os, signal; from gridslam.runs.reservation import reserve\n"
        "with reserve('out') as place:\n"
        "    place.part.joinpath('x').touch(); os.kill(os.getpid(), signal.SIGKILL)"
    )
    killed = subprocess.Popen([sys.executable, "-c", code])
    assert killed.wait() == -signal.SIGKILL
    assert here() == [f".out.{killed.pid}.part", ".out.run-lock", "tiny.toml"]
    result = tiny(*RUN)
    assert result.code == 0
    assert len(result.complaints) == 1
    assert f"note: process {killed.pid}, which is gone" in result.err
    assert here() == ["out", "tiny.toml"]


def test_rest_of_a_killed_run_is_swept_though_nobody_has_asked_how_it_ended(tmp_path, monkeypatch):
    """A killed process keeps its number until its parent, in a container maybe nobody, waits for it."""
    monkeypatch.chdir(tmp_path)
    killed = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    part = Path(f".two.{killed.pid}.part")
    part.mkdir()
    sign(part, killed.pid)
    with reserve("one"):
        assert part.exists()  # it lives
    killed.kill()
    os.waitid(os.P_PID, killed.pid, os.WEXITED | os.WNOWAIT)
    with reserve("one"):
        assert not part.exists()
    killed.communicate()
    assert here() == []


def test_unfinished_run_of_the_dead_stays_and_runs_beside_it_tell(tmp_path, monkeypatch, dead):
    monkeypatch.chdir(tmp_path)
    hidden = Path(f".two.{dead}.part")
    (hidden / UNFINISHED).mkdir(parents=True)
    (hidden / UNFINISHED / INDEX).touch()
    sign(hidden, dead)
    with reserve("one") as place:
        (note,) = place.notes
    assert f"two is an unfinished run, kept hidden in {hidden}: gridslam run --resume {tmp_path}/two" in note
    assert (hidden / UNFINISHED / INDEX).exists()


def test_rests_of_the_dead_are_swept_and_nothing_else(tmp_path, monkeypatch, dead):
    monkeypatch.chdir(tmp_path)
    parent = os.getppid()
    ours = {f".out.{dead}.part": dead, f".other.{dead}.part": dead, f".out.{dead}-2.part": dead}
    live = {f".live.{parent}.part": parent, f".mine.{os.getpid()}.part": os.getpid()}
    names = (".out.part", ".out.12x.part", f"out.{dead}.part", f".out.{dead}.partial", f".{dead}.part")
    for name, process in (ours | live | dict.fromkeys(names, dead)).items():
        Path(name).mkdir()
        sign(Path(name), process)
    Path(f".other.{dead}.part/deep").mkdir()
    Path(f".link.{dead}.part").symlink_to(tmp_path / "out.part")
    Path(".x.run-lock").write_text("x")
    Path(".gone.run-lock").write_bytes(b"gridslam %d\n" % dead)
    before = set(here())
    with reserve("held"):
        Path(f".held.{dead}.part").mkdir()  # of another machine, maybe: somebody holds the lock
        sign(Path(f".held.{dead}.part"), dead)
        with reserve("out"):
            pass
        assert before - set(here()) == {*ours, ".gone.run-lock"}
        assert Path(f".held.{dead}.part").exists()


def test_what_bears_no_sign_of_ours_is_never_swept(tmp_path, monkeypatch, dead):
    """Other programs name files like this, too, and other machines' processes have the same numbers."""
    monkeypatch.chdir(tmp_path)
    for name in (f".data.{dead}.part", f".backup.{dead}.part.tgz", f".out.{dead}.old.part"):
        Path(name).write_text("x")
    far = Path("far")
    for folder in (f".thesis.{dead}.part", f".out.{dead}.part", f".run.{dead}.old.part", "far", "run"):
        Path(folder).mkdir()
        Path(folder, "only-copy.txt").write_text("x")
    sign(far, dead)
    marked = (far / MARK).read_text().splitlines()
    (far / MARK).write_text("\n".join([marked[0], "elsewhere", *marked[2:], ""]))
    far.rename(f".far.{dead}.part")
    number = os.getpid()  # a process of another container had our number
    for own in (Path(f".out.{number}.part"), Path(f".out.{number}-2.old.part")):
        own.mkdir()
        (own / "only-copy.txt").write_text("x")
    before = {path: path.is_file() and path.read_bytes() for path in Path().rglob("*")}
    with reserve("out") as place:
        assert place.part.name == f".out.{number}-3.part"
        assert place.empty
        (place.part / "run.json").touch()
        place.finish()
    assert os.listdir("out") == ["run.json"]
    with reserve("out", overwrite=True) as place:
        (place.part / "run.json").write_text("2")
        place.finish()
    assert Path("out/run.json").read_text() == "2"
    after = {path: path.is_file() and path.read_bytes() for path in Path().rglob("*")}
    assert after == before | {Path("out"): False, Path("out/run.json"): b"2"}


def test_run_that_was_whole_but_not_yet_named_is_kept(tmp_path, monkeypatch, dead):
    monkeypatch.chdir(tmp_path)
    Path(f".out.{dead}.part").mkdir()
    Path(f".out.{dead}.part/run.json").write_text("new")
    Path(f".out.{dead}.old.part").mkdir()
    Path(f".out.{dead}.old.part/run.json").write_text("old")
    for folder in Path().iterdir():
        sign(folder, dead)
    with pytest.raises(InputError, match="something of this name"), reserve("out"):
        pass
    assert Path("out/run.json").read_text() == "old"
    assert Path(f"out.{dead}.part/run.json").read_text() == "new"
    assert here() == ["out", f"out.{dead}.part"]
    assert [os.listdir(folder) for folder in here()] == [["run.json"]] * 2


def test_run_that_cannot_be_renamed_stays_where_it_is_said_to_be(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.chdir(tmp_path)
    with monkeypatch.context() as patch, reserve("out") as place:
        (place.part / "steps.h5").write_text("hours")
        patch.setattr(Path, "rename", fail)
        kept = place.keep()
    with reserve("out") as place:
        assert place.notes == []
    assert [path.name for path in kept.iterdir()] == ["steps.h5"]
