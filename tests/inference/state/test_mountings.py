"""How anchors stand otherwise than is told: frames, and what is learned in one anchor's of all others."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of

from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.turn import direction
from gridslam.inference.state.mountings import Learned, Mountings, by_mounting, carried, common_turn
from gridslam.world.geometry import mirror, unit, wrap

PLACES = np.array([[1.0, 2.0, 0.3], [6.0, -1.0, 2.0], [3.0, 5.0, -1.0]])
ROWS = slice(3, 6)
"""Of the second anchor."""


def model(place=0.1, turn=0.05, anchors=PLACES):
    own = model_of("canyon", anchors)
    return replace(own, mounting_std=np.tile([place, turn], (len(anchors), 1)))


def belief_of(seed, lines=2):
    draw = np.random.default_rng(seed)
    angles = draw.uniform(-3, 3, lines)
    mean = np.append(draw.uniform(-3, 3, 5), np.column_stack([angles, draw.uniform(2, 9, lines)]))
    root = 0.1 * draw.normal(size=(len(mean), len(mean)))
    return Belief(mean, root @ root.T)


def linked(seed, own=None):
    """A belief, and mountings with which it is correlated, one Gaussian together."""
    draw, own = np.random.default_rng(seed + 100), own or model()
    belief = belief_of(seed)
    size, count = len(belief.mean), 3 * own.senders
    root = np.diag(np.tile([0.1, 0.1, 0.05], own.senders)) @ draw.normal(size=(count, size + count)) / 4
    whole = np.concatenate([np.linalg.cholesky(belief.covariance) @ np.eye(size, size + count), root])
    joint = whole @ whole.T
    start = Mountings.start(own, size)
    mean = 0.03 * draw.normal(size=count)
    return belief, replace(start, mean=mean, covariance=joint[size:, size:], cross=joint[size:, :size])


def heard(belief, place, facing):
    """Distance, departure and arrival of the line of sight, and of the bounce over the first line."""
    found, (angle, offset) = [], belief.lines[0]
    image = mirror(np.array([angle, offset]), place)
    for source, bounced in ((place, False), (image, True)):
        away = source - belief.mean[:2]
        arrival = np.arctan2(away[1], away[0])
        out = 2 * angle - arrival if bounced else arrival + np.pi
        found += [np.hypot(*away), wrap(out - facing), wrap(arrival - belief.mean[4])]
    return np.array(found)


@pytest.mark.parametrize("seed", range(6))
def test_what_an_anchor_hears_is_the_same_in_its_frame(seed):
    """There it stands as the model has it; in the scene, as it is believed to."""
    own = model()
    belief, mountings = linked(seed, own)
    dx, dy, turn = mountings.aside[1]
    there, _ = mountings.framed(belief, 1, own)
    inside = heard(there, PLACES[1, :2], PLACES[1, 2])
    outside = heard(belief, PLACES[1, :2] + [dx, dy], PLACES[1, 2] + turn)
    np.testing.assert_allclose(inside, outside, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_there_and_back_is_nothing(seed):
    own = replace(model(), aside=np.full((3, 3), 0.01))  # as the step has taken them
    belief, mountings = linked(seed, own)
    back, after = (both := mountings.framed(belief, 1, own))[1].unframed(both[0], 1, own)
    np.testing.assert_allclose(back.mean, belief.mean, atol=1e-12)
    np.testing.assert_allclose(back.covariance, belief.covariance, atol=1e-12)
    np.testing.assert_allclose(after.cross, mountings.cross, atol=1e-12)
    assert after.mean is mountings.mean


@pytest.mark.parametrize("entry", range(3))
def test_derivatives_are_those_of_how_it_looks_from_there(entry):
    belief, place, step = belief_of(3), PLACES[1, :2], 1e-6
    seen = []
    for sign in (1, -1):
        stands = np.zeros(3)
        stands[entry] = sign * step
        seen.append(carried(belief, place + stands[:2], place, -stands[2]).mean)
    np.testing.assert_allclose(
        (seen[0] - seen[1]) / (2 * step), by_mounting(belief, place)[:, entry], atol=1e-7
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_measurement_says_what_it_says_of_all_in_one_gaussian(seed):
    """The distance and departure of a line of sight, by derivatives: twin of two Kalman updates."""
    own = model()
    belief, mountings = linked(seed, own)
    mountings = replace(mountings, mean=np.zeros(9))
    size, noise = len(belief.mean), np.diag([0.02, 0.01]) ** 2
    away = belief.mean[:2] - PLACES[1, :2]
    length = np.hypot(*away)
    slope = np.zeros((2, size))
    slope[0, :2], slope[1, :2] = away / length, np.array([-away[1], away[0]]) / length**2
    gap = np.array([0.03, -0.02])

    there, framed = mountings.framed(belief, 1, own)
    gain = there.covariance @ slope.T @ np.linalg.inv(slope @ there.covariance @ slope.T + noise)
    shorter = there.covariance - gain @ slope @ there.covariance
    after = replace(there, mean=there.mean + gain @ gap, covariance=shorter)
    known = framed.following(there, after)
    back, found = known.unframed(after, 1, own)

    joint = np.block([[belief.covariance, mountings.cross.T], [mountings.cross, mountings.covariance]])
    whole = np.zeros((2, size + 9))
    whole[:, :size], whole[:, size:][:, ROWS] = slope, slope @ by_mounting(belief, PLACES[1, :2])
    gain = joint @ whole.T @ np.linalg.inv(whole @ joint @ whole.T + noise)
    mean, joint = gain @ gap, joint - gain @ whole @ joint
    np.testing.assert_allclose(found.mean, mean[size:], atol=1e-9)
    np.testing.assert_allclose(found.covariance, joint[size:, size:], atol=1e-9)
    # the slope back is taken at the corrected mean
    shift = np.abs(by_mounting(after, PLACES[1, :2]) - by_mounting(belief, PLACES[1, :2])).max()
    np.testing.assert_allclose(back.covariance, joint[:size, :size], atol=shift)
    np.testing.assert_allclose(found.cross, joint[size:, :size], atol=shift)


def test_new_walls_are_as_correlated_as_the_agent_that_they_follow_from():
    """A line that hangs on the agent alone: its covariance with an anchor is that of the agent."""
    belief, mountings = linked(1)
    size = len(belief.mean)
    follows = np.zeros((2, size))
    follows[:, :5] = np.random.default_rng(2).normal(size=(2, 5))
    whole = np.vstack([np.eye(size), follows])
    after = Belief(whole @ belief.mean, whole @ belief.covariance @ whole.T)
    known = mountings.following(belief, after, (np.arange(size),) * 2)
    np.testing.assert_allclose(known.cross[:, size:], mountings.cross @ follows.T, atol=1e-9)
    np.testing.assert_allclose(known.covariance, mountings.covariance, atol=1e-9)


def test_motion_carries_correlations_with_the_velocity():
    _, mountings = linked(0)
    after = mountings.predicted(0.5)
    np.testing.assert_allclose(after.cross[:, 0], mountings.cross[:, 0] + 0.5 * mountings.cross[:, 2])
    np.testing.assert_array_equal(after.cross[:, 2:], mountings.cross[:, 2:])


def test_what_two_anchors_leave_open_of_a_turn_of_all_by_hand():
    """4 m apart, 0.1 m and 0.05 rad: 2 x 2^2 / 0.01 + 2 / 0.0025 = 800 + 800 per rad^2."""
    place, std = np.array([[1.0, 2.0], [5.0, 2.0]]), np.full(2, 0.1)
    pivot, together, variance = common_turn(place, std, np.full(2, 0.05))
    np.testing.assert_allclose(pivot, [3.0, 2.0])
    np.testing.assert_allclose(together, [0, -2, 1, 0, 2, 1])
    assert variance == pytest.approx(1 / 1600)
    # one place is known: all turn about it, and of the other's 4 m / 0.1 m is 1600 alone
    pivot, _, variance = common_turn(place, np.array([0.0, 0.1]), np.full(2, 0.05))
    np.testing.assert_allclose(pivot, place[0])
    assert variance == pytest.approx(1 / (1600 + 800))
    assert common_turn(place, np.zeros(2), np.full(2, 0.05))[2] == 0
    assert common_turn(place, std, np.array([0.0, 0.05]))[2] == 0


def test_a_turn_of_all_is_left_out_of_the_prior_and_no_part_of_it_twice():
    own = model(0.1, 0.05)
    start = Mountings.start(own, 5)
    prior = np.diag(np.tile([0.01, 0.01, 0.0025], 3))
    _, together, variance = common_turn(PLACES[:, :2], np.full(3, 0.1), np.full(3, 0.05))
    np.testing.assert_allclose(start.covariance + variance * np.outer(together, together), prior, atol=1e-15)
    np.testing.assert_allclose(start.covariance @ np.linalg.inv(prior) @ together, 0, atol=1e-12)
    np.testing.assert_allclose(start.in_scene(own), np.tile([0.1, 0.1, 0.05], (3, 1)))
    assert start.turn_variance == variance


def test_nothing_is_open_where_all_is_told_and_one_anchor_alone_takes_all_along():
    assert Mountings.start(model(0.0, 0.0), 5) is None
    start = Mountings.start(model(0.1, 0.05, PLACES[:1]), 5)
    np.testing.assert_allclose(np.diag(start.covariance), [0.01, 0.01, 0.0], atol=1e-15)
    assert start.turn_variance == pytest.approx(0.05**2)
    np.testing.assert_array_equal(start.pivot, PLACES[0, :2])


def test_without_departures_nothing_hangs_on_turns_and_places_alone_tell_that_of_all():
    own = model(0.1, 0.05)
    silent = replace(own, radio=replace(own.radio, measures=("distance", "aoa")))
    start = Mountings.start(silent, 5)
    assert not start.covariance[2::3].any()
    place = PLACES[:, :2]
    lever = np.square(place - place.mean(0)).sum()
    assert start.turn_variance == pytest.approx(0.01 / lever)
    np.testing.assert_allclose(start.in_scene(silent), np.tile([0.1, 0.1, 0.05], (3, 1)))
    assert Mountings.start(replace(silent, mounting_std=np.array([[0.0, 0.05]] * 3)), 5) is None
    alone = model(0.1, 0.05, PLACES[:1])
    alone = replace(alone, radio=replace(alone.radio, measures=("distance", "aoa")))
    assert Mountings.start(alone, 5).turn_variance == 0


def after_a_run(own, seed=8):
    """An agent's belief and mountings that have become surer of differences, not of a turn of all."""
    start, belief = Mountings.start(own, 9), belief_of(seed)
    noise, count = np.random.default_rng(seed + 7), 3 * own.senders
    head = np.zeros((count + 9,) * 2)
    head[:count, :count], head[count:, count:] = start.covariance, belief.covariance
    told = noise.normal(size=(6, count + 9)) / 0.05
    root = np.linalg.solve(told @ head @ told.T + np.eye(6), told @ head)
    left = head - head @ told.T @ root
    left = 0.5 * (left + left.T)
    mountings = replace(
        start,
        mean=0.03 * noise.normal(size=count),
        covariance=left[:count, :count],
        cross=left[:count, count:],
    )
    return replace(belief, covariance=left[count:, count:]), mountings


