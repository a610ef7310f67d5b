"""What `check` says of tables in which nothing is suspected is so."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.checks.verdicts import verdict
from gridslam.checks.verdicts.diagnose import describe

SCENE = gs.Scene.load("room")


@pytest.fixture(scope="module")
def seen():
    table = dict(gs.simulate(SCENE, "agent1", 1).columns)
    return table, explain(table, SCENE, "agent1")


@pytest.mark.parametrize(
    ("first", "share", "says"),
    [
        (100, 0.04, "the first 100 steps: B (in 4% of "),
        (None, 0.04, "all steps: B (in 4% of "),
        (100, np.nan, "the first 100 steps: B (in 0% of "),
    ],
)
def test_an_anchor_that_is_seen_later_is_not_said_to_be_out_of_sight(seen, monkeypatch, first, share, says):
    """It may be in sight in some scans, and its rows may be wrong: what is said is what was counted."""
    table, sight = seen
    fake = replace(sight, shares=np.array([1.0, share]), first=first)
    monkeypatch.setattr(verdict, "followed", lambda *_: fake)
    line = verdict.verdict(table, np.arange(2), SCENE, "agent1")
    assert "units and frames fit the scene" in line
    scans = int((table["anchor"][sight.row] == 1).sum())
    assert line.endswith(f"; not judged, for too few lines of sight in {says}{scans} scans)")
    assert "out of sight" not in line


def test_steps_that_were_not_looked_at_are_named(seen):
    """What changes there isn't known: an anchor that is renamed, a clock that jumps."""
    table, sight = seen
    assert sight.first == 100
    line = verdict.verdict(table, np.arange(2), SCENE, "agent1")
    assert line.endswith(": units and frames fit the scene; steps 100 to 149 weren't looked at")
    late = table | {"step": table["step"] + 7}
    assert verdict.verdict(late, np.arange(2), SCENE, "agent1").endswith(
        "; steps 107 to 156 weren't looked at"
    )
    early = {name: values[table["step"] < 101] for name, values in table.items()}
    assert verdict.verdict(early, np.arange(2), SCENE, "agent1").endswith("; step 100 wasn't looked at")
    early = {name: values[table["step"] < 100] for name, values in table.items()}
    assert verdict.verdict(early, np.arange(2), SCENE, "agent1").endswith(": units and frames fit the scene")


def test_anchors_that_are_in_sight_are_judged(seen):
    table, _ = seen
    assert "not judged" not in verdict.verdict(table, np.arange(2), SCENE, "agent1")


@pytest.mark.slow
def test_distances_alone_are_said_to_be_for_methods_that_can_use_them(seen, tmp_path):
    measured = gs.simulate(SCENE, "agent1", 1)
    empty = np.full(len(measured.step), np.nan)
    measured.to_csv(tmp_path / "all.csv")
    replace(measured, aod_rad=empty, aoa_rad=empty).to_csv(tmp_path / "far.csv")
    line = "  distances alone: for --method va; grid, adaptive, refa need angles"
    assert line in describe(tmp_path / "far.csv", SCENE)
    assert line not in describe(tmp_path / "all.csv", SCENE)
