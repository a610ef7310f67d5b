"""A table with a hole in time, whose steps are counted on: the agent went on meanwhile."""

import numpy as np
import pytest

import gridslam as gs
from gridslam.checks.sights.particles import ENOUGH, Scans
from gridslam.checks.verdicts.diagnose import describe

SCENE = gs.Scene.load("room")
HEARD = gs.simulate(SCENE, "agent1", 1)


def with_hole(first, last):
    """The table without the steps between, the others counted one by one."""
    kept = (HEARD.step < first) | (HEARD.step >= last)
    columns = {name: values[kept] for name, values in HEARD.columns.items()}
    columns["step"] = np.unique(columns["step"], return_inverse=True)[1]
    return gs.Measurements(**columns, anchors=SCENE.anchor_names)


@pytest.mark.usefixtures("no_figures")
def test_a_right_table_is_judged_by_what_came_before_its_hole(tmp_path):
    with_hole(40, 120).to_csv(tmp_path / "hole.csv")
    said = describe(tmp_path / "hole.csv", SCENE)
    assert any("from step 39 to step 40, with nothing between" in line for line in said)
    assert "of the first 40 steps: units and frames fit the scene" in said[-1]


@pytest.mark.parametrize(("first", "looked_at"), [(40, 40), (ENOUGH, ENOUGH), (ENOUGH - 1, 100)])
def test_too_few_steps_before_a_hole_are_followed_across(first, looked_at):
    columns = with_hole(first, first + 60).columns
    assert Scans.of(columns, 100).steps == looked_at
    without = {name: values for name, values in columns.items() if name != "time_s"}
    assert Scans.of(without, 100).steps == 100


def test_holes_that_steps_count_are_followed_across():
    kept = (HEARD.step < 40) | (HEARD.step >= 100)
    columns = {name: values[kept] for name, values in HEARD.columns.items()}
    assert Scans.of(columns, 200).steps == 200
    assert Scans.of(with_hole(40, 100).columns, 200, across=True).steps == 200


@pytest.mark.parametrize("time", [0.01 * np.arange(100) + 0.5 * (np.arange(100) > 39), np.arange(100) // 40])
def test_a_stall_and_times_in_whole_seconds_are_no_holes(time):
    columns = {"step": np.arange(100), "time_s": time.astype(float), "anchor": np.zeros(100, int)}
    assert Scans.of(columns, 100).steps == 100


def test_irregular_times_have_no_hole():
    draw = np.random.default_rng(1)
    time = np.cumsum(draw.exponential(0.1, 200))
    columns = {"step": np.arange(200), "time_s": time, "anchor": np.zeros(200, int)}
    assert Scans.of(columns, 100).steps == 100
