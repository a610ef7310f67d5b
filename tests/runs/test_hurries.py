"""Runs whose velocity changes faster than their motion model allows, over steps that each tell nothing."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs
from gridslam.runs.hurries import OFTEN, OVER, hurry


def run_of(velocity, interval_s=0.1):
    """Estimates at these velocities (N, 2), m/s: what is looked at of them."""
    return [SimpleNamespace(time_s=k * interval_s, velocity_mps=one) for k, one in enumerate(velocity)]


def test_a_walk_of_the_velocity_as_wide_as_expected_is_no_hurry():
    draw = np.random.default_rng(1)
    for interval_s in (0.1, 1.0):
        walk = np.cumsum(draw.normal(0, 0.03 * interval_s, (400, 2)), axis=0)
        assert hurry(run_of(walk, interval_s), 0.03) is None
    assert hurry(run_of(walk[: 2 * OVER - 1]), 0.001) is None
    assert hurry(run_of(np.full((100, 2), np.nan)), 0.03) is None


def test_bends_at_ten_steps_a_second_are_told_and_what_allows_for_them():
    """A robot at 0.5 m/s that turns half around within two seconds, four times."""
    course = np.pi * np.clip((np.arange(400) % 100 - 40) / 20, 0, 1) + np.pi * (np.arange(400) // 100)
    velocity = 0.5 * np.stack([np.cos(course), np.sin(course)], -1)
    share, acceleration = hurry(run_of(velocity), 0.03)
    assert share > OFTEN
    assert 0.5 < acceleration < 3.0
    assert hurry(run_of(velocity), acceleration) is None


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_a_run_at_ten_steps_a_second_notes_that_its_motion_is_too_smooth(say):
    """Single steps of 5 cm at 10 Hz don't show it; the agent was lost at a bend, in silence."""
    data = shortened(gs.Scene.load("room"), 110).with_filter(particles=64).model_dump(exclude_none=True)
    body = {**data["agents"][0], "interval_s": 0.1, "acceleration_mps2": 0.6}
    body["prior"] = {**body["prior"], "velocity_mps": 0.1}
    for settings, times in (({}, 1), ({"acceleration_mps2": 1.0}, 0)):
        scene = gs.Scene.checked({**data, "agents": [body]}, "quick").with_filter(**settings)
        Path("quick.toml").write_text(scene.to_toml())
        result = say("run", "quick.toml", "-o", "out", "--overwrite")
        assert result.code == 0
        note = r"at \d+% of the steps its velocity had changed, within ten steps, over three times as much"
        assert len(re.findall(note, re.sub(r"\s+", " ", result.out))) == times, result.out
