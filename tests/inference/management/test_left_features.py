"""What is handed on beside surfaces: places that paths came from again and again, and earlier features."""

from dataclasses import fields, replace

import numpy as np
import pytest
from feature_samples import ANCHOR, LINES, learned

from gridslam.estimate_tables import FREE, SCATTERER
from gridslam.inference.management.features.left_features import are_images, left_features
from gridslam.inference.management.features.places import LONGER_M, places_of, sighted
from gridslam.inference.scans.unexplained import MOST, Unexplained
from gridslam.world.geometry import mirror

STD = np.array([0.02, 0.01])
POINT = np.array([-4.0, 6.0])


def left_over(far, angle, place, step, heading=0.3, spread=1e-6, amplitude=1.0):
    """One measurement that nothing explained."""
    zero = np.zeros(1, np.int64)
    return Unexplained(
        zero, zero + step, np.array([[far, angle]]), STD[None], np.array([amplitude]),
        np.array([[*place, heading]]), spread * np.eye(3)[None],
    )  # fmt: skip


def sights(*args, **more):
    return sighted(left_over(*args, **more), 0, ANCHOR)


def path(place, point, tied, heading=0.3):
    """Length and angle of arrival of a path from a point, or by way of it from the anchor."""
    way = point - place
    extra = np.hypot(*(point - ANCHOR)) if tied else 0.0
    return np.hypot(*way) + extra, np.arctan2(way[1], way[0]) - heading


def gathered(point, tied, steps=30, seed=0):
    """What an agent hears along a line of 3 m, noise included; amplitudes are 2 at 1 m."""
    draw, known = np.random.default_rng(seed), Unexplained.none()
    for k in range(steps):
        place = np.array([0.1 * k, -1.0])
        far, angle = path(place, point, tied) + draw.normal(size=2) * STD
        known = known.joined(left_over(far, angle, place, k, amplitude=2.0 / far))
    return known


def features(known, earlier=None, covariance=None, lines=LINES[:0]):
    return left_features(known, earlier, covariance, lines, ANCHOR[None], 4)


@pytest.mark.parametrize("tied", [True, False])
def test_a_place_is_where_length_and_direction_say_with_slopes_as_differences(tied):
    far, angle = path(np.zeros(2), POINT, tied)

    def place(moved, turned=0.0, far=far, angle=angle):
        one = sights(far, angle, moved, 3, 0.3 + turned)[int(tied)]
        return one.place_m[0]

    np.testing.assert_allclose(place(np.zeros(2)), POINT, atol=1e-9)
    one = sights(far, angle, np.zeros(2), 3, spread=1.0)[int(tied)]
    step = 1e-6
    by = [place(np.zeros(2), far=far + step), place(np.zeros(2), angle=angle + step)]
    slope = (np.array(by) - POINT).T / step
    np.testing.assert_allclose(one.covariance[0], slope * STD**2 @ slope.T, rtol=1e-3)
    by = [place(step * np.eye(2)[0]), place(step * np.eye(2)[1]), place(np.zeros(2), step)]
    slope = (np.array(by) - POINT).T / step
    np.testing.assert_allclose(one.pose[0], slope @ slope.T, rtol=1e-3)


def test_a_path_as_long_as_the_line_of_sight_is_no_scatterers():
    far = np.hypot(*ANCHOR) + 0.5 * LONGER_M
    assert [bool(one.tied[0]) for one in sights(far, 0.1, np.zeros(2), 0)] == [False]


@pytest.mark.parametrize(("tied", "kind"), [(True, SCATTERER), (False, FREE)])
def test_what_was_heard_along_the_way_is_a_feature_of_its_kind(tied, kind):
    table, joint = features(gathered(POINT, tied))
    assert table.kind.tolist() == [kind]
    assert np.hypot(*(table.position_m[0] - POINT)) < 0.05
    assert table.bias_m[0] == pytest.approx(np.hypot(*(table.position_m[0] - ANCHOR)) if tied else 0.0)
    assert table.variance[0] == pytest.approx(1.0), "an amplitude of 2 over four antennas"
    assert table.steps_seen[0] == 30
    off = np.append(
        table.position_m[0] - POINT, table.bias_m[0] - (np.hypot(*(POINT - ANCHOR)) if tied else 0)
    )
    assert off @ np.linalg.solve(joint + 1e-9 * np.eye(3), off) < 16
    np.testing.assert_array_equal(joint, table.covariance[0, :3, :3])


