"""Notes of a run on its distances: an offset of clocks is named, and nothing where nothing is wrong."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scene_samples import shortened
from tables import late

import gridslam as gs
from gridslam.checks.runs.range_note import fits_scene, range_note
from gridslam.checks.verdicts.diagnose import describe, suspicions

ROOM = shortened(gs.Scene.load("room"), 60)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("metres", "anchor", "words"),
    [(1.5, None, "of all anchors are 1.[45]. m .* long"), (-1.5, 1, "of anchor B are 1.[45]. m .* short")],
)
def test_clocks_that_are_off_are_named_with_sign_size_and_cure(metres, anchor, words):
    measurements = gs.simulate(ROOM, "agent1", seed=12)
    note = range_note(ROOM, "agent1", late(measurements, metres, anchor))
    assert note is not None
    assert re.search(words, note)
    keys = re.search(r"give the scene \[clocks\] with (.*) and run network SLAM", note)
    assert keys is not None
    table = keys[1].replace(", ", "\n")
    advised = gs.Scene.from_toml(f"{ROOM.to_toml()}\n[clocks]\n{table}\n", "advised")
    heard = late(measurements, metres, anchor)
    columns = {name: np.asarray(values) for name, values in heard.columns.items()}
    assert suspicions(columns, heard.anchors, advised, "agent1") == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [13, 14])
def test_right_distances_are_not_named(seed):
    whole = gs.Scene.load("room")
    assert range_note(whole, "agent1", gs.simulate(whole, "agent1", seed=seed)) is None


def test_nothing_is_said_where_nothing_can_be_known():
    measurements = gs.simulate(ROOM, "agent1", seed=12)
    angles = dict.fromkeys(("aod_rad", "aoa_rad"), np.full(len(measurements.distance_m), np.nan))
    assert range_note(ROOM, "agent1", replace(late(measurements, 1.5), **angles)) is None
    clocks = {**ROOM.model_dump(exclude_none=True), "clocks": {"anchor_prior_ns": 10.0}}
    assert range_note(gs.Scene.checked(clocks, "room"), "agent1", late(measurements, 1.5)) is None
    assert range_note(ROOM, "agent1", replace(late(measurements, 1.5), anchors=("A", "C"))) is None


@pytest.mark.slow
def test_without_walls_an_offset_is_named_too():
    """Which anchors are hidden nobody knows there: evidence decides."""
    bare = gs.Scene.checked({**ROOM.model_dump(exclude_none=True), "walls": []}, "bare")
    measurements = gs.simulate(ROOM, "agent1", seed=12)
    hidden = (measurements.anchor == 1) & (measurements.step > 20)  # as behind a wall: reflections are left
    shown = replace(measurements, aoa_rad=np.where(hidden, np.nan, measurements.aoa_rad))
    note = range_note(bare, "agent1", late(shown, 1.5))
    assert note is not None
    assert "of all anchors are 1." in note


def test_exchanged_anchors_do_not_fit_and_right_ones_do():
    measurements = gs.simulate(ROOM, "agent1", seed=12)
    exchanged = replace(measurements, anchor=1 - measurements.anchor)
    for walls in (ROOM.walls, ()):
        scene = ROOM.model_copy(update={"walls": walls})
        assert fits_scene(scene, "agent1", measurements)
        assert not fits_scene(scene, "agent1", exchanged)


@pytest.mark.slow
def test_one_anchor_without_departures_is_not_judged_by_when_walls_hide_it(tmp_path):
    """By length and AoA alone the agent may go around the anchor: `check` called such tables suspect."""
    scene = gs.Scene.load("screen")
    measurements = gs.simulate(scene, "agent1", 6)
    assert np.isnan(measurements.aod_rad).all()
    assert fits_scene(scene, "agent1", measurements)
    measurements.to_csv(tmp_path / "a.csv")
    assert describe(tmp_path / "a.csv", scene)[-1].startswith("unsure: line of sight to the anchors in ")
    turned = replace(measurements, aoa_rad=np.random.default_rng(1).permutation(measurements.aoa_rad))
    assert not fits_scene(scene, "agent1", turned)
