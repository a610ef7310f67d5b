"""Values on a raster, and lines of sight that jump about, are named; right tables aren't."""

import numpy as np
import pytest
from check_tables import SCENES, named, simulated_columns

from gridslam.checks.columns.noise import jumps, noise, raster
from gridslam.checks.sights.line_of_sight_filter import Sight

ROOM = SCENES["room"]


def rounded(columns, name, step):
    return columns | {
        name: np.maximum(np.round(columns[name] / step), 1 if name == "distance_m" else -9e9) * step
    }


def kinds(columns, name="room"):
    return [(found.column, found.kind) for found in named(columns, name)]


def test_distances_in_steps_of_decimetres_are_named_with_the_deviation_they_have():
    """They were called far more exact than the bandwidth allows, by a factor of 8 million, or right."""
    columns = rounded(simulated_columns("room", 3), "distance_m", 0.3)
    (found,) = named(columns, "room")
    assert (found.column, found.kind, found.certain) == ("distance_m", "raster", True)
    assert "steps of 0.3 m" in found.text
    assert "none of them below 0.087" in found.text, "0.3 over the root of 12"


def test_angles_in_steps_of_degrees_are_named_in_degrees():
    columns = rounded(simulated_columns("room", 3), "aoa_rad", np.radians(15.0))
    (found,) = named(columns, "room")
    assert (found.column, found.kind) == ("aoa_rad", "raster")
    assert "steps of 15 degrees" in found.text
    assert "aoa_std_rad, none of them below 0.076" in found.text


@pytest.mark.parametrize("stray", [0.0, 0.01])
def test_a_few_values_may_stray_and_the_raster_may_begin_anywhere(stray):
    draw = np.random.default_rng(1)
    values = 0.07 + 0.25 * draw.integers(4, 60, 800)
    values[draw.random(800) < stray] += 0.1
    table = {"step": np.arange(800), "distance_m": values}
    assert raster("distance_m", table, np.full(800, 0.02))
    assert not raster("distance_m", table, np.full(800, 0.1)), "finer than the noise"
    assert not raster(
        "distance_m", table | {"distance_m": values + draw.normal(0, 0.02, 800)}, np.full(800, 0.02)
    )


def test_a_device_that_stands_still_is_on_no_raster():
    """It hears the same few values over and over: 63 degrees was the step of two."""
    draw = np.random.default_rng(3)
    for levels in (2, 3, 9, 15):
        values = draw.uniform(-3, 3, levels)[draw.integers(0, levels, 400)]
        assert not raster("aod_rad", {"aod_rad": values}, np.full(400, 0.01))


def test_who_says_how_coarse_they_are_is_right():
    columns = rounded(simulated_columns("room", 3), "distance_m", 0.3)
    own = np.hypot(ROOM.signal_model().distance_std(columns["amplitude"]), 0.3 / np.sqrt(12))
    assert kinds(columns | {"distance_std_m": own}) == []


@pytest.mark.parametrize("name", SCENES)
def test_centimetres_and_right_tables_are_named_of_nothing(name):
    columns = simulated_columns(name, 4)
    assert kinds(columns, name) == []
    assert kinds(rounded(columns, "distance_m", 0.01), name) == []


def test_distances_noisier_than_the_radio_are_named_by_how_much():
    columns, draw = simulated_columns("room", 3), np.random.default_rng(2)
    usual = ROOM.signal_model().distance_std(columns["amplitude"])
    noisy = columns | {"distance_m": columns["distance_m"] + draw.normal(0, 8 * usual)}
    assert kinds(noisy) == [("distance_m", "noisy")]
    assert kinds(noisy | {"distance_std_m": 8 * usual}) == [], "that say so themselves"


def zigzag(height, steps=60):
    """Distances of one anchor in sight, in turn too long and too short by `height`."""
    step = np.arange(steps)
    table = {
        "step": step,
        "time_s": step.astype(float),
        "anchor": np.zeros(steps, np.intp),
        "distance_m": 5 + height * (-1.0) ** step,
        "aod_rad": np.zeros(steps),
    }
    always = np.ones(steps)
    sight = Sight(0.0, steps, 1.0, step, always, always, np.zeros((steps, 2)), always[:1], 0.0, np.zeros(3))
    return table, sight


def test_how_far_lines_of_sight_jump_is_measured_by_fourth_differences():
    """Worked out by hand: 1 + 4 + 6 + 4 + 1 = 16 times 0.1 m, over the root of 70, times 1.48."""
    table, sight = zigzag(0.1)
    (found,) = jumps("distance_m", table, np.full(60, 0.02), sight, ROOM)
    assert "scatter by 0.28 m" in found.reason


def test_motion_explains_as_much_as_the_scene_lets_it():
    """White accelerations of deviation a make fourth differences of the root of 6 a: 0.29 a as noise."""
    table, sight = zigzag(0.1)
    std = np.full(60, 0.001)
    for push, told in ((0.4, True), (0.6, False)):  # 0.283 m against twice 0.117 m, twice 0.176 m
        filtered = ROOM.filter.model_copy(update={"acceleration_mps2": push})
        assert (
            bool(jumps("distance_m", table, std, sight, ROOM.model_copy(update={"filter": filtered}))) == told
        )


def test_little_tells_nothing():
    table, sight = zigzag(0.1, 20)
    assert noise(table, sight, ROOM) == []
    assert noise({"step": np.zeros(0, np.intp)}, sight, ROOM) == []
