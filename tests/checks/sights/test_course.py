"""What a run's heading and way say of angles of arrival: mounted sideways, or the world's."""

from types import SimpleNamespace

import numpy as np
import pytest
from made_sights import made_sight

from gridslam.checks.sights.course import course_note, may_be_straight

ANGLE = np.linspace(0, 1.5 * np.pi, 120)
LOOP = 2.5 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], 1)
AHEAD = ANGLE + np.pi / 2


def followed(place, heading, seed=1, off=0.01):
    """Estimates of a run, off by a centimetre and a degree."""
    draw = np.random.default_rng(seed)
    place = place + off * draw.standard_normal(place.shape)
    turn = np.radians(1.0) * draw.standard_normal(len(place))
    return [
        SimpleNamespace(position_m=p, heading_rad=None if h is None else h + t, covariance=off**2 * np.eye(5))
        for p, h, t in zip(place, heading, turn, strict=True)
    ]


def test_who_looks_where_it_goes_is_left_alone():
    assert course_note(followed(LOOP, AHEAD)) is None
    assert course_note(followed(LOOP, AHEAD + np.radians(20))) is None
    straight = np.stack([np.linspace(0, 6, 120), np.zeros(120)], 1)
    assert course_note(followed(straight, np.zeros(120))) is None
    for seed in range(5):  # vague, which isn't a way that turns
        assert course_note(followed(straight, np.zeros(120), seed, 0.2)) is None


@pytest.mark.parametrize(
    ("turn", "words"), [(-90, "to its left all the way (9"), (60, "to its right"), (180, "backwards")]
)
def test_who_never_does_is_told_how_it_goes(turn, words):
    assert words in course_note(followed(LOOP, AHEAD + np.radians(turn)))


def test_a_heading_that_nothing_tells_says_nothing_of_arrays():
    """Of distances alone: a run that was lost "went to its right all the way"."""
    estimates = followed(LOOP, AHEAD + np.radians(60))
    for one in estimates[1:]:
        one.covariance[4, 4] = 0.5**2
    assert course_note(estimates) is None


def test_a_heading_that_stays_on_a_way_that_bends_is_of_the_world():
    assert "world's frame" in course_note(followed(LOOP, np.full(120, 1.4)))


def test_little_tells_nothing():
    assert course_note([]) is None
    assert course_note(followed(LOOP[:10], np.zeros(10))) is None
    assert course_note(followed(LOOP, [None] * 120)) is None
    assert course_note(followed(np.zeros((120, 2)), np.zeros(120))) is None, "it stands"


def test_a_straight_way_that_wavers_far_from_anchors_may_be_straight():
    """Right corridors were told that their arrivals are of the world, for their ways seemed to turn."""
    straight = np.stack([np.linspace(0, 5, 100), 0.3 * np.sin(np.linspace(0, 6, 100))], 1)
    far = made_sight(range(80), position_m=straight, distance_m=np.full(80, 12.0))
    assert may_be_straight(far)
    near = made_sight(range(80), position_m=straight, distance_m=np.full(80, 2.0))
    assert not may_be_straight(near)
    loop = made_sight(range(80), position_m=LOOP, distance_m=np.full(80, 12.0))
    assert not may_be_straight(loop)
