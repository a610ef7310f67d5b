"""Scenes as figures: all that is in them, by name."""

import numpy as np
import pytest

import gridslam as gs
from gridslam.drawing.anchor_labels import side_of
from gridslam.drawing.map_figure import encoded
from gridslam.drawing.scene_figure import draw_scene
from gridslam.world.geometry import unit


def words(figure):
    (axes,) = figure.axes
    return {text.get_text() for text in axes.texts}, {t.get_text() for t in figure.legends[0].get_texts()}


def test_walls_anchors_and_agents_are_there_with_their_names():
    written, legend = words(draw_scene(gs.Scene.load("canyon")))
    assert {"A", "B", "C", "agent1", "agent2", "curved front", "window", "south"} <= written
    assert {"concrete (0.7)", "glass (0.3)", "agent1's way", "agent2's way", "region to map"} <= legend


def test_walls_that_do_not_reflect_are_said_to_and_dashed():
    figure = draw_scene(gs.Scene.load("screen"))
    assert "hides lines of sight alone" in words(figure)[1]
    (dashed,) = [one for one in figure.axes[0].collections if one.get_label().startswith("hides")]
    assert dashed.get_linestyle()[0][1] is not None


def test_all_is_within_the_picture_what_lies_beyond_the_region_too():
    room = gs.Scene.load("room").model_dump(exclude_none=True)
    far = {"material": "concrete", "points_m": ((-4000.0, 0.0), (-3000.0, 0.0))}
    axes = draw_scene(gs.Scene.checked({**room, "walls": [far]}, "far")).axes[0]
    assert axes.get_xlim()[0] < -4000
    assert axes.get_xlim()[1] > room["grid"]["x_m"][1]


def test_a_way_of_one_step_has_no_arrows():
    room = gs.Scene.load("room").model_dump(exclude_none=True)
    short = gs.Scene.checked({**room, "agents": [{**room["agents"][0], "steps": 1}]}, "short")
    assert len(encoded(draw_scene(short))) > 5000


def test_a_scene_of_anchors_alone_and_names_with_dollars_are_drawn():
    room = gs.Scene.load("room").model_dump(exclude_none=True)
    anchor = {**room["anchors"][0], "name": "a$b$"}
    bare = gs.Scene.checked({"grid": room["grid"], "anchors": [anchor], "name": "$x$"}, "bare")
    assert encoded(draw_scene(bare), "svg").lstrip().startswith(b"<?xml")


@pytest.mark.slow
@pytest.mark.parametrize("name", gs.bundled_scenes())
def test_every_bundled_scene_is_drawn_at_the_width_of_a_column(name):
    assert len(encoded(draw_scene(gs.Scene.load(name), 3.5))) > 5000


def test_names_of_anchors_stand_clear_of_arrows():
    scene, corners = gs.Scene.load("exchange"), np.array([[-20.0, -20.0], [20.0, 20.0]])
    for angle in np.radians([45, 135, -135, -45]):
        side = side_of(np.zeros(2), scene, corners, unit(angle))
        assert side @ unit(angle) < 0.1
