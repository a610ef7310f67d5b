"""Anchors that one mirror may show together: (M546)."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from gridslam.inference.management.poses.one_mirror import IN_LINE_RAD, in_line, shown_together
from gridslam.world.geometry import mirror, wrap

PLACE = st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0))


@given(
    wall=st.tuples(st.floats(-np.pi, np.pi), st.floats(-20.0, 20.0)),
    pose=st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-np.pi, np.pi)),
    anchors=st.lists(PLACE, min_size=2, max_size=2),
)
def test_headings_told_over_a_mirror_differ_by_twice_the_angle_between_anchors(wall, pose, anchors):
    """Read as a line of sight, what comes over a wall tells another heading for each direction."""
    line, place, each = np.array(wall), np.array(pose[:2]), np.array(anchors)
    mirrored, images = mirror(line, place), np.array([mirror(line, anchor) for anchor in each])
    assume(np.linalg.norm(images - place, axis=1).min() > 0.1)
    arrival = np.arctan2(*(images - place).T[::-1]) - pose[2]  # as measured
    seen = np.arctan2(*(each - mirrored).T[::-1])  # towards the anchors, from where the agent seems to be
    told = seen - arrival
    assert abs(wrap(told[1] - told[0] - 2 * (seen[1] - seen[0]))) < 1e-9
    alike = abs(wrap(told[1] - told[0])) < 2 * IN_LINE_RAD
    assert in_line(each, mirrored)[0, 1] == alike


def test_in_line_is_on_either_side():
    anchors = np.array([[4.0, 0.0], [-3.0, -0.5], [0.0, 5.0], [4.0, 1.6]])  # 0, 9 + 180, 90 and 22 degrees
    assert in_line(anchors, np.zeros(2)).tolist() == [
        [True, True, False, False], [True, True, False, True],
        [False, False, True, False], [False, True, False, True],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("nats", "expected"),
    [
        ((20.0, 8.0, 30.0), 8.0),  # the two in line, without the louder one
        ((20.0, -1.0, 30.0), 0.0),
        ((0.0, 0.0, 30.0), 0.0),
    ],
)
def test_what_one_mirror_adds_by_hand(nats, expected):
    anchors = np.array([[4.0, 0.0], [-3.0, 0.0], [0.0, 5.0]])
    assert shown_together(anchors, np.zeros(2), np.array(nats)) == expected


def test_without_anchors_nothing_is_shown():
    assert shown_together(np.zeros((0, 2)), np.zeros(2), np.zeros(0)) == 0.0
