"""Anchors that nothing ties to another one or to the start: a table fits however they stand."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.checks.columns.time_units import slow_times
from gridslam.checks.sights.handovers import Ties
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.checks.verdicts.verdict import verdict

SCENE = gs.Scene.load("hall")
"""Two anchors far from each other: A is in sight at first, B later, both in between."""


@pytest.fixture(scope="module")
def heard():
    return dict(gs.simulate(SCENE, "agent1", 1).columns)


def _apart(table):
    """The same without A from where B comes into sight on, and with a silence of some steps between them."""
    anchor, step = table["anchor"], table["step"]
    first = step[(anchor == 1)].min()
    sights = Ties.of(table, SCENE, "agent1").seen.sights
    change = int(step[sights[1][0]]) + 20
    kept = np.where(anchor == 0, step < change - 10, step > change)
    assert first < change
    return {name: values[kept] for name, values in table.items()}


def _vague():
    """The scene with any heading at the start."""
    body = SCENE.agent("agent1")
    vague = body.model_copy(update={"prior": body.prior.model_copy(update={"heading_deg": 180.0})})
    return SCENE.model_copy(update={"agents": (vague, *SCENE.agents[1:])})


def test_anchors_heard_at_once_are_tied(heard):
    ties = Ties.of(heard, SCENE, "agent1")
    assert ties.handovers.tied(0, 1)
    assert ties.start.anchors == (0,)
    assert ties.start.gap_m < 0.1
    assert ties.untied(SCENE, "agent1") == []


def test_an_anchor_that_is_heard_alone_is_not_tied(heard):
    ties = Ties.of(_apart(heard), SCENE, "agent1")
    assert not ties.handovers.tied(0, 1)
    assert ties.untied(SCENE, "agent1") == [1]  # A is tied to the start


def test_nor_is_one_that_is_turned(heard):
    """It puts the agent elsewhere than the other one does."""
    aod = heard["aod_rad"] + np.where(heard["anchor"] == 1, np.radians(20), 0.0)
    assert Ties.of(heard | {"aod_rad": aod}, SCENE, "agent1").untied(SCENE, "agent1") == [1]


def test_a_vague_start_ties_nothing(heard):
    scene = _vague()
    assert Ties.of(_apart(heard), scene, "agent1").untied(scene, "agent1") == [0, 1]


def test_a_table_that_fits_is_said_to_fit_as_far_as_anchors_tell(heard, monkeypatch):
    table = _apart(heard)
    fits = replace(explain(table, SCENE, "agent1"), explained=0.95)
    monkeypatch.setattr("gridslam.checks.verdicts.verdict.followed", lambda *_: fits)
    line = verdict(table, np.arange(2), SCENE, "agent1")
    assert "units and frames fit the scene as far as anchor A tells" in line
    assert "; not sure: anchor B is heard alone, or not where others put the agent: how it is turned" in line
    fits = replace(explain(heard, SCENE, "agent1"), explained=0.95)
    assert "unsure" not in verdict(heard, np.arange(2), SCENE, "agent1")


def test_without_departures_sights_that_are_near_in_time_tie(heard, monkeypatch):
    table = _apart(heard)
    table = {name: values for name, values in table.items() if name != "aod_rad"}
    assert Ties.of(table, SCENE, "agent1") is None
    fits = replace(explain(table, SCENE, "agent1"), explained=0.95)
    monkeypatch.setattr("gridslam.checks.verdicts.verdict.followed", lambda *_: fits)
    assert "unsure" not in verdict(table, np.arange(2), SCENE, "agent1")
    assert "not sure: anchor A is heard alone" in verdict(table, np.arange(2), _vague(), "agent1")


def test_a_start_out_of_sight_is_said_not_to_be_judged(heard, monkeypatch):
    fits = replace(explain(heard, SCENE, "agent1"), explained=0.95)
    monkeypatch.setattr("gridslam.checks.verdicts.verdict.followed", lambda *_: fits)
    told = "; whether the start and its heading are right can't be told"
    assert told not in verdict(heard, np.arange(2), SCENE, "agent1")
    monkeypatch.setattr("gridslam.checks.sights.handovers.LEAST_FIRST", 100)
    assert told in verdict(heard, np.arange(2), SCENE, "agent1")


def test_milliseconds_are_told_of_an_agent_that_nobody_has_in_sight_at_first(heard):
    """The filter of lines of sight looks at 100 steps, and finds no way there; anchors tell later."""
    late = {name: values[(heard["step"] > 130) | (heard["anchor"] == 1)] for name, values in heard.items()}
    sight, ties = explain(late, SCENE, "agent1"), Ties.of(late, SCENE, "agent1")
    still = replace(sight, position_m=np.zeros_like(sight.position_m))
    assert slow_times(late | {"time_s": 1e3 * late["time_s"]}, still) == []
    (found,) = slow_times(late | {"time_s": 1e3 * late["time_s"]}, still, ties)
    assert (found.column, found.kind) == ("time_s", "milliseconds")
    assert slow_times(late, still, ties) == []
