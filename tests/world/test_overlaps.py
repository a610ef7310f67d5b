"""Walls drawn twice, as sides that rooms of a floor plan share: what is there twice reflects once."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gridslam as gs
from gridslam.checks.scene.lines import scene_lines
from gridslam.simulation.image_source import true_paths
from gridslam.world.scene_derived import repeated_walls, repeats_note, segments_of, surface_names
from gridslam.world.scene_parts import Wall

MATERIALS = {"brick": 0.6, "glass": 0.3}


def wall(*points, material="brick", **more):
    return Wall(points_m=points, material=material, **more)


def length_of(pieces):
    return float(np.linalg.norm(pieces.end - pieces.start, axis=1).sum())


def room(extra=(), steps=12):
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    data["agents"][0]["steps"] = steps
    data["materials"]["glass"] = 0.3
    return gs.Scene.checked({**data, "walls": [*data["walls"], *extra]}, "room")


def test_a_room_whose_walls_are_drawn_twice_is_heard_as_if_once():
    once = room()
    given = once.model_dump(exclude_none=True)["walls"]
    reverse = [{**one, "points_m": one["points_m"][::-1]} for one in given]
    part = {"points_m": ((4.0, -2.0), (4.0, 1.0)), "material": "glass"}
    heard = gs.simulate(once, "agent1", seed=1)
    for extra in (given, reverse, [part], [*given, part]):
        twice = room(extra)
        again = gs.simulate(twice, "agent1", seed=1)
        for name in ("step", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude"):
            np.testing.assert_array_equal(getattr(again, name), getattr(heard, name))
        np.testing.assert_array_equal(true_paths(twice, "agent1").segment, true_paths(once, "agent1").segment)


def test_a_side_that_two_rooms_share_is_one_piece():
    left = wall((0, 0), (8, 0), (8, 6), (0, 6), closed=True)
    right = wall((8, 0), (14, 0), (14, 6), (8, 6), closed=True, material="glass")
    both = segments_of([left, right], MATERIALS)
    assert len(both) == 7
    shared = (both.start[:, 0] == 8) & (both.end[:, 0] == 8)
    np.testing.assert_array_equal(both.reflection[shared], [0.6])
    assert len(np.unique(both.surface)) == 5  # and two pairs in one line
    assert repeated_walls([left, right]) == ["walls[1] repeats 6 m of walls[0]"]


def test_what_sticks_out_on_both_sides_stays_and_sides_keep_their_numbers():
    walls = [wall((2, 0), (4, 0)), wall((0, 0), (6, 0), (6, 5), name="long", material="glass")]
    pieces = segments_of(walls, MATERIALS)
    np.testing.assert_allclose(pieces.start[:, 0], [2, 0, 4, 6])
    np.testing.assert_allclose(pieces.end[:, 0], [4, 2, 6, 6])
    np.testing.assert_array_equal(pieces.reflection, [0.6, 0.3, 0.3, 0.3])
    assert surface_names(walls, pieces)[1] == "long, side 2"


def test_walls_that_do_not_reflect_and_those_that_touch_are_as_drawn():
    glass = wall((0, 0), (4, 0), material="glass")
    for other in (
        Wall(points_m=((0, 0), (4, 0)), reflects=False),
        wall((4, 0), (8, 0)),
        wall((1, 0), (1, 3)),
        wall((0, 1e-3), (4, 1e-3)),
    ):
        pieces = segments_of([glass, other], MATERIALS)
        np.testing.assert_array_equal(
            pieces.end - pieces.start, [np.diff(w.corners, axis=0)[0] for w in (glass, other)]
        )
        assert repeats_note([glass, other]) is None


def test_what_blocks_every_path_stays_where_the_other_hides_sights_alone():
    pieces = segments_of(
        [wall((0, 0), (4, 0), blocks="sight"), wall((1, 0), (3, 0), material="glass")], MATERIALS
    )
    np.testing.assert_allclose(pieces.start[:, 0], [0, 3, 1])
    np.testing.assert_array_equal(pieces.wall, [0, 0, 1])


@given(
    ends=st.lists(
        st.tuples(st.floats(-9, 9), st.floats(-9, 9)).filter(lambda e: abs(e[0] - e[1]) > 0.1),
        min_size=1,
        max_size=5,
    ),
    turn=st.floats(0, 6.3),
)
@settings(max_examples=50, deadline=None)
def test_pieces_cover_what_was_drawn_and_never_overlap(ends, turn):
    along = np.array([np.cos(turn), np.sin(turn)])
    walls = [wall(tuple(a * along), tuple(b * along)) for a, b in ends]
    pieces = segments_of(walls, MATERIALS)
    reach = np.sort(np.stack([pieces.start @ along, pieces.end @ along], 1), axis=1)
    low = reach[np.argsort(reach[:, 0])]
    assert (low[1:, 0] - low[:-1, 1] > -1e-5).all()
    drawn = np.sort(ends, axis=1)
    edges = np.unique(drawn)
    middle = 0.5 * (edges[1:] + edges[:-1])
    covered = ((drawn[:, :1] < middle) & (middle < drawn[:, 1:])).any(0)
    assert length_of(pieces) == pytest.approx(float(np.diff(edges)[covered].sum()), abs=1e-4)


def test_check_says_which_walls_repeat_which():
    extra = [{"points_m": ((4.0, -2.0), (4.0, 1.0)), "material": "glass", "name": "pane"}]
    notes = [line for line in scene_lines(room(extra)) if "repeats" in line]
    assert len(notes) == 1
    assert notes[0].startswith(
        "note: walls[1] ('pane') repeats 3 m of walls[0] ('walls'): what is there twice"
    )