@pytest.mark.parametrize("tied", [True, False])
def test_errors_of_the_pose_last_and_nothing_tells_how_far_a_free_feature_is(tied):
    known = gathered(POINT, tied)
    sure, _ = features(known)
    vague, _ = features(replace(known, covariance=known.covariance + 0.04 * np.diag([1.0, 1.0, 0.0])))
    more = np.linalg.eigvalsh(vague.covariance[0, :2, :2] - sure.covariance[0, :2, :2])
    assert more.max() > 0.03, "not averaged over thirty steps"
    if not tied:
        way = sure.position_m[0] - [1.45, -1.0]
        along = np.append(way, -np.hypot(*way))
        deviation = np.sqrt(along @ sure.covariance[0, :3, :3] @ along) / (along @ along)
        assert deviation == pytest.approx(0.3, rel=0.05), "of its length, traded for extra length"


def test_few_looks_looks_from_one_place_and_clutter_are_no_features():
    assert features(gathered(POINT, True, steps=9))[0] is None
    still, draw, clutter = Unexplained.none(), np.random.default_rng(1), Unexplained.none()
    for k in range(30):
        still = still.joined(left_over(*path(np.zeros(2), POINT, True), np.zeros(2), k))
    assert features(still)[0] is None
    assert places_of(still, ANCHOR[None], 10).steps.tolist() == [30, 30]
    for k in range(200):
        far, angle = draw.uniform([1.0, -np.pi], [30.0, np.pi])
        clutter = clutter.joined(left_over(far, angle, np.array([0.02 * k, 0.0]), k))
    assert features(clutter)[0] is None
    assert len(places_of(clutter, ANCHOR[None], 10)) < 50


def test_several_paths_of_one_step_count_once():
    one = left_over(*path(np.zeros(2), POINT, True), np.zeros(2), 4)
    places = places_of(one.joined(one).joined(one), ANCHOR[None], 3)
    assert places.steps.tolist() == [1, 1]
    assert places_of(one.joined(one), ANCHOR[None], 3).steps.tolist() == []


def test_the_latest_are_kept():
    known = Unexplained.none()
    for k in range(3):
        one = left_over(9.0, 0.1, np.zeros(2), k)
        many = (np.repeat(getattr(one, f.name), MOST - 7, 0) for f in fields(one))
        known = known.joined(Unexplained(*many))
    assert np.bincount(known.step).tolist() == [0, 7, MOST - 7]


def test_features_that_are_images_in_surfaces_are_left_to_these():
    once = [mirror(line, ANCHOR) for line in LINES]
    twice = mirror(LINES[1], once[0])
    table = learned([*once, twice, POINT])
    np.testing.assert_array_equal(are_images(table, LINES), [True, True, True, False])
    assert not are_images(table, LINES[:0]).any()
    joint = np.eye(12) + 0.5
    kept, square = features(None, table, joint, LINES)
    np.testing.assert_array_equal(kept.position_m, [POINT])
    np.testing.assert_array_equal(square, joint[9:, 9:])
    kept, _ = features(gathered(once[0], False), None, None, LINES)
    assert kept is None, "what a surface found later explains isn't unexplained"


def test_an_earlier_maps_feature_isnt_found_twice():
    far = np.hypot(*(POINT - ANCHOR))
    table = learned([POINT], bias_m=np.array([far]), kind=np.array([SCATTERER]))
    kept, joint = features(gathered(POINT, True), table, None)
    assert len(kept) == 1
    other = gathered(np.array([5.0, -6.0]), True)
    both, joint = features(other, table, None)
    assert len(both) == 2
    assert joint.shape == (6, 6)
    assert len(set(both.identity)) == 2
    none, _ = features(None, table.take([]), None)
    assert len(none) == 0, "a map that has a table of features keeps one"
