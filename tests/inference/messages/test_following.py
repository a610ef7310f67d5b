"""Where an agent is moved by more than it can have gone, and ways that it may have gone."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gridslam.inference.messages.features import lessons
from gridslam.inference.messages.features.following import leapt
from gridslam.inference.messages.features.lessons import BESIDE, HybridWork, Learned, apply_lesson
from gridslam.inference.messages.features.ways import SPEEDS, apart, straight_ways
from gridslam.inference.state.features.features import FeatureBank
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, Segment


def belief(x, deviation_m):
    variance = np.diag([deviation_m**2, deviation_m**2, 0.04, 0.04])
    one, none = np.ones(1), FeatureBank.empty()
    return JointBelief(np.array([x, 2.0, 0.3, 0.0]), variance, none, one, one, one)


@pytest.mark.parametrize(
    ("far_m", "deviation_m", "said"),
    [(0.6, 0.1, True), (0.4, 0.01, False), (0.6, 0.13, False), (1.4, 0.27, True)],
)
def test_an_agent_leaps_by_half_a_metre_and_five_deviations(far_m, deviation_m, said):
    """0.6 m are six deviations of 0.1 m and 4.6 of 0.13; 0.4 m are too few, however sure it was."""
    before, after = belief(1.0, deviation_m), belief(1.0 + far_m, 0.02)
    state = HybridState(after, before, Segment.empty(1, 4, 8))
    found = leapt(state, before, after)
    assert (found.leap_m, found.since_leap) == (
        (pytest.approx(far_m), -1) if said else (0.0, state.since_leap)
    )


def test_who_is_moved_by_a_lesson_is_said_to_have_been_moved_just_now(monkeypatch):
    """The step is counted by then: one step ago is the next, and "-1 steps ago" was said."""
    before, after = belief(1.0, 0.1), belief(2.0, 0.02)
    lesson = HybridState(before, before, Segment.empty(1, 4, 8), step=30)
    state = replace(lesson, lesson=lesson, step=30 + BESIDE)
    monkeypatch.setattr(lessons, "replay", lambda joint, *_, **__: (joint, np.zeros(0), np.zeros((0, 4))))
    work = HybridWork(None, 1)
    work.beside = SimpleNamespace(result=lambda *_: (replace(lesson, joint=after), Learned()))
    moved, _ = apply_lesson(state, None, work=work)
    assert (moved.leap_m, moved.since_leap) == (pytest.approx(1.0), 0)


def test_straight_ways_lead_from_the_start_at_likely_speeds_and_apart():
    before, count = belief(1.0, 0.3), 6
    empty = Segment.empty(1, 4, 8)
    segment = replace(empty, time_s=3.0 + 0.5 * np.arange(count))
    ways = [one.agent for one in straight_ways(segment, before)]
    assert all((way[0, :2] == before.mean[:2]).all() for way in ways)
    speeds = [np.hypot(*(way[-1, :2] - way[0, :2] - 2.5 * before.mean[2:])) / 2.5 for way in ways]
    np.testing.assert_allclose(np.unique(np.round(speeds, 9)), 0.2 * np.array(SPEEDS))
    assert min(apart(a, b) for k, a in enumerate(ways) for b in ways[:k]) > 0.2