def handed(own, belief, mountings, told=None):
    """What the next agent begins with, by the map of one that is through; its lines alone are handed over."""
    turned = mountings.turn_variance * np.outer(way := direction(belief, mountings.pivot), way)
    whole = replace(belief, covariance=belief.covariance + turned)
    covariance, cross = mountings.jointly(whole, own)
    begun = np.zeros((9, 9))
    begun[:5, :5], begun[5:, 5:] = 0.01 * np.eye(5), whole.covariance[5:, 5:]
    learned = Learned(mountings.aside, covariance, cross[:, 5:])
    return Mountings.handed(told or own, replace(belief, covariance=begun), learned)


def scaled_least(*parts):
    """The least eigenvalue of a joint correlation matrix."""
    joint = np.block([[parts[0], parts[1]], [parts[1].T, parts[2]]])
    scale = np.sqrt(np.diag(joint))
    some = scale > 0
    return np.linalg.eigvalsh((joint / np.outer(scale + ~some, scale + ~some))[np.ix_(some, some)]).min()


def test_the_next_agent_goes_on_where_the_first_one_ended():
    """Anchors and walls against each other as before; a start that is told may be turned against them."""
    own = model()
    belief, mountings = after_a_run(own)
    begun, again = handed(own, belief, mountings)
    assert again.turn_variance == pytest.approx(mountings.turn_variance, rel=1e-6)
    np.testing.assert_array_equal(again.mean, mountings.mean)
    np.testing.assert_array_equal(begun.mean, belief.mean)
    np.testing.assert_allclose(again.covariance, mountings.covariance, atol=1e-9)
    np.testing.assert_allclose(again.cross[:, 5:], mountings.cross[:, 5:], atol=1e-9)
    np.testing.assert_allclose(begun.covariance[5:, 5:], belief.covariance[5:, 5:], atol=1e-8)
    assert not again.cross[:, :5].any()
    assert not begun.covariance[:5, 5:].any()
    assert all(part.flags.c_contiguous for part in (begun.covariance, again.covariance, again.cross))
    way = direction(begun, again.pivot)[:5]
    turned = 0.01 * np.eye(5) + again.turn_variance * np.outer(way, way)
    np.testing.assert_allclose(begun.covariance[:5, :5], turned, atol=1e-9)
    assert scaled_least(again.covariance, again.cross, begun.covariance) > -1e-9


