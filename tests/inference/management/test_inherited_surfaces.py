"""Surfaces of an earlier map after a run of hybrid SLAM: what became of their images moves all of them."""

from dataclasses import replace

import numpy as np
import pytest
from feature_samples import ANCHOR, LINES, learned, surfaces
from signal_worlds import signal_model

from gridslam.inference.management.features.inherited_surfaces import KnownSurfaces, surfaces_after
from gridslam.inference.management.features.mirror_cells import Mirrors
from gridslam.inference.management.features.sharing import handed_over, with_others
from gridslam.inference.management.features.surface_features import between, mirror_surfaces
from gridslam.inference.state.features.sightings import Sightings
from gridslam.inference.state.grid import Grid
from gridslam.maps.map import Map
from gridslam.world.geometry import mirror
from gridslam.world.radio import BINS

UNSEEN = Sightings.none()


def blank():
    return Map.blank(np.zeros(2), 0.1, (4, 4), 0.1)


def seen_mirrors(table, rows=None):
    """Mirrors among features that say nothing of coefficients."""
    found = mirror_surfaces(table if rows is None else table.take(rows))
    return Mirrors(found, np.full((len(found), BINS), 1 / BINS), Grid.empty((4, 4)))


def joint_of(table):
    square = np.zeros((3 * len(table), 3 * len(table)))
    for n, own in enumerate(table.covariance[:, :3, :3]):
        square[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] = own
    return square


def known(lines=LINES, seed=0):
    """Two surfaces whose errors are one agent's."""
    draw = np.random.default_rng(seed)
    root = draw.normal(size=(4, 4)) * [0.02, 0.05, 0.02, 0.05]
    joint = root.T @ root + np.diag(np.square([2e-3, 0.01, 2e-3, 0.01]))
    table = replace(surfaces(lines), line_cov=np.array([joint[:2, :2], joint[2:, 2:]]))
    return KnownSurfaces.of(table, None, joint)


def after(square, before, gain_rows, told_m, noise):
    """Kalman's update by hand of a Gaussian by what is told of some of its entries."""
    h = np.eye(len(square))[gain_rows]
    gain = square @ h.T @ np.linalg.inv(h @ square @ h.T + noise)
    return gain @ (told_m - before[gain_rows]), square - gain @ h @ square


def test_surfaces_follow_what_became_of_one_image_as_if_it_had_been_measured_by_them():
    start = known()
    given = handed_over(None, None, start.table, start.covariance, signal_model())
    place = np.column_stack([given.table.position_m, given.table.bias_m]).ravel()
    measured, noise = place[:2] + np.array([0.05, -0.02]), 0.03**2 * np.eye(2)
    step, square = after(given.covariance, place, [0, 1], measured, noise)
    moved = (place + step).reshape(-1, 3)
    table = replace(given.table, position_m=moved[:, :2], bias_m=moved[:, 2])
    found = surfaces_after(start, given, seen_mirrors(table, []), table, square, UNSEEN)
    # the same measurement, of the lines themselves
    slope = given.slopes[:2]
    spread = slope @ start.covariance @ slope.T + noise + 2e-6 * np.eye(2)
    gain = start.covariance @ slope.T @ np.linalg.inv(spread)
    lines = LINES.ravel() + gain @ (measured - place[:2])
    np.testing.assert_allclose(found.table.line.ravel(), lines, atol=1e-4)
    expected = start.covariance - gain @ slope @ start.covariance
    np.testing.assert_allclose(found.covariance, expected, atol=2e-3 * np.abs(start.covariance).max())
    assert found.covariance[2, 2] < 0.9 * start.covariance[2, 2], "the other surface is known better, too"
    replace(
        blank(), surfaces=found.table, surface_reflection=found.reflection,
        surface_covariance=found.covariance,
    )  # fmt: skip


