"""Delays that all paths have too much, where walls hide an anchor; and lengths that aren't planar."""

import numpy as np
import pytest
from signal_samples import FREQUENCIES, C, suspects

import gridslam as gs
from gridslam.checks.signals.files import describe_signal

PLACES = np.array([[0.0, 0.0], [9.0, 1.0], [4.0, 8.0], [1.0, 9.0]])
STEPS = 60


def recorded(path, late_m=0.0, rise_m=0.0, hidden=2, late_one_m=0.0):
    """Four anchors along a bent way, `hidden` of them heard over walls alone, and one late by itself."""
    turn = np.linspace(0, np.pi, STEPS)
    way = np.stack([4.5 - 3.5 * np.cos(turn), 3.0 + 2.5 * np.sin(turn)], 1)
    plan = np.linalg.norm(way[:, None] - PLACES, axis=2)
    direct = np.hypot(plan, rise_m) + late_m
    direct[:, 1] += late_one_m
    mirrored = [np.linalg.norm(way[:, None] - (PLACES * [-1, 1] - [shift, 0]), axis=2) for shift in (2, 5)]
    draw = np.random.default_rng(5)
    samples = 0.02 * (draw.standard_normal((STEPS, 4, 41)) + 1j * draw.standard_normal((STEPS, 4, 41)))
    for length, loud in ((direct, 1.0), (mirrored[0] + late_m, 0.5), (mirrored[1] + late_m, 0.4)):
        level = np.full(4, loud)
        if loud == 1.0:
            level[4 - hidden :] = 0.0
        samples += level[:, None] * np.exp(-2j * np.pi * FREQUENCIES * length[..., None] / C)
    time = 0.25 * np.arange(STEPS)
    truth = gs.Trajectory(
        time_s=time, position_m=way, heading_rad=0.1 * time, velocity_mps=np.gradient(way, 0.25, axis=0)
    )
    gs.Recording.from_arrays(
        samples, 6e9, FREQUENCIES, ["A", "B", "C", "D"], truth=truth, anchor_position_m=PLACES
    ).to_h5(path)
    return path


@pytest.mark.parametrize("metres", [1.5, -1.5, 3.0])
def test_a_delay_is_named_where_walls_hide_half_of_the_anchors(tmp_path, metres):
    (line,) = suspects(recorded(tmp_path / "z.h5", metres))
    assert "all delays are off" in line
    assert float(line.split("about ")[1].split(" m")[0]) == pytest.approx(metres, abs=0.05)


@pytest.mark.parametrize("hidden", range(5))
def test_right_recordings_with_hidden_anchors_are_left_in_peace(tmp_path, hidden):
    assert suspects(recorded(tmp_path / "z.h5", hidden=hidden)) == []


def test_one_anchor_in_sight_or_one_late_anchor_is_no_delay_of_all(tmp_path):
    assert suspects(recorded(tmp_path / "a.h5", 1.5, hidden=3)) == []
    assert suspects(recorded(tmp_path / "b.h5", late_one_m=1.5)) == []


def test_anchors_above_the_agent_are_not_taken_for_a_delay(tmp_path):
    assert not any("delays are off" in line for line in suspects(recorded(tmp_path / "a.h5", rise_m=1.5)))
    for rise in (2.2, 3.0):
        (line,) = suspects(recorded(tmp_path / "z.h5", rise_m=rise))
        assert float(line.split("anchors about ")[1].split(" m above")[0]) == pytest.approx(rise, abs=0.3)


def test_a_scene_with_heights_is_taken_by_its_word(tmp_path):
    anchors = [{"name": n, "position_m": [*xy, 3.4]} for n, xy in zip("ABCD", PLACES.tolist(), strict=True)]
    scene = gs.Scene.checked(
        {
            "grid": {"x_m": [-1.0, 10.0], "y_m": [-1.0, 10.0], "cell_m": 0.5}, "anchors": anchors,
            "agents": [{"name": "me", "start_m": [1.0, 3.0], "height_m": 0.4}],
            "radio": {"bandwidth_hz": 4e8, "array": {"rows": 1, "columns": 1}},
        },
        "tall",
    )  # fmt: skip
    path = recorded(tmp_path / "z.h5", rise_m=3.0)
    assert suspects(path, scene) == []
    assert suspects(path) != []
    (note,) = [line for line in describe_signal(path, scene) if line.startswith("note: ")]
    assert "scene has heights, and methods on sampled signals (direct, hybrid) refuse such scenes" in note
