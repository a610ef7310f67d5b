"""A true track that isn't of the scene or of what was heard is told of, and no right one is."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs
from gridslam.checks.runs.truth_fit import _Scans, truth_note

ROOM = shortened(gs.Scene.load("room"), 30)
HEARD = gs.simulate(ROOM, "agent1", 3)

LEFT = np.where(np.arange(30)[:, None] < 1, 0.0, [2.0, 1.0])
"""Off all along, but for where the agent starts."""


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
@pytest.mark.parametrize("heard", [moved(HEARD, LEFT), replace(HEARD, aod_rad=HEARD.aod_rad + 1.0)])
def test_a_track_that_nothing_was_heard_from_is_named(heard, walls):
    note = truth_note(ROOM.model_copy(update={"walls": walls}), "agent1", heard)
    assert note.startswith("what was heard doesn't fit the true track: ")
    assert (" scans (an anchor at a step) with the anchor in view" in note) == bool(walls)


def test_a_track_out_of_the_plan_is_named_of_signals_too():
    note = truth_note(ROOM, "agent1", moved(HEARD, np.linspace([9.0, 0.0], [9.0, 5.0], 30)))
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


def placed(measurements, x, y):
    truth = measurements.truth
    return replace(measurements, truth=replace(truth, position_m=np.stack([x, y], -1)))


@pytest.mark.parametrize(
    ("far", "way", "words"),
    [
        (1.0, lambda x, y: (y, x), "with x and y exchanged"),
        (1.0, lambda x, y: (-x, y), "with the sign of x turned"),
        (1.0, lambda x, y: (-y, x), "turned by -90 degrees about x = y = 0"),
        (1.0, lambda x, y: (x + 2.0, y + 1.4), "moved by (-2.00, -1.40) m, to where the scene has agent1"),
        (0.2, lambda x, y: (y, x), "with x and y exchanged"),
    ],
)
def test_a_track_in_another_frame_is_named_whatever_fits_as_it_stands(far, way, words):
    """On a way that is near the diagonal for most of its time, more than half of all fits the wrong one."""
    steps = np.linspace(0.0, 1.0, 60)
    x, y = -2.0 + 2.6 * steps, -2.0 + 2.6 * steps + np.maximum(steps - 1.0 + far, 0.0) * 1.4 / far
    points = list(zip(x.tolist(), y.tolist(), strict=True))
    scene, heard = ROOM, HEARD
    if far < 1.0:
        data = ROOM.model_dump(exclude_none=True)
        own = {"start_m": points[0], "waypoints_m": [points[47], points[-1]], "steps": 60, "step_m": 0.08}
        data["agents"] = [{**data["agents"][0], **own, "start_heading_deg": 45.0}]
        scene = gs.Scene.checked(data, "r")
        heard = gs.simulate(scene, "agent1", 1)
    assert truth_note(scene, "agent1", heard) is None
    note = truth_note(scene, "agent1", placed(heard, *way(*heard.truth.position_m.T)))
    assert note.startswith(f"the true track fits what was heard far better {words}"), note
    assert note.endswith("the errors above are by this track")
    if far < 1.0:
        fits, judged = _Scans.of(scene, "agent1", heard).fits(heard.truth.position_m[:, ::-1])
        assert fits[judged].mean() > 0.6


def test_a_faint_radio_is_no_misfit():
    """In the middle of the room it hears a third of all lines of sight."""
    data = ROOM.model_dump(exclude_none=True)
    data["radio"]["snr_at_1m_db"] = 15.0
    scene = gs.Scene.checked(data, "faint")
    heard = gs.simulate(scene, "agent1", 1)
    fits, judged = _Scans.of(scene, "agent1", heard).fits(heard.truth.position_m)
    assert judged.sum() > 30
    assert fits[judged].mean() < 0.5
    assert truth_note(scene, "agent1", heard) is None
    far = moved(heard, LEFT)
    assert truth_note(scene, "agent1", far) is not None


def test_the_frame_of_a_track_is_named_where_most_lines_of_sight_go_unheard():
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    data["radio"]["snr_at_1m_db"] = 15.0
    scene = gs.Scene.checked(data, "faint")
    heard = gs.simulate(scene, "agent1", 1)
    x, y = heard.truth.position_m.T
    note = truth_note(scene, "agent1", placed(heard, y, x))
    assert note.startswith("the true track fits what was heard far better with x and y exchanged")


def test_steps_in_a_hole_of_the_track_are_not_judged():
    truth = HEARD.truth
    holes = np.array([[truth.time_s[5], truth.time_s[28]]])
    away = truth.position_m.copy()
    away[6:28] += [2.0, -1.0]
    bent = replace(HEARD, truth=replace(truth, position_m=away, holes_s=holes))
    assert truth_note(ROOM, "agent1", replace(bent, truth=replace(bent.truth, holes_s=None))) is not None
    assert truth_note(ROOM, "agent1", bent) is None


def test_exchanged_anchors_that_look_like_a_turned_track_are_not_said_to_be_one():
    """Half a turn of `room` exchanges its anchors, with what they face."""
    note = truth_note(ROOM, "agent1", replace(HEARD, anchor=1 - HEARD.anchor))
    assert "turned by 180 degrees" in note
    assert "or exchanged; the errors" in note