def test_about_an_only_anchor_walls_may_be_turned_and_the_start_is_as_told():
    own = model(anchors=PLACES[:1])
    belief, mountings = after_a_run(own)
    begun, again = handed(own, belief, mountings)
    assert again.turn_variance == pytest.approx(0.05**2, rel=1e-6)
    np.testing.assert_allclose(again.covariance, mountings.covariance, atol=1e-9)
    np.testing.assert_array_equal(begun.covariance[:5, :5], 0.01 * np.eye(5))
    way = direction(begun, again.pivot)[5:]
    turned = belief.covariance[5:, 5:] + 0.05**2 * np.outer(way, way)
    np.testing.assert_allclose(begun.covariance[5:, 5:], turned, atol=1e-8)
    # its turn is that of all: nothing is left of it, not even of rounding
    for one in (again, Mountings.start(own, 9)):
        assert one.covariance[2, 2] == 0
        assert not one.cross[2].any()


def test_what_the_next_scene_tells_better_counts_until_it_is_as_sure_as_told():
    """An anchor that was surveyed since takes along what hangs on it; what is told worse does not count."""
    own = model()
    belief, mountings = after_a_run(own)
    told = own.mounting_std.copy()
    told[1] = 0.005, 0.001
    told[2] = 0.3, 0.2
    begun, again = handed(own, belief, mountings, replace(own, mounting_std=told))
    std = again.in_scene(replace(own, mounting_std=told))
    assert (std[1] <= [0.00501, 0.00501, 0.00101]).all()
    assert (std[2] <= np.sqrt(np.diag(mountings.jointly(belief, own)[0]))[6:] + 1e-9).all()
    assert np.abs(again.aside[1]).max() < 1e-3 < np.abs(mountings.aside[1]).max()
    assert np.trace(begun.covariance[5:, 5:]) < np.trace(belief.covariance[5:, 5:])
    assert np.abs(begun.mean[5:] - belief.mean[5:]).max() > 1e-3
    # as Kalman's formula has it, of one entry alone
    one = np.zeros_like(own.mounting_std) + 9.0
    one[0, 1], measured = 0.01, replace(own, mounting_std=one)
    joint = mountings.jointly(belief, own)[0]
    begun, again = handed(own, belief, mountings, measured)
    share = (1 - 0.01**2 / joint[2, 2]) / joint[2, 2]
    expected = mountings.mean - share * mountings.mean[2] * joint[:, 2]
    np.testing.assert_allclose(again.mean, expected, atol=1e-12)


