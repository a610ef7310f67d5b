"""Anchors that stand elsewhere than the scene says, in `check` and in `run`: named, and nobody falsely."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs
from gridslam.checks.runs.range_note import range_note
from gridslam.checks.verdicts.diagnose import describe, suspicions
from gridslam.inference.health.range_fits import Crossing, Fit, Gaps, Thing, errors_of, fitted, named_together

CANYON, HALL = shortened(gs.Scene.load("canyon"), 110), gs.Scene.load("hall")


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
@pytest.mark.parametrize(
    ("metres", "words"), [(1.5, r"1\.[45]\d m .* too long"), (-0.9, r"0\.[89]\d m .* too short")]
)
def test_an_offset_of_an_anchor_that_is_out_of_sight_for_longer_than_a_filter_looks_is_named(metres, words):
    """In hall B comes into sight at step 140, where the filter of lines of sight looks at 100."""
    table = gs.simulate(HALL, "agent1", 56)
    late = replace(table, distance_m=np.abs(table.distance_m + metres * (table.anchor == 1)))
    ((kind, item),) = kinds(HALL, late)
    assert kind == "offset"
    assert re.search(f"distances of anchor B seem {words}", item.text)
    assert f"; {'subtract' if metres > 0 else 'add'} it, or give the scene [clocks]" in item.text
    assert "anchor A" not in item.text
    assert re.search("distances of anchor B", range_note(HALL, "agent1", late))
    assert kinds(HALL, table) == []


def test_all_that_explains_the_same_is_named():
    shift, offsets = Fit(Thing((4, 5)), 10.0, (0.6, 0.6)), [Fit(Thing((j,)), 9.0 + j, (0.7,)) for j in (0, 1)]
    said = named_together([*offsets, shift], gs.Scene.load("room").filter_model("agent1"))
    assert [said.count(f"distances of anchor {name} seem 0.70 m") for name in "AB"] == [1, 1]
    assert said.startswith("distances of anchor A")
    assert said.count("anchor A stands near (-2.5, 2.8)") == 1
    said = named_together([shift, offsets[1]], gs.Scene.load("room").filter_model("agent1"))
    assert said.startswith("anchor A stands near")
    assert ", or distances of anchor B" in said


def test_a_height_whose_square_is_negative_is_none():
    """Distances that are too short were explained by a height of the root of -7 m^2."""
    crossings = np.zeros((2, 2, errors_of(2)))
    crossings[0, :, -1], crossings[1, :, -1] = [0.1, 0.0], [0.0, 0.2]
    gaps = Gaps.of(
        Crossing(np.array([[0.0, 0.0], [-0.3, -0.6]]), np.tile(400 * np.eye(2), (2, 1, 1)), crossings)
    )
    for sign in (1, -1):
        turned = gaps._replace(vector=sign * gaps.vector)
        fit, errors = fitted(turned, Thing((errors_of(2) - 1,)))
        plain, _ = fitted(turned, Thing(()))
        assert (fit.size[0] > 0) == (errors[-1] > 0) == (fit.misfit < plain.misfit)


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
