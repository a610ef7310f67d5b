"""Mirrors that were learned as surfaces and cells: where they reflect, how much, and how surely."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from feature_samples import ANCHOR, learned
from signal_worlds import signal_model

from gridslam.estimate_tables import SCATTERER
from gridslam.inference.management.features.mirror_cells import SURE, mirrors_of, reflections
from gridslam.inference.state.features.features import FeatureBank
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.inference.state.features.sightings import APART_M, Sightings
from gridslam.maps.map import Map
from gridslam.world.geometry import mirror
from gridslam.world.scene_parts import GridSpec

WALL = np.array([0.0, 6.05])
"""x = 6.05: the middle of a cell."""
SPEC = GridSpec(x_m=(-10.0, 10.0), y_m=(-10.0, 10.0), cell_m=0.1)
MODEL = replace(signal_model(), grid=SPEC)
PRIOR = -np.expm1(-0.1 / MODEL.settings.mean_free_path_m)
AGENT = np.array([[0.0, 0.0], [0.0, 1.0]])
SIGHT, IDENTITY = -1, 7


def belief(power=0.5, detected=(IDENTITY, SIGHT), deviation=0.01):
    image = mirror(WALL, ANCHOR)
    table = learned([image], variance=np.array([power]), identity=np.array([IDENTITY]))
    square = 1e-9 * np.eye(4)
    square[0, 0] = (2 * deviation) ** 2  # the wall moves by half as much as the image
    table = replace(table, covariance=square[None])
    seen = Sightings.none()
    for place in AGENT:
        seen = seen.add(np.array(detected), place)
    bank = FeatureBank.empty().add(IDENTITY, 0, np.zeros(2), power, 3)
    ones = np.ones(1)
    return table, JointBelief(np.zeros(7), np.eye(7), bank, ones, ones, ones, sightings=seen)


def drawn(*args, **more):
    found = mirrors_of(*belief(*args, **more), MODEL)
    grid = found.grid
    return Map(
        SPEC.origin_m, SPEC.cell_m, grid.evidence, grid.coefficient, grid.observed, PRIOR, found.surfaces,
        found.reflection,
    )  # fmt: skip


def cell(x, y):
    return tuple(drawn().index(np.array([x, y]))[0])


def test_a_mirror_is_a_surface_with_the_coefficient_that_its_power_says():
    found = drawn()
    np.testing.assert_allclose(found.surfaces.line, [WALL], atol=1e-12)
    assert found.surfaces.reflection[0] == pytest.approx(np.sqrt(0.5), abs=0.03)
    assert 0.08 < np.sqrt(found.surfaces.reflection_var[0]) < 0.15
    np.testing.assert_allclose(found.surface_reflection.sum(1), 1.0)
    # paths from (3, 4) to (0, 0) and (0, 1) meet x = 6.05 where the way unfolds to the image at (9.1, 4)
    at = sorted(y + (4 - y) * 6.05 / 9.1 for _, y in AGENT)
    np.testing.assert_allclose(found.surfaces.extent_m[0], at, atol=1e-9)


def test_walls_are_met_where_they_reflect_and_what_lies_between_is_free():
    found = drawn()
    hit = cell(6.05, 4 * 6.05 / 9.1)
    assert found.occupied[hit]
    assert found.reflection[hit] == pytest.approx(found.surfaces.reflection[0], abs=0.01)
    assert found.free[cell(3.0, 1.98)], "between agent and wall"
    assert found.free[cell(1.5, 2.0)], "the line of sight"
    assert not found.observed[cell(6.5, 3.0)], "behind the wall"
    assert not found.observed[cell(-3.0, -3.0)]
    assert found.occupied.sum() == 2


def test_a_wall_that_is_known_badly_is_met_in_no_cell_for_sure():
    found = drawn(deviation=1.0)
    hit = cell(6.05, 4 * 6.05 / 9.1)
    assert found.observed[hit]
    assert not found.occupied[hit]
    assert PRIOR < found.occupancy[hit] < 0.1
    sure = drawn().occupancy[hit]
    assert sure == pytest.approx(SURE, abs=0.01)


def test_without_a_line_of_sight_nothing_says_how_much_is_reflected():
    found = drawn(detected=(IDENTITY,))
    assert found.surfaces.reflection[0] == pytest.approx(0.5)
    assert not found.coefficient.any()
    assert not found.observed[cell(1.5, 2.0)]


@pytest.mark.parametrize("far", [1e7, 1e12, 1e100])
def test_a_sighting_from_far_off_takes_no_more_memory(far):
    table, joint = belief()
    seen = joint.sightings.add(np.array([IDENTITY, SIGHT]), np.array([-far, 1.0]))
    tracemalloc.start()
    try:
        found = mirrors_of(table, replace(joint, sightings=seen), MODEL)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1e8
    assert np.isfinite(found.grid.evidence).all()
    near = mirrors_of(table, joint, MODEL).grid
    assert found.grid.observed[near.observed].all()


def test_no_mirror_no_surface():
    table, joint = belief()
    found = mirrors_of(replace(table, kind=np.array([SCATTERER])), joint, MODEL)
    assert len(found.surfaces) == 0
    assert not found.grid.observed.any()


def test_no_feature_of_a_crowd_is_a_wall():
    table, joint = belief()
    assert len(mirrors_of(table, joint, MODEL).surfaces) == 1
    found = mirrors_of(table, replace(joint, extent=0.2), MODEL)
    assert len(found.surfaces) == len(found.reflection) == 0
    assert not found.grid.observed.any()


def test_a_wall_that_was_heard_from_nowhere_has_no_extent():
    found = drawn(detected=(SIGHT,))
    assert np.isnan(found.surfaces.extent_m).all()
    assert not found.occupied.any()


def test_paths_that_do_not_cross_the_line_meet_nothing():
    at, places = reflections(WALL, ANCHOR, np.array([[8.0, 0.0], [0.0, 0.0]]))
    np.testing.assert_allclose(places, [[0.0, 0.0]])
    np.testing.assert_allclose(at[:, 0], 6.05)


def test_places_are_kept_once_and_so_do_not_grow_with_time():
    seen = Sightings.none()
    for _ in range(100):
        for x in np.linspace(0, 1, 11):
            seen = seen.add(np.array([3, SIGHT]), np.array([x, 0.0]))
    assert len(seen.of(3)) == len(seen.of(SIGHT)) <= 1 / APART_M + 1
    other = seen.add(np.array([4]), np.array([0.0, 0.0]))
    assert (len(other.of(4)), len(other.of(3))) == (1, len(seen.of(3)))
    kept = other.keep(np.array([4]))
    assert sorted(set(kept.identity)) == [SIGHT, 4]
