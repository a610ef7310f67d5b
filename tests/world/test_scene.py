"""Scene files: what they refuse and how."""

import os

import pytest
import tomli_w
from scene_worlds import WORLD, changed, drop, put, rename

from gridslam.errors import InputError
from gridslam.world.scene import Scene


@pytest.fixture
def scene():
    return Scene.from_toml(tomli_w.dumps(WORLD), "hall.toml")


REFUSED = {
    "misspelt key": (rename("anchors", 1, "position_m", "positon_m"), "anchors[1].positon_m", "position_m"),
    "misspelt table": (rename("grid", "gird"), "gird", "grid"),
    "misspelt nested key": (put("radio", {"array": {"row": 3}}), "radio.array.row", "rows"),
    "unknown filter setting": (put("filter", {"particle": 3}), "filter.particle", "particles"),
    "no anchors": (drop("anchors"), "anchors", "no default"),
    "empty anchors": (put("anchors", []), "anchors", "at least 1"),
    "no grid": (drop("grid"), "grid", "no default"),
    "grid turned round": (put("grid", "x_m", [5.0, -5.0]), "grid.x_m", "[low, high]"),
    "grid of too many cells": (put("grid", "cell_m", 1e-5), "grid.cell_m", "at most 2 GB: a larger"),
    "grid of infinitely many cells": (put("grid", "cell_m", 1e-200), "grid.cell_m", "at most 2 GB"),
    "point of three numbers": (put("grid", "x_m", [0.0, 1.0, 2.0]), "grid.x_m", "2 items"),
    "text for a number": (put("radio", {"carrier_hz": "6e9"}), "radio.carrier_hz", "valid number"),
    "yes for a number": (put("radio", {"carrier_hz": True}), "radio.carrier_hz", "valid number"),
    "fraction for a count": (put("filter", {"particles": 10.5}), "filter.particles", "valid integer"),
    "unknown quantity": (put("radio", {"measures": ["distance", "phase"]}), "radio.measures[1]", "'aoa'"),
    "quantity twice": (put("radio", {"measures": ["distance", "distance"]}), "radio.measures", "once"),
    "no distance": (put("radio", {"measures": ["aoa"]}), "radio.measures", "distance"),
    "sure detection": (
        put("radio", {"measures": ["distance"], "detection_probability": 1.0}),
        "radio.detection_probability",
        "less than 1",
    ),
    "detection given and measured": (
        put("radio", {"detection_probability": 0.9}),
        "radio.detection_probability",
        "without amplitude",
    ),
    "no range noise": (put("radio", {"distance_std_m": 0.0}), "radio.distance_std_m", "greater than 0"),
    "number for a table": (put("grid", 3), "grid", "a table"),
    "NaN": (put("anchors", 0, "orientation_deg", float("nan")), "anchors[0].orientation_deg", "finite"),
    "infinity": (put("walls", 0, "points_m", 1, 0, float("inf")), "walls[0].points_m[1][0]", "finite"),
    "huge integer": (put("agents", 0, "start_m", 0, 10**400), "agents[0].start_m[0]", "number"),
    "negative speed": (put("agents", 0, "interval_s", -1.0), "agents[0].interval_s", "greater than 0"),
    "coefficient above 1": (put("materials", "glass", 1.5), "materials.glass", "equal to 1"),
    "coefficient 0": (put("materials", "glass", 0.0), "materials.glass", "greater than 0"),
    "unknown material": (put("walls", 1, "material", "glas"), "walls[1].material", "glass"),
    "unlike material": (put("walls", 1, "material", "steel"), "walls[1].material", "concrete, glass"),
    "zero-length wall": (put("walls", 0, "points_m", 1, [-4.0, 3.0]), "walls[0].points_m[0]", "differ"),
    "closed twice": (
        lambda w: w["walls"][0].update(closed=True, points_m=[[1.0, 2.0], [2.0, 2.0], [1.0, 2.0]]),
        "walls[0].points_m[2]",
        "differ",
    ),
    "wall of one point": (put("walls", 0, "points_m", [[0.0, 1.0]]), "walls[0].points_m", "at least 2"),
    "arc without extent": (put("walls", 1, "arc", "to_deg", 180.0), "walls[1].arc", "differ"),
    "wall with points and arc": (
        put("walls", 1, "points_m", [[0.0, 2.0], [1.0, 2.0]]),
        "walls[1]",
        "exactly one",
    ),
    "wall with neither": (drop("walls", 0, "points_m"), "walls[0]", "exactly one"),
    "two anchors of a name": (put("anchors", 1, "name", "A"), "anchors[1].name", "isn't taken"),
    "two agents of a name": (
        lambda w: w["agents"].append(dict(w["agents"][0])),
        "agents[1].name",
        "isn't taken",
    ),
    "agent that is no folder": (put("agents", 0, "name", "../a"), "agents[0].name", "letters"),
    "anchor outside": (put("anchors", 0, "position_m", [9.0, 0.0]), "anchors[0].position_m", "[-5.0, 5.0]"),
    "anchor in a wall": (put("anchors", 0, "position_m", [0.0, 3.0]), "anchors[0].position_m", "0.01 m"),
    "start outside": (put("agents", 0, "start_m", [0.0, -4.5]), "agents[0].start_m", "[-4.0, 4.0]"),
    "start in a wall": (put("agents", 0, "start_m", [3.995, 0.0]), "agents[0].start_m", "0.01 m"),
    "way outside": (put("agents", 0, "waypoints_m", 1, [2.0, -4.9]), "agents[0].waypoints_m", "[-4.0, 4.0]"),
    "way through a wall": (
        put("agents", 0, "waypoints_m", [[4.7, 0.0], [4.7, 2.0]]),
        "agents[0].waypoints_m",
        "0.01 m",
    ),
    "long stride through a wall": (
        lambda w: w["agents"][0].update(step_m=0.7, waypoints_m=[[4.9, 0.0]]),
        "agents[0].waypoints_m",
        "in walls[0]",
    ),
    "decimal commas": (
        put("anchors", 0, "position_m", [0, 8, 7, 2]),
        "anchors[0].position_m",
        "at most 3 items",
    ),
    "way to nowhere": (put("agents", 0, "waypoints_m", [[0.0, 0.0]]), "agents[0].waypoints_m", "differ"),
    "no way at all": (put("agents", 0, "waypoints_m", []), "agents[0].waypoints_m", "differ"),
    "U-turn": (put("agents", 0, "waypoints_m", 1, [0.0, 0.01]), "agents[0].waypoints_m[0]", "0.4 m or more"),
    "more steps than way": (put("agents", 0, "steps", 500), "agents[0].steps", "at most"),
    "endless way": (put("agents", 0, "step_m", 1e-9), "agents[0].step_m", "1000000"),
    "heading against the motion": (
        put("agents", 0, "start_heading_deg", 90.0),
        "agents[0].start_heading_deg",
        "0.0 (the motion's)",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_fault_is_told_in_one_line_with_its_place(case):
    change, field, allowed = REFUSED[case]
    with pytest.raises(InputError) as caught:
        Scene.from_toml(changed(change), "hall.toml")
    assert caught.value.where == f"hall.toml: {field}"
    assert allowed in caught.value.allowed + caught.value.found
    assert "\n" not in str(caught.value)


def test_faults_of_walls_name_the_wall_where_it_has_a_name():
    def spoilt(*path):
        def change(world):
            world["walls"][0]["name"] = "north"
            put(*path)(world)

        with pytest.raises(InputError) as caught:
            Scene.from_toml(changed(change), "hall.toml")
        return str(caught.value)

    said = spoilt("walls", 0, "material", "glas")
    assert said.startswith("hall.toml: walls[0].material (of 'north'): found 'glas'; allowed: ")
    assert "walls[0].points_m[1][0] (of 'north'): found 'x'" in spoilt("walls", 0, "points_m", 1, 0, "x")
    assert "0) in walls[0] ('north'); allowed" in spoilt("agents", 0, "start_m", [3.995, 0.0])
    assert "walls[0].name: found 3" in spoilt("walls", 0, "name", 3)


def test_broken_toml_names_file_and_line():
    with pytest.raises(InputError, match=r"hall\.toml.*line 2"):
        Scene.from_toml("name = 'x'\n[grid\n", "hall.toml")


def test_deeply_nested_toml_is_refused_not_overflowing():
    with pytest.raises(InputError):
        Scene.from_toml("name = " + "[" * 100_000, "hall.toml")


def test_missing_and_unreadable_files_are_named(tmp_path):
    (tmp_path / "latin.toml").write_bytes(b"name = '\xff'")
    for path in (tmp_path / "none.toml", tmp_path, tmp_path / "latin.toml"):
        with pytest.raises(InputError) as caught:
            Scene.load(path)
        assert caught.value.where == str(path)


def test_a_file_of_the_name_is_pointed_at(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flat.toml").write_text("")
    with pytest.raises(
        InputError, match=r"found 'flat'; allowed: flat\.toml, which is here, or a bundled scene"
    ):
        Scene.load("flat")


def test_unknown_name_lists_the_bundled_scenes():
    names = (
        "alcove, annex, building, canyon, ceiling, chamber, exchange, facade, hall, overlap, pillars, room, "
    )
    names += "scatter, screen, seminar"
    with pytest.raises(InputError, match=rf"'tunnel'; allowed: {names}, or the path"):
        Scene.load("tunnel")
    for slip, meant in (("hal", "hall"), ("Hall", "hall"), ("rom", "room"), ("canion", "canyon")):
        found = rf"'{slip}'; allowed: {meant} \(nearest known scene\); all: {names}, or the path"
        with pytest.raises(InputError, match=found):
            Scene.load(slip)


def test_folder_of_a_scenes_name_does_not_hide_it(tmp_path, monkeypatch):
    (tmp_path / "room").mkdir()
    monkeypatch.chdir(tmp_path)
    assert Scene.load("room").name == "room"


def test_file_without_name_is_called_by_its_stem(tmp_path):
    path = tmp_path / "yard.toml"
    path.write_text(tomli_w.dumps(WORLD))
    assert Scene.load(str(path)).name == "yard"
    assert Scene.load(path) == Scene.load(os.path.relpath(path))
