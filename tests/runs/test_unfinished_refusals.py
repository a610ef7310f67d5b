"""What an unfinished run is not gone on with: other options, other files, damage."""

import json
import os
from pathlib import Path

import pytest
from interrupted_runs import RUN, here, interrupted, prepared, recorded, refused, same_runs

from gridslam.runs.parts import INDEX, UNFINISHED, unfinished_part
from gridslam.runs.reservation import reserve

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.usefixtures("no_figures", "ctrl_c"),
]


@pytest.fixture
def tiny(say):
    return prepared(say)


CONTRADICTIONS = (
    ("room",), ("--agent", "agent2"), ("--method", "va"), ("--particles", "101"), ("--seed", "4"),
    ("--start", "exact"), ("--device", "gpu"), ("--map", "map.h5"), ("--measurements", "heard.csv"),
    ("--same-frame",), ("-o", "other"),
)  # fmt: skip


@pytest.mark.slow
def test_option_that_contradicts_is_refused(tiny, monkeypatch):
    interrupted(tiny, monkeypatch)
    for words in CONTRADICTIONS:
        reason = refused(tiny, "run", *words, "--resume", "out")
        assert f"error: {words[0] if words != ('room',) else 'SCENE'}: found" in reason, words
    same = (*RUN, "-o", "out", "--agent", "agent1", "--agent", "agent2", "--start", "drawn")
    assert tiny(*same, "--checkpoint", "2", "--threads", "1", "--resume", "out").code == 0


@pytest.mark.slow
def test_unfinished_run_is_neither_replaced_unasked_nor_swept(tiny, monkeypatch):
    interrupted(tiny, monkeypatch)
    reason = refused(tiny, *RUN, "-o", "out")
    assert (
        "an unfinished run; allowed: to go on with it (gridslam run --resume out), or --overwrite" in reason
    )
    refused(tiny, *RUN, "-o", "out", "--overwrite", "--measurements", "nothing.csv")
    assert tiny(*RUN, "-o", "other").code == 0
    result = tiny(*RUN, "-o", "out", "--overwrite")
    assert (result.code, result.complaints) == (0, ["note: the unfinished run into out is overwritten"])
    assert here() == ["other", "out", "tiny.toml"]
    same_runs("other", "out")
    assert "a finished run" in refused(tiny, "run", "--resume", "out")


def test_run_that_is_at_work_is_not_resumed(tiny, monkeypatch):
    interrupted(tiny, monkeypatch)
    with reserve("out", resume=True):
        assert "a run at work on it" in refused(tiny, "run", "--resume", "out")


@pytest.mark.slow
def test_source_that_has_changed_or_is_gone_is_refused(tiny, monkeypatch):
    options = recorded(tiny)
    interrupted(tiny, monkeypatch, *options, agent="agent2", step=0)
    for name in ("tiny.toml", "heard.csv", "true.tum", "first/map.h5"):
        path = Path(name)
        before = path.read_bytes()
        text = before.replace(b"0.7\n", b"0.6\n") if name == "tiny.toml" else before.replace(b"1", b"2", 1)
        for changed in (text if name != "first/map.h5" else Path("other.h5").read_bytes(), None):
            if changed is None:
                path.unlink()
            else:
                assert changed != before
                path.write_bytes(changed)
            assert path.name in refused(tiny, "run", "--resume", "out") or name == "tiny.toml"
            path.write_bytes(before)
    assert tiny("run", "--resume", "out").code == 0


@pytest.mark.slow
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
    result = tiny(*RUN, "--method", "unsaved:Own", "-o", "out", "--checkpoint", "1")
    assert result.code == 2
    assert result.complaints == [
        "error: --checkpoint: found method 'unsaved:Own', which has no 'save'; allowed: one that has"
    ]
    assert "out" not in here()
