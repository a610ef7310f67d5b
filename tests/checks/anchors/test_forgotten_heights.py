"""Anchors at several heights in a scene without any: the heights are named, not an offset of clocks."""

import re
from dataclasses import replace

import numpy as np
import pytest
from check_tables import suspected_of
from lab_samples import heard, lab, suspected

import gridslam as gs

CANYON = gs.Scene.load("canyon")
HEIGHTS_M = np.array([3.2, 2.0, 1.2])


@pytest.mark.slow
def test_the_height_of_each_anchor_is_named():
    heard = gs.simulate(CANYON, "agent1", 63)
    (line,) = suspected_of(
        replace(heard, distance_m=np.hypot(heard.distance_m, HEIGHTS_M[heard.anchor])), CANYON
    )
    found = dict(re.findall(r"([ABC]) ([\d.]+)", re.search(r"by about \((.*?)\)", line)[1]))
    assert "the scene has no heights" in line
    assert "clocks" not in line
    np.testing.assert_allclose([float(found[name]) for name in "ABC"], HEIGHTS_M, atol=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [31, 32])
def test_a_height_of_all_anchors_is_named_beside_what_explains_as_much(seed):
    """0.8 m in a room: offsets and places of anchors fit within some nats of it."""
    room = gs.Scene.load("room")
    heard = gs.simulate(room, "agent1", seed)
    (line,) = suspected_of(replace(heard, distance_m=np.hypot(heard.distance_m, 0.8)), room)
    assert "probably slant ranges of all anchors" in line
    assert float(re.search(r"about ([\d.]+) m above", line)[1]) == pytest.approx(0.8, abs=0.1)
    assert suspected_of(heard, room) == []


@pytest.mark.slow
@pytest.mark.parametrize("told_m", [0.2, 2.5])
def test_another_height_of_the_agent_is_named(told_m):
    """The lines of sight fit well with 0.2 m for 1.0 m, and anchors seem to stand elsewhere with 2.5 m."""
    (found,) = suspected(heard(height_m=1.0), lab(height_m=told_m))
    assert (found.kind, found.certain) == ("rise", True)
    assert f"height_m at about 1.0, not {told_m:g}" in found.text


@pytest.mark.slow
def test_the_right_height_of_the_agent_is_let_pass_and_one_within_what_is_told():
    assert suspected(heard(height_m=1.0), lab(height_m=1.0)) == []
    assert suspected(heard(height_m=1.0), lab(height_m=1.4, height_std_m=0.3)) == []


@pytest.mark.slow
def test_heights_that_are_left_out_come_before_an_anchor_elsewhere():
    (found,) = suspected(heard(height_m=1.0), lab())
    assert found.kind == "slant"
    assert "(north 1.5, south 0.8) m: the scene has no heights" in found.text


@pytest.mark.slow
def test_an_anchor_that_stands_elsewhere_isnt_taken_for_a_height():
    right, told = heard(height_m=1.0), lab(height_m=1.0)
    moved = [{"name": one.name, "position_m": one.position_m} for one in told.anchors]
    moved[0]["position_m"] = (1.7, 4.5, 2.5)
    turns = [{"orientation_deg": one.orientation_deg} for one in told.anchors]
    anchors = [one | turn for one, turn in zip(moved, turns, strict=True)]
    wrong = gs.Scene.checked({**told.model_dump(exclude_none=True), "anchors": anchors}, "wrong")
    (found,) = suspected(right, wrong)
    assert found.kind == "place"
    assert "anchor north stands near (1.0, 4.5)" in found.text


@pytest.mark.slow
def test_amplitudes_that_go_by_slant_ranges_arent_doubted_beside_the_heights():
    """By lengths on the plan they look like decibels: nearer to an anchor they fall behind."""
    room = gs.Scene.load("room")
    table = gs.simulate(room, "agent1", 31)
    long = np.hypot(table.distance_m, 2.4)
    heights = replace(table, distance_m=long, amplitude=table.amplitude * table.distance_m / long)
    assert not [line for line in suspected_of(heights, room) if line.startswith("amplitude")]


@pytest.mark.slow
def test_distances_in_the_plan_are_named_where_the_scene_has_heights():
    right = heard(height_m=0.3)
    rise = np.array([2.5, 1.0, 1.8])[right["anchor"]] - 0.3
    flat = np.sqrt(np.maximum(right["distance_m"] ** 2 - rise**2, 0.01))
    (found,) = suspected(right | {"distance_m": flat}, lab(height_m=0.3))
    assert (found.column, found.kind) == ("distance_m", "plan")
    assert "distances in the plan" in found.text
