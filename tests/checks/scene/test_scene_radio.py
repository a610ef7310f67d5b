"""A radio that can hardly be meant is named with field and value, before anything is judged by it."""

import pytest
from check_tables import NAMES, SCENES, simulated_columns

import gridslam as gs
from gridslam.checks.scene.lines import hidden_note, implausible_radio, scene_lines
from gridslam.checks.verdicts.diagnose import describe
from gridslam.measurements.table import Measurements


def with_radio(**fields):
    data = SCENES["room"].model_dump(exclude_none=True)
    return gs.Scene.checked({**data, "radio": {**data["radio"], **fields}}, "room")


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"bandwidth_hz": 500.0}, "radio.bandwidth_hz: 500 Hz"),
        ({"carrier_hz": 6000.0, "bandwidth_hz": 5e8}, "radio.carrier_hz: 6000 Hz"),
        ({"carrier_hz": 6e9, "bandwidth_hz": 7e9}, "radio.bandwidth_hz: 7e+09 Hz is more than carrier_hz"),
    ],
)
def test_field_and_value_are_named(fields, words):
    assert any(line.startswith(words) for line in implausible_radio(with_radio(**fields)))


def test_radios_of_bundled_scenes_can_be_meant():
    assert not any(implausible_radio(gs.Scene.load(name)) for name in SCENES)


def test_check_says_so_of_scene_and_table(say, tmp_path):
    scene = with_radio(bandwidth_hz=500.0)
    (tmp_path / "scene.toml").write_text(scene.to_toml())
    columns = simulated_columns("room", 1, steps=5)
    Measurements(**{name: columns[name] for name in NAMES}, anchors=("A", "B")).to_csv(tmp_path / "heard.csv")
    said = say("check", "scene.toml")
    assert (said.code, "suspect: radio.bandwidth_hz: 500 Hz" in said.out) == (1, True)
    (line,) = [one for one in describe(tmp_path / "heard.csv", scene) if one.startswith("suspect")]
    assert "radio.bandwidth_hz: 500 Hz" in line


@pytest.mark.parametrize(("times", "unit"), [(100, "centimetres"), (1000, "millimetres")])
def test_walls_in_other_units_are_suspected_and_long_ones_are_not(times, unit):
    room = gs.Scene.load("room")
    data = room.model_dump(exclude_none=True)
    drawn = {**data["walls"][0], "name": "drawn", "points_m": [(0.0, 1.0), (4.0, 1.0)], "closed": False}
    for factor, begins in ((times, "suspect: drawn reaches"), (8, "note: walls reach out")):
        drawn["points_m"] = [(factor * x, factor * y) for x, y in ((0.0, 1.0), (4.0, 1.0))]
        (line,) = [
            one
            for one in scene_lines(gs.Scene.checked({**data, "walls": [*data["walls"], drawn]}, "room"))
            if one.startswith(("suspect", "note"))
        ]
        assert line.startswith(begins)
        assert (unit in line) == (factor == times)


def test_an_anchor_that_walls_hide_from_the_whole_way_is_told(say, tmp_path):
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    data["anchors"][1]["position_m"] = [4.5, 0.0]  # the wall is at x = 4
    (tmp_path / "scene.toml").write_text(gs.Scene.checked(data, "room").to_toml())
    note = "note: anchor B at (4.5, 0): hidden by walls from all steps of all agents' ways."
    said = say("check", "scene.toml")
    assert said.code == 0, "a street is legal"
    assert note in said.out
    assert note in say("simulate", "scene.toml", "-o", "heard.csv").err
    bare = gs.Scene.checked({**data, "walls": []}, "room")
    away = gs.Scene.checked({**data, "agents": [{**data["agents"][0], "waypoints_m": None}]}, "room")
    assert hidden_note(bare) is hidden_note(away) is None


def test_no_anchor_of_a_bundled_scene_is_hidden_for_good():
    assert not any(hidden_note(gs.Scene.load(name)) for name in gs.bundled_scenes())
