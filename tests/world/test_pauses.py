"""Agents that stand still for a while: `pause_s`, one number for each waypoint."""

import numpy as np
import pytest

import gridslam as gs
from gridslam.errors import InputError


def room(**agent):
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    own = {
        key: value
        for key, value in {**data["agents"][0], "steps": None, **agent}.items()
        if value is not None
    }
    return gs.Scene.checked({**data, "agents": [own]}, "room")


def test_an_agent_stands_still_at_its_waypoints_and_the_way_is_as_long_as_before():
    plain = room()
    count = len(plain.agents[0].waypoints_m)
    paused = room(pause_s=[20.0] + [0.0] * (count - 1))
    assert len(paused.track("agent1")) == len(plain.track("agent1")) + 20
    still = (paused.track("agent1").velocity_mps == 0).all(1)
    assert still.sum() == 20
    heard = gs.simulate(paused, seed=1)
    assert len(heard) == len(paused.track("agent1"))
    assert gs.Scene.from_toml(paused.to_toml()) == paused


def test_a_first_waypoint_at_the_start_is_a_pause_there():
    start, (first, *rest) = room().agents[0].start_m, room().agents[0].waypoints_m
    away = (start, first, *rest) if first != start else (first, *rest)
    paused = room(waypoints_m=away, pause_s=[7.0] + [0.0] * (len(away) - 1))
    np.testing.assert_array_equal(paused.track("agent1").position_m[:8], [start] * 8)
    assert paused.track("agent1").position_m[8].tolist() != list(start)


@pytest.mark.parametrize(
    ("change", "field", "words"),
    [
        ({"pause_s": [1.0]}, "agents[0].pause_s", "found 1 of them; allowed: 5, one for each of waypoints_m"),
        ({"pause_s": [-1.0, 0.0, 0.0, 0.0]}, "agents[0].pause_s[0]", "greater than or equal to 0"),
        (
            {"pause_s": [1e9, 0.0, 0.0, 0.0, 0.0]},
            "agents[0].pause_s",
            "so little that 1000000 steps reach the end",
        ),
        ({"pause_s": [1.0], "waypoints_m": None}, "agents[0].pause_s", "none, or waypoints_m, too"),
    ],
)
def test_pauses_that_cannot_be_are_one_line(change, field, words):
    with pytest.raises(InputError) as caught:
        room(**change)
    assert caught.value.where == f"room: {field}"
    assert words in str(caught.value)