def test_what_was_not_heard_stays_as_it_was():
    start = known()
    given = handed_over(None, None, start.table, start.covariance, signal_model())
    found = surfaces_after(start, given, seen_mirrors(given.table, []), given.table, given.covariance, UNSEEN)
    np.testing.assert_allclose(found.table.line, LINES, atol=1e-12)
    np.testing.assert_allclose(found.covariance, start.covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(found.table.identity, start.table.identity)
    np.testing.assert_array_equal(found.table.reflection, start.table.reflection)
    none = surfaces_after(
        start, given, seen_mirrors(given.table, []), given.table.take([]), np.zeros((0, 0)), UNSEEN
    )
    np.testing.assert_allclose(none.covariance, start.covariance, rtol=1e-12)


def test_mirrors_are_as_correlated_as_the_features_they_are():
    draw = np.random.default_rng(3)
    table = learned([mirror(line, ANCHOR) for line in LINES])
    root = draw.normal(size=(6, 6)) * 0.05
    joint = root.T @ root
    table = replace(table, covariance=np.tile(np.zeros((4, 4)), (2, 1, 1)))
    for n in range(2):
        table.covariance[n, :3, :3] = joint[3 * n : 3 * n + 3, 3 * n : 3 * n + 3]
    nothing = KnownSurfaces.of(None, None, None)
    found = surfaces_after(nothing, None, seen_mirrors(table), table, joint, UNSEEN)
    order = found.table.line[:, 0].argsort()
    rows = []
    for off in draw.multivariate_normal(np.zeros(6), 1e-4 * joint, 4000):
        places = table.position_m + off.reshape(2, 3)[:, :2]
        rows.append(np.concatenate([between(ANCHOR, place)[0] for place in places]))
    sampled = 1e4 * np.cov(np.array(rows).T)
    each = (2 * order[:, None] + np.arange(2)).ravel()
    own = found.covariance[np.ix_(each, each)]
    np.testing.assert_allclose(own, sampled, atol=0.08 * np.abs(sampled).max())
    assert np.abs(own[:2, 2:]).max() > 0.05 * np.abs(own).max()


@pytest.mark.parametrize("turned", [False, True])
def test_a_mirror_that_the_agent_found_afresh_is_another_estimate_of_a_surface(turned):
    start = known()
    lines = LINES * [1.0, -1.0] + [np.pi, 0.0] if turned else LINES
    start = replace(start, table=replace(start.table, line=lines))
    table = learned([mirror(LINES[0], ANCHOR) + 0.01], identity=np.array([40]))
    found = surfaces_after(start, None, seen_mirrors(table), table, joint_of(table), UNSEEN)
    assert len(found.table) == 2
    _, slope = between(table.anchor_m[0], table.position_m[0])
    own = slope @ table.covariance[0, :2, :2] @ slope.T
    # precisions add up
    flip = np.diag([1.0, -1.0 if turned else 1.0])
    expected = np.linalg.inv(np.linalg.inv(flip @ start.covariance[:2, :2] @ flip) + np.linalg.inv(own))
    np.testing.assert_allclose(found.covariance[0, 0], expected[0, 0], rtol=1e-6)
    assert (found.table.line[:, 1] >= 0).all()
    assert np.linalg.eigvalsh(found.covariance).min() > 0


def test_normals_are_turned_with_extents_and_covariances():
    start = known()
    lines = LINES.copy()
    lines[0] = [lines[0, 0] + np.pi, -lines[0, 1]]
    extent = np.array([[1.0, 4.0], [-2.0, 3.0]])
    start = replace(start, table=replace(start.table, line=lines, extent_m=extent))
    table = learned([mirror(LINES[1], ANCHOR) + 5.0], identity=np.array([40]))
    found = surfaces_after(start, None, seen_mirrors(table, slice(0)), table, joint_of(table), UNSEEN)
    np.testing.assert_allclose(found.table.line, LINES)
    np.testing.assert_array_equal(found.table.extent_m, [[-4.0, -1.0], [-2.0, 3.0]])
    sign = np.array([1.0, -1.0, 1.0, 1.0])
    np.testing.assert_allclose(found.covariance, start.covariance * sign * sign[:, None])
    np.testing.assert_allclose(found.table.line_cov[0], found.covariance[:2, :2])


def test_lines_on_both_sides_of_half_a_turn_are_near_each_other():
    start, west = known(np.array([[np.pi - 0.01, 6.0], LINES[1]])), np.array([-np.pi + 0.01, 6.0])
    table = learned([mirror(west, ANCHOR)], identity=np.array([40]))
    found = surfaces_after(start, None, seen_mirrors(table), table, joint_of(table), UNSEEN)
    assert len(found.table) == 2
    assert np.pi - 0.011 <= abs(found.table.line[0, 0]) <= np.pi
    assert found.table.line[0, 1] == pytest.approx(6.0, abs=0.1)


def test_a_mirror_that_was_known_stands_for_its_surface_and_another_is_new():
    start = known()
    images = [mirror(LINES[0], ANCHOR) + 0.04, mirror(np.array([-1.0, 9.0]), ANCHOR)]
    table = learned(images, identity=np.array([0, 7]))
    given = handed_over(table.take([0]), None, start.table, start.covariance, signal_model())
    given = given._replace(slopes=np.zeros_like(given.slopes))
    found = surfaces_after(start, given, seen_mirrors(table), table, joint_of(table), UNSEEN)
    assert len(found.table) == 3
    np.testing.assert_allclose(found.table.line[0], between(ANCHOR, table.position_m[0])[0])
    np.testing.assert_allclose(found.table.line[2], [-1.0, 9.0])
    assert len(set(found.table.identity)) == 3
    assert not found.covariance[:2, 2:4].any(), "it is that feature alone now"


def test_what_was_heard_bears_a_surface_out():
    start = known()
    given = handed_over(None, None, start.table, start.covariance, signal_model())
    table = replace(given.table, steps_seen=np.full(len(given.table), 30))
    mirrors = seen_mirrors(table, [0])
    weight = np.exp(-0.5 * (np.arange(BINS) - 7.0) ** 2)
    extent = np.array([[-2.0, 3.0]])
    mirrors = replace(
        mirrors, reflection=weight[None] / weight.sum(), surfaces=replace(mirrors.surfaces, extent_m=extent)
    )
    seen = UNSEEN.add(np.array([0]), np.zeros(2))
    for sightings, hears in ((UNSEEN, False), (seen, True)):
        found = surfaces_after(start, given, mirrors, table, given.covariance, sightings)
        assert len(found.table) == 2
        assert (found.reflection[0].argmax() == 7) == hears
        assert (found.table.existence[0] > start.table.existence[0]) == hears
        assert (found.table.extent_m[0, 1] == 3.0) == hears
        assert found.table.existence[1] == start.table.existence[1]


def test_features_of_anchors_that_are_not_there_stay_in_the_map():
    here, there = learned([[1.0, 2.0]]), learned([[5.0, 2.0], [7.0, 1.0]], anchor_m=np.full((2, 2), 99.0))
    joint = np.eye(6) + 0.5
    table, square = with_others(here, joint_of(here), there, joint, signal_model())
    np.testing.assert_array_equal(table.position_m[:, 0], [1.0, 5.0, 7.0])
    np.testing.assert_array_equal(square[3:, 3:], joint)
    assert not square[:3, 3:].any()
    assert len(set(table.identity)) == 3
    assert with_others(here, joint_of(here), None, None, signal_model())[0] is here
