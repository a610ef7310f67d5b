"""Anchors that one mirror may show together: (M546)."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from gridslam.inference.management.poses.one_mirror import ALIKE_RAD, added_by_mirror, shown_by_mirror
from gridslam.world.geometry import mirror, unit, wrap

PLACE = st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0))


def read_as_sights(line, pose, anchors):
    """Where each anchor (J, 2) seems to be from the mirrored place, and the heading that it tells there."""
    mirrored, images = mirror(line, pose[:2]), np.array([mirror(line, anchor) for anchor in anchors])
    assume(np.linalg.norm(images - pose[:2], axis=1).min() > 0.1)
    arrival = np.arctan2(*(images - pose[:2]).T[::-1]) - pose[2]  # as measured
    seen = np.arctan2(*(anchors - mirrored).T[::-1])
    return mirrored, seen, seen - arrival


@given(
    wall=st.tuples(st.floats(-np.pi, np.pi), st.floats(-20.0, 20.0)),
    pose=st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-np.pi, np.pi)),
    anchors=st.lists(PLACE, min_size=3, max_size=3),
)
def test_a_mirror_shows_those_on_its_side_that_lie_in_line(wall, pose, anchors):
    """Read as a line of sight, what comes over a wall tells another heading for each direction."""
    line, pose, anchors = np.array(wall), np.array(pose), np.array(anchors)
    place, seen, told = read_as_sights(line, pose, anchors)
    assume(np.linalg.norm(place - pose[:2]) > 0.1)
    turns = wrap(told - told[0])
    assert np.abs(wrap(turns - 2 * (seen - seen[0]))).max() < 1e-9
    assume(np.abs(np.abs(turns) - ALIKE_RAD).min() > 1e-6)
    side = anchors @ unit(line[0]) - line[1], pose[:2] @ unit(line[0]) - line[1]
    assume(np.abs(side[0]).min() > 1e-6)
    other = np.array([*place, told[0]])
    same_side = side[0] * side[1] > 0
    expected = same_side & (np.abs(turns) < ALIKE_RAD)
    assert shown_by_mirror(anchors, pose, other).tolist() == expected.tolist()
    assert shown_by_mirror(anchors, pose, other, arrives=False).tolist() == same_side.tolist()


def test_a_place_that_is_vague_turns_the_mirror_by_hand():
    """Of a mirror 2 m away, 0.2 m are 6 degrees, which turn what it shows by twice as much, twice over."""
    anchors, believed = np.array([[-5.0, 0.0]]), np.zeros(3)
    other = np.array([2.0, 0.0, np.pi + np.radians(30.0)])  # a mirror shows pi
    assert not shown_by_mirror(anchors, believed, other).any()
    assert shown_by_mirror(anchors, believed, other, 0.2).all()


@pytest.mark.parametrize(
    ("nats", "shown", "added"),
    [
        ((20.0, 8.0, 30.0), (True, True, False), 8.0),
        ((20.0, -1.0, 30.0), (True, True, False), 0.0),
        ((20.0, 8.0, 30.0), (False, False, True), 0.0),
        ((20.0, 8.0, 30.0), (False, False, False), 0.0),
        ((), (), 0.0),
    ],
)
def test_what_a_mirror_adds_by_hand(nats, shown, added):
    assert added_by_mirror(np.array(nats), np.array(shown, bool)) == added