@pytest.mark.parametrize("tiny", [0.0, 1e-9])
def test_what_is_known_by_now_is_taken_as_told(tiny):
    """Orientations that the next scene knows: neither turned nor anything of a turn of all; or all of it."""
    belief, mountings = after_a_run(model())
    begun, again = handed(model(), belief, mountings, model(turn=tiny))
    np.testing.assert_allclose(again.aside[:, 2], 0, atol=1e-8)
    np.testing.assert_allclose(again.covariance[2::3], 0, atol=1e-8)
    assert again.turn_variance < 1e-15
    assert scaled_least(again.covariance, again.cross, begun.covariance) > -1e-6
    walls, none = handed(model(), belief, mountings, model(place=0.0, turn=0.0))
    assert none is None
    assert np.trace(walls.covariance[5:, 5:]) < np.trace(begun.covariance[5:, 5:])


def test_of_radios_without_departures_turns_are_as_told_in_the_map_and_count_for_nothing_in_the_next_one():
    own = model()
    silent = replace(own, radio=replace(own.radio, measures=("distance", "aoa")))
    belief, mountings = after_a_run(silent)
    covariance, cross = mountings.jointly(belief, silent)
    np.testing.assert_allclose(np.diag(covariance)[2::3], 0.05**2)
    assert not cross[2::3].any()
    begun, again = handed(own, *after_a_run(own), silent)
    assert not again.covariance[2::3].any()
    assert not again.cross[2::3].any()
    assert scaled_least(again.covariance, again.cross, begun.covariance) > -1e-9


