"""What is said of a scene's keys is complete, and scenes written with it read back as they were."""

from pathlib import Path

import pytest

import gridslam as gs
from gridslam.world import scene_reference
from gridslam.world.scene_reference import MEANINGS, commented, keys


def test_every_key_has_a_meaning_and_no_meaning_is_left_over():
    explained = sum(len(table) for table in MEANINGS.values())
    assert len({id(key) for key in keys()}) >= explained  # tables that stand in two places count twice
    assert {key.name for key in keys()} == {name for table in MEANINGS.values() for name in table}


def test_key_without_a_meaning_is_an_error(monkeypatch):
    spoilt = {**MEANINGS, "GridSpec": {"x_m": "Left and right."}}
    monkeypatch.setattr(scene_reference, "MEANINGS", spoilt)
    with pytest.raises(KeyError):
        keys.__wrapped__()


@pytest.mark.parametrize(
    ("table", "name", "unit", "default", "allowed"),
    [
        ("radio", "carrier_hz", "Hz", "6000000000.0", "number, above 0"),
        ("radio", "max_bounces", "", "2", "whole number, from 0, up to 2"),
        ("radio", "detection_probability", "", "-", "number, above 0, below 1"),
        ("grid", "x_m", "m", "required", "two numbers"),
        ("[agents].prior", "heading_deg", "deg", "10.0", "number, from 0, up to 180"),
        ("[walls]", "blocks", "", '"all"', '"all", "sight"'),
        ("filter", "correlated", "", "true", "true, false"),
        ("", "frame", "", "-", "text"),
        ("[agents]", "waypoints_m", "m", "-", "points [x, y]"),
        ("[agents]", "pause_s", "s", "-", "numbers, from 0"),
        ("[anchors]", "position_m", "m", "required", "two or three numbers"),
    ],
)
def test_unit_default_and_range_are_those_of_the_type(table, name, unit, default, allowed):
    (key,) = [key for key in keys() if (key.table, key.name) == (table, name)]
    assert (key.unit, key.default, key.allowed) == (unit, default, allowed)


@pytest.mark.parametrize("name", gs.bundled_scenes())
@pytest.mark.parametrize("all_keys", [False, True])
def test_commented_scene_reads_back_equal(name, all_keys):
    scene = gs.Scene.load(name)
    assert gs.Scene.from_toml(commented(scene, all_keys), name) == scene


def test_new_scene_is_checked_and_runs_and_explains_each_key(say):
    assert say("scene", "new", "-o", "my.toml").code == 0
    text = Path("my.toml").read_text()
    for key in keys():
        assert key.meaning in text, f"{key.table} {key.name}"
    for table in ("# [floor]:", "# [clocks]:", "# [[scatterers]]:", "# [walls.arc]:", "# [radio.dense]:"):
        assert table in text
    assert "scene my: 2 anchors" in say("check", "my.toml").out
    assert gs.Scene.load("my.toml").walls == gs.Scene.load("room").walls
    again = say("scene", "new", "-o", "my.toml")
    assert (again.code, len(again.complaints)) == (2, 1)
    assert Path("my.toml").read_text() == text
    assert say("scene", "new", "-o", "my.yaml").code == 2


def test_scene_is_shown_as_it_is_or_with_all_keys(say):
    plain, whole = say("scene", "show", "room"), say("scene", "show", "room", "--whole")
    assert (
        gs.Scene.from_toml(plain.out, "room")
        == gs.Scene.from_toml(whole.out, "room")
        == gs.Scene.load("room")
    )
    assert len(whole.out) > 2 * len(plain.out)
    Path("own.toml").write_text(plain.out)
    assert say("scene", "show", "own.toml").out == plain.out
    assert say("scene", "show", "nowhere").code == 2


def test_deviations_of_heights_say_what_they_are_what_0_is_and_who_uses_them():
    for text in {key.meaning for key in keys() if key.name == "height_std_m"}:
        assert "`height_m`" in text
        assert "standard deviation" in text
        assert "0 is exactly known" in text
        assert "other methods refuse" in text
