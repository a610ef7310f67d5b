"""Paths shorter than the line of sight to where a run puts its agent: named if it was elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from room_tracks import ROOM, STEPS, went

import gridslam as gs
from gridslam.checks.runs.early_arrivals import LEAST_STEPS, early_arrivals

MODEL = ROOM.filter_model("agent1")


@pytest.fixture(scope="module")
def heard():
    return gs.simulate(ROOM, "agent1", seed=3)


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_said_of_a_right_run(seed):
    assert early_arrivals(went(), gs.simulate(ROOM, "agent1", seed=seed), MODEL) is None


@pytest.mark.parametrize("off", [(2.0, 0.0), (0.0, 2.0), (-1.5, 1.0)])
def test_an_agent_that_was_elsewhere_is_told_by_what_came_too_soon(heard, off):
    early = early_arrivals(went(off), heard, MODEL)
    assert LEAST_STEPS <= early.steps <= early.heard == STEPS
    assert 0.2 < early.short_m <= np.hypot(*off) + 0.3
    assert early.anchor in MODEL.anchor_names


def test_who_knows_badly_where_it_is_or_how_loud_paths_are_is_not_accused(heard):
    assert early_arrivals(went((2.0, 0.0), std_m=1.0), heard, MODEL) is None
    mute = replace(heard, amplitude=np.full(len(heard.distance_m), np.nan))
    assert early_arrivals(went((2.0, 0.0)), mute, MODEL) is None


@pytest.mark.parametrize(("amplitude", "told"), [(4.9, False), (5.1, True)])
def test_a_path_is_louder_than_clutter_from_an_amplitude_of_five_on(heard, amplitude, told):
    """By hand: sqrt(21 + 2^2) = 5, at the usual threshold of 2."""
    assert MODEL.radio.threshold == pytest.approx(2, abs=0.01)
    alike = replace(heard, amplitude=np.full(len(heard.distance_m), amplitude))
    assert (early_arrivals(went((2.0, 0.0)), alike, MODEL) is not None) == told