def test_who_is_found_by_anchors_is_off_by_what_they_have_in_common():
    """Two of 0.1 m: on the average 0.1 / sqrt(2). One Gaussian with walls that hang on them, too."""
    own = model(0.1, 0.0, PLACES[:2])
    belief, mountings = linked(4, own)
    mountings = replace(Mountings.start(own, 9), cross=mountings.cross)
    found = belief.covariance.copy()
    found[:5], found[:, :5] = 0.0, 0.0
    found[:5, :5] = np.diag([1e-4, 1e-4, 1e-2, 1e-2, 1e-4])
    after, linked_to = mountings.shared(replace(belief, covariance=found), np.arange(5))
    np.testing.assert_allclose(np.diag(after.covariance)[:2], 1e-4 + 0.005)
    np.testing.assert_allclose(after.covariance[2:5, 2:5], found[2:5, 2:5])
    average = np.tile(np.eye(3)[:2], 2) / 2
    np.testing.assert_allclose(linked_to.cross[:, :2], mountings.covariance @ average.T)
    np.testing.assert_allclose(after.covariance[:2, 5:], average @ mountings.cross[:, 5:])
    assert not linked_to.cross[:, 2:5].any()


def test_walls_that_anchors_found_are_shifted_along_their_normals():
    own, belief = model(0.1, 0.0, PLACES[:2]), belief_of(5)
    belief.covariance[:5, 5:] = belief.covariance[5:, :5] = 0.0  # of another agent
    start = Mountings.start(own, 9)
    after, linked_to = start.shared(belief, np.arange(5, 9))
    normal = unit(belief.lines[:, 0])
    shared = 0.005 * normal @ normal.T
    added = after.covariance - belief.covariance
    np.testing.assert_allclose(added[np.ix_([6, 8], [6, 8])], shared, atol=1e-15)
    np.testing.assert_allclose(added[[5, 7]], 0, atol=1e-15)
    assert not linked_to.cross[:, :5].any()


def test_angles_that_pass_the_half_turn_are_followed_the_short_way():
    belief, mountings = linked(2)
    mean = belief.mean.copy()
    before = replace(belief, mean=np.where(np.arange(9) == 4, np.pi - 0.01, mean))
    after = replace(belief, mean=np.where(np.arange(9) == 4, -np.pi + 0.01, mean))
    gain = np.linalg.solve(belief.covariance, mountings.cross.T).T
    moved_by = mountings.following(before, after).mean - mountings.mean
    np.testing.assert_allclose(moved_by, 0.02 * gain[:, 4], rtol=1e-6)
