"""Anchors that an earlier map says are in sight: named if they fall silent for long, and never else."""

from dataclasses import replace

import numpy as np
import pytest
from room_tracks import ROOM, STEPS, went

import gridslam as gs
from gridslam.checks.runs.silent_sights import LEAST_STEPS, silent_sights
from gridslam.maps.map import Map

MODEL = ROOM.filter_model("agent1")


@pytest.fixture(scope="module")
def heard():
    return gs.simulate(ROOM, "agent1", seed=3)


@pytest.fixture(scope="module")
def free():
    """A map in which every cell is surely free."""
    grid = Map.blank(ROOM.grid.origin_m, ROOM.grid.cell_m, ROOM.grid.shape, 0.05)
    return replace(grid, evidence=np.full(grid.shape, -9.0), observed=np.ones(grid.shape, bool))


def without_sight(heard, anchor, steps):
    """The table without what an anchor sent straight at some steps."""
    place = ROOM.track("agent1").position_m[heard.step]
    length = np.hypot(*(MODEL.anchor_positions[heard.anchor] - place).T)
    straight = (
        (np.abs(heard.distance_m - length) < 0.5) & (heard.anchor == anchor) & np.isin(heard.step, steps)
    )
    rows = np.flatnonzero(~straight)
    names = ("step", "time_s", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    return replace(heard, **{name: getattr(heard, name)[rows] for name in names})


def test_an_anchor_that_falls_silent_behind_free_cells_is_named_with_how_often(heard, free):
    assert silent_sights(went(), heard, free, MODEL) == []
    quiet = range(5, 5 + LEAST_STEPS)
    ((name, expected, silent),) = silent_sights(went(), without_sight(heard, 1, quiet), free, MODEL)
    assert name == MODEL.anchor_names[1]
    assert silent >= len(quiet)
    assert silent < expected <= STEPS
    assert silent_sights(went(), without_sight(heard, 1, quiet[1:]), free, MODEL) == [], "not for long enough"


def test_cells_that_nobody_knows_or_that_may_be_wall_promise_nothing(heard, free):
    silent = without_sight(heard, 1, range(STEPS))
    assert silent_sights(went(), silent, free, MODEL)
    unknown = replace(free, observed=np.zeros(free.shape, bool))
    doubtful = replace(free, evidence=np.full(free.shape, -2.0))
    for grid in (unknown, doubtful):
        assert silent_sights(went(), silent, grid, MODEL) == []


def test_what_stands_in_the_way_by_now_explains_silence(heard, free):
    silent = without_sight(heard, 1, range(STEPS))
    blocked = replace(free, evidence=np.full(free.shape, 5.0))
    assert silent_sights(went(), silent, free, MODEL, free)
    assert silent_sights(went(), silent, free, MODEL, blocked) == []


def test_an_agent_that_is_known_badly_says_nothing(heard, free):
    assert silent_sights(went(std_m=0.4), without_sight(heard, 1, range(STEPS)), free, MODEL) == []
