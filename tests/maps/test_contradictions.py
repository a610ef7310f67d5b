"""Walls of one map through what another found free are told of; walls that both have are not."""

from dataclasses import replace

import numpy as np
import pytest
from map_samples import surfaces

import gridslam as gs
from gridslam.maps.contradictions import MOST_NAMED, contradictions, crossed_m, moved_walls
from gridslam.maps.map import Map

SIDE = 60


def house(wall_m, free=True, beside=0.0):
    """A square of 6 m, free but for a wall along y at some x, which cells off by `beside` bear out."""
    blank = Map.blank((0.0, 0.0), 0.1, (SIDE, SIDE), 0.01)
    evidence = np.full((SIDE, SIDE), -8.0 if free else 0.0)
    column = int((wall_m + beside) / 0.1)
    evidence[:, column] = 8.0
    coefficient = np.zeros((SIDE, SIDE, blank.coefficient.shape[-1]))
    coefficient[:, column, -1] = 5.0
    posterior = np.full((1, blank.coefficient.shape[-1]), 1 / blank.coefficient.shape[-1])
    found = surfaces([(0.0, wall_m)], extent=(0.0, 6.0))
    marks = {"agents": ["a"], "anchors": ["A"], "anchor_x_m": [1.0], "anchor_y_m": [1.0]}
    return Map(
        (0.0, 0.0), 0.1, evidence, coefficient, evidence != 0, 0.01, found, posterior,
        {**marks, "runs": [f"{wall_m}{beside}"]},
    )  # fmt: skip


def test_a_wall_through_free_cells_is_told_of():
    one, other = house(2.05), house(4.05)
    assert crossed_m(one, other) == pytest.approx((6.0, 6.0), abs=0.2)
    (line,) = contradictions([one, other], ["a.h5", "b.h5"])
    assert line.startswith("a.h5: 6 of 6 m of the walls run through free cells of b.h5: another floor")


def test_walls_that_agree_or_that_nobody_looked_at_are_left_in_peace():
    one = house(2.05)
    for other in (one, house(2.05, beside=0.1), house(4.05, free=False)):
        assert crossed_m(one, other)[0] == 0.0
    assert contradictions([one, one, house(2.05, beside=0.1)], ["a", "b", "c"]) == []


def test_a_door_that_was_shut_since_is_no_other_floor():
    one, door = house(2.05), house(2.05)
    evidence = door.evidence.copy()
    evidence[20:30] = -8.0
    assert contradictions([one, replace(door, evidence=evidence)], ["a", "b"]) == []


def gone(grid, *stretches):
    """The map after paths went through stretches (rows) of its wall."""
    evidence = grid.evidence.copy()
    for rows in stretches:
        evidence[rows] = -8.0
    return replace(grid, evidence=evidence)


def test_a_wall_that_paths_went_through_is_named_from_where_to_where():
    one = house(2.12)
    said = moved_walls(one, gone(one, slice(10, 40)), "one/map.h5")
    assert said == (
        "walls of one/map.h5 through which paths went since, 3 m in all: they have moved or are gone: "
        "from (2.1, 1.0) to (2.1, 4.0)"
    )
    assert moved_walls(one, one, "one/map.h5") is None
    assert moved_walls(one, gone(one, slice(20, 29)), "one/map.h5") is None, "a door has opened"


def test_what_lies_between_two_stretches_is_one_with_them_if_it_is_short():
    one = house(2.12)
    said = moved_walls(one, gone(one, slice(0, 20), slice(22, 40), slice(45, 60)), "m")
    assert said is not None
    assert said.endswith("gone: from (2.1, 0.0) to (2.1, 4.0), from (2.1, 4.5) to (2.1, 6.0)")


def test_the_longest_are_named_and_the_others_counted():
    one = house(2.05)
    stretches = [slice(first, first + 12) for first in (0, 20, 40)]
    more = surfaces([(0.0, x) for x in (1.05, 2.05, 4.05)], extent=(0.0, 6.0))
    evidence, coefficient = one.evidence.copy(), one.coefficient.copy()
    for column in (10, 40):
        evidence[:, column], coefficient[:, column] = evidence[:, 20], coefficient[:, 20]
    many = replace(
        one, evidence=evidence, coefficient=coefficient, surfaces=more,
        surface_reflection=np.repeat(one.surface_reflection, 3, axis=0),
    )  # fmt: skip
    said = moved_walls(many, gone(many, *stretches), "m")
    assert said is not None
    assert said.count("from") == MOST_NAMED
    assert said.endswith(", 3 more")


def test_fuse_notes_it(say):
    house(2.05).save("a.h5")
    house(4.05).save("b.h5")
    result = say("fuse", "a.h5", "b.h5", "-o", "both.h5")
    assert result.code == 0
    (note,) = result.complaints
    assert note.startswith("note: a.h5: 6 of 6 m of the walls run through free cells of b.h5: another floor")


def test_a_map_without_a_frame_s_name_is_noted_where_the_scene_has_one():
    from gridslam.maps.frames import fitted, stamped

    scene = gs.Scene.load("room")
    named = scene.model_copy(update={"frame": "second floor"})
    plain = stamped(Map.of_scene(scene), scene)
    assert fitted(plain, scene)[1] is None
    said = "map: names no frame; taken for second floor, by its anchors"
    assert fitted(plain, named)[1] == said
    assert fitted(stamped(plain, named), named)[1] is None
