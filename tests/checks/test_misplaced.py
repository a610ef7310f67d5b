"""Anchors that stand elsewhere than the scene says, in `check` and in `run`: named, and nobody falsely."""

import re
from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.checks.diagnose import describe, suspicions
from gridslam.checks.range_note import range_note

CANYON = gs.Scene.load("canyon")


def told_elsewhere(scene, anchor, shift):
    """The scene as somebody gives it who has an anchor's place wrong."""
    anchors = list(scene.anchors)
    there = np.array(anchors[anchor].position_m) + shift
    anchors[anchor] = anchors[anchor].model_copy(update={"position_m": tuple(there.tolist())})
    return scene.model_copy(update={"anchors": tuple(anchors)})


def kinds(scene, table):
    columns = {name: np.asarray(values) for name, values in table.columns.items()}
    return [(item.kind, item) for item in suspicions(columns, table.anchors, scene, "agent1")]


@pytest.mark.slow
def test_the_anchor_is_named_and_where_it_stands_and_no_clock_or_start():
    table = gs.simulate(CANYON, "agent1", 51)
    found = kinds(told_elsewhere(CANYON, 0, (0.8, -0.6)), table)
    assert [kind for kind, _ in found] == ["place"]
    x, y = map(
        float, re.search(r"anchor A stands near \((-?[\d.]+), (-?[\d.]+)\)", found[0][1].text).groups()
    )
    np.testing.assert_allclose([x, y], CANYON.anchor_positions[0], atol=0.2)
    assert found[0][1].certain


@pytest.mark.slow
def test_strays_over_walls_change_nothing():
    """Lines of sight of one anchor that come over a wall at every third step, as behind a pillar."""
    table = gs.simulate(CANYON, "agent1", 52)
    rows = (table.anchor == 1) & (table.step % 3 == 0)
    strayed = replace(table, distance_m=table.distance_m + 4.0 * rows)
    (kind, item), *more = kinds(told_elsewhere(CANYON, 0, (0.8, -0.6)), strayed)
    assert (kind, more) == ("place", [])
    assert "anchor A stands near" in item.text


@pytest.mark.slow
def test_an_offset_is_still_an_offset():
    table = gs.simulate(CANYON, "agent1", 53)
    late = replace(table, distance_m=table.distance_m + 1.5 * (table.anchor == 1))
    ((kind, item),) = kinds(CANYON, late)
    assert kind == "offset"
    assert "anchor B" in item.text


@pytest.mark.slow
@pytest.mark.parametrize("name", ["room", "pillars"])
def test_right_places_are_not_doubted(name):
    scene = gs.Scene.load(name)
    assert "place" not in [kind for kind, _ in kinds(scene, gs.simulate(scene, "agent1", 54))]


@pytest.mark.slow
def test_check_and_run_say_so_in_one_line(tmp_path):
    scene, table = told_elsewhere(CANYON, 2, (-0.7, 0.7)), gs.simulate(CANYON, "agent1", 55)
    table.to_csv(tmp_path / "heard.csv")
    lines = [line for line in describe(tmp_path / "heard.csv", scene) if line.startswith("suspect")]
    assert len(lines) == 1
    assert "anchor C stands near" in lines[0]
    assert "anchor C stands near" in range_note(scene, "agent1", table)
    assert range_note(CANYON, "agent1", table) is None
