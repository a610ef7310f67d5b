"""A true track that isn't of the scene or of what was heard is told of, and no right one is."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs
from gridslam.checks.runs.truth_fit import truth_note

ROOM = shortened(gs.Scene.load("room"), 30)
HEARD = gs.simulate(ROOM, "agent1", 3)


def moved(measurements, metres):
    truth = measurements.truth
    return replace(measurements, truth=replace(truth, position_m=truth.position_m + metres))


@pytest.mark.parametrize("walls", [ROOM.walls, ()])
@pytest.mark.parametrize(
    "heard",
    [
        HEARD,
        moved(HEARD, [0.3, 0.0]),
        replace(HEARD, truth=replace(HEARD.truth, heading_rad=np.zeros(30))),
        replace(HEARD, distance_m=np.full(len(HEARD.step), np.nan)),
        replace(HEARD, aod_rad=np.full(len(HEARD.step), np.nan)),
        replace(HEARD, truth=None),
        replace(HEARD, distance_std_m=np.full(len(HEARD.step), 2.0), distance_m=HEARD.distance_m + 4.0),
    ],
)
def test_right_tracks_are_not_doubted(heard, walls):
    assert truth_note(ROOM.model_copy(update={"walls": walls}), "agent1", heard) is None


@pytest.mark.parametrize("walls", [ROOM.walls, ()])
@pytest.mark.parametrize("heard", [moved(HEARD, [2.0, 1.0]), replace(HEARD, anchor=1 - HEARD.anchor)])
def test_a_track_that_nothing_was_heard_from_is_named(heard, walls):
    note = truth_note(ROOM.model_copy(update={"walls": walls}), "agent1", heard)
    assert note.startswith("what was heard doesn't fit the true track: ")
    assert (" scans (an anchor at a step) with the anchor in view" in note) == bool(walls)


def test_a_track_out_of_the_plan_is_named_of_signals_too():
    note = truth_note(ROOM, "agent1", moved(HEARD, [9.0, 0.0]))
    assert "leaves the scene's region (x -4.8 to 4.8 m, y -3.8 to 3.8 m) at" in note
    screen = shortened(gs.Scene.load("screen"), 2)
    samples = gs.simulate(screen, "agent1", 1, what="signal")
    assert truth_note(screen, "agent1", samples) is None
    assert "leaves the scene's region" in truth_note(screen, "agent1", moved(samples, [500.0, 0.0]))


def test_offsets_of_clocks_are_no_misfit():
    clocks = gs.Scene.checked(
        {**ROOM.model_dump(exclude_none=True), "clocks": {"anchor_prior_ns": 10.0}}, "r"
    )
    late = replace(HEARD, distance_m=HEARD.distance_m + 3.0)
    assert truth_note(clocks, "agent1", late) is None
    assert truth_note(ROOM, "agent1", late) is not None
