"""Units of what a recording says beside its samples: named by the scene, or by the numbers alone."""

import numpy as np
import pytest
from signal_samples import recording, sampled_scene, suspects

import gridslam as gs

SCENE = sampled_scene(steps=20, interval_s=0.2, heading_sensor_deg=1.0)
TIME_S = 0.2 * np.arange(20)
HEADING = np.radians(30.0) + 0.01 * np.sin(np.arange(20.0))
TWO = gs.Scene.checked(
    {
        **SCENE.model_dump(exclude_none=True),
        "anchors": [
            {"name": "A", "position_m": [0.0, 0.0], "orientation_deg": 90.0},
            {"name": "B", "position_m": [5.0, -3.0], "orientation_deg": -120.0, "position_std_m": 0.2},
        ],
    },
    "two",
)
PLACE, FACING = TWO.anchor_positions, TWO.anchor_orientations


def told(path, scene, **changes):
    """What is suspected of a recording of `scene`, with some of what it says changed."""
    own = gs.simulate(scene, "me", 1, what="signal")
    given = {
        "frequency_hz": own.waveform.offset_hz, "time_s": TIME_S, "heading_rad": HEADING,
        "heading_std_rad": np.radians(1.0), "anchors": list(own.anchors), **changes,
    }  # fmt: skip
    recording(own.samples, **given).to_h5(path / "z.h5")
    return suspects(path / "z.h5", scene)


def test_a_right_recording_is_not_accused(tmp_path):
    for more in ({}, {"time_s": TIME_S + 1.7e9}, {"time_s": TIME_S + 6.4e10}):
        assert told(tmp_path, SCENE, **more) == []
    for place in (PLACE, PLACE + np.array([[0.05, 0.0], [0.0, 0.4]])):
        assert told(tmp_path, TWO, anchor_position_m=place, anchor_orientation_rad=FACING) == []


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "kHz"), (1e6, "MHz"), (1e9, "GHz")])
def test_frequencies_in_another_unit_than_the_scenes_are_named(tmp_path, factor, unit):
    (line,) = told(tmp_path, SCENE, frequency_hz=SCENE.radio.offset_hz / factor)
    assert line.startswith(f"suspect: frequency_hz: {unit}, where Hz belong")


def test_other_spacings_are_no_units(tmp_path):
    for factor in (2.0, 900.0):
        found = told(tmp_path, SCENE, frequency_hz=SCENE.radio.offset_hz / factor)
        assert not [line for line in found if "where Hz belong" in line]


TIMES = {
    "nanoseconds": 1e9 * TIME_S,
    "microseconds": 1e6 * TIME_S,
    "milliseconds": 1e3 * TIME_S,
    "milliseconds of a clock": 8e9 + 1e3 * TIME_S,
}


@pytest.mark.parametrize("kind", TIMES)
def test_times_of_other_units_are_named(tmp_path, kind):
    (line,) = told(tmp_path, SCENE, time_s=TIMES[kind])
    assert line.startswith(f"suspect: time_s: {'' if 'nano' in kind or 'micro' in kind else 'probably '}")
    assert f"{kind.split()[0]}, where seconds belong" in line


@pytest.mark.parametrize("std", [1.0, 5.0])
def test_a_deviation_of_headings_in_degrees_is_named(tmp_path, std):
    (line,) = told(tmp_path, SCENE, heading_std_rad=std)
    assert line.startswith("suspect: heading_std_rad: probably degrees")


def test_headings_that_are_known_badly_are_not(tmp_path):
    jumping = HEADING + np.random.default_rng(1).normal(scale=0.6, size=20)
    found = told(tmp_path, SCENE, heading_rad=jumping, heading_std_rad=0.6)
    loose = sampled_scene(steps=20, interval_s=0.2, heading_sensor_deg=40.0)
    found += told(tmp_path, loose, heading_std_rad=0.7)
    assert not [line for line in found if "std" in line]


@pytest.mark.parametrize(
    ("unit", "metre"), [("millimetres", 1e3), ("centimetres", 1e2), ("feet", 1 / 0.3048)]
)
def test_anchors_in_another_unit_than_the_scenes_are_named(tmp_path, unit, metre):
    (line,) = told(tmp_path, TWO, anchor_position_m=metre * PLACE)
    assert line == f"suspect: anchor_position_m: {unit}, where metres belong: they are the scene's then"


def test_anchors_elsewhere_than_in_the_scene_are_named(tmp_path):
    (line,) = told(tmp_path, TWO, anchor_position_m=PLACE + np.array([[0.0, 0.0], [3.0, 0.0]]))
    assert line == "suspect: anchor_position_m: B stands 3 m from where the scene has it"


def test_orientations_of_anchors_in_degrees_are_named(tmp_path):
    (line,) = told(tmp_path, TWO, anchor_orientation_rad=np.degrees(FACING))
    assert line.startswith("suspect: anchor_orientation_rad: degrees")
