"""Clocks that drift where the scene lets them walk alone are named; those that walk, jump or wait aren't."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.runs.clock_drifts import drift_note
from gridslam.runs.clock_track import ClockTrack

ANNEX = gs.Scene.load("annex")
DEVICES = (*ANNEX.anchor_names, "agent1", "agent2")
TIME_S = np.arange(300.0)


def with_clocks(**told):
    data = ANNEX.model_dump(exclude_none=True)
    return gs.Scene.checked({**data, "clocks": {**data["clocks"], **told}}, "annex")


def track(offset_ns, unset=()):
    """Offsets (N, 5) ns; which of the three anchors aren't set."""
    open_ones = np.zeros((len(TIME_S), 3), bool)
    open_ones[:, list(unset)] = True
    covariance = np.zeros((len(TIME_S), 5, 5))
    return ClockTrack(
        DEVICES, 3, np.arange(len(TIME_S)), TIME_S, 1e-9 * np.asarray(offset_ns), covariance, open_ones
    )


def rates(*ppb):
    """Offsets of clocks that go at such rates, and walk besides, as what they all have in common does."""
    draw = np.random.default_rng(3)
    walk = 0.02 * draw.normal(size=(300, 5)).cumsum(0)
    common = 0.5 * draw.normal(size=(300, 1)).cumsum(0)
    return walk + common + TIME_S[:, None] * np.array(ppb) + np.array([-83.0, 15.0, 71.0, 1.2, -0.8])


def test_a_clock_that_drifts_where_none_is_told_to_is_named_with_its_rate():
    note = drift_note(ANNEX, track(rates(0, 0.2, 0, 0, 0)))
    assert note.startswith(
        "clocks drift, as far as they are followed: B by +0.2 ppb (ns in a second) against"
    )
    assert note.endswith("[clocks] has no drift_prior_ppb: set it to 0.4")
    narrow = drift_note(with_clocks(drift_prior_ppb=0.05), track(rates(0, 0.2, 0, -0.3, 0)))
    assert ": B by +0.2 ppb, agent1 by -0.3 ppb (ns in a second)" in narrow
    assert narrow.endswith("[clocks] drift_prior_ppb is 0.05: set it to 0.6")


def test_rates_that_the_scene_lets_clocks_have_are_told_as_such():
    note = drift_note(with_clocks(drift_prior_ppb=1.0), track(rates(0, 0.2, 0, 0, 0)))
    assert note == "clocks are believed to drift, as clocks.drift_prior_ppb = 1 lets them: B by +0.2 ppb"


def test_a_known_clock_is_the_time():
    scene = with_clocks(reference="A")
    draw = np.zeros((300, 5)) + TIME_S[:, None] * np.array([0.0, 0.2, 0.2, 0.2, 0.2])
    assert ": B by +0.2 ppb, C by +0.2 ppb, agent1" in drift_note(scene, track(draw))


@pytest.mark.parametrize("seed", range(6))
def test_clocks_that_walk_as_told_do_not_drift(seed):
    draw = np.random.default_rng(seed)
    walk = ANNEX.clocks.walk_ns * draw.normal(size=(300, 5)).cumsum(0)
    assert drift_note(ANNEX, track(walk)) is None


def test_jumps_zigzags_and_clocks_that_are_not_found_yet_do_not_drift():
    jump = rates(0, 0, 0, 0, 0)
    jump[150:, 1] += 40.0
    zigzag = rates(0, 0, 0, 0, 0)
    zigzag[:, 1] += 0.01 * (50 - np.abs(np.mod(TIME_S, 100) - 50))
    assert drift_note(ANNEX, track(jump)) is None
    assert drift_note(ANNEX, track(zigzag)) is None
    assert drift_note(ANNEX, track(rates(0, 0.2, 0, 0, 0), unset=[1])) is None


def test_short_runs_and_scenes_without_clocks_say_nothing():
    whole = track(rates(0, 0.2, 0, 0, 0))
    first = slice(0, 30)
    short = replace(
        whole, step=whole.step[first], time_s=whole.time_s[first], offset_s=whole.offset_s[first],
        covariance_s2=whole.covariance_s2[first], unset=whole.unset[first],
    )  # fmt: skip
    assert drift_note(ANNEX, short) is None
    assert drift_note(gs.Scene.load("room"), whole) is None
