"""Surfaces there to be found and what found ones score: cases done by hand, and OSPA itself."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tiny import TINY
from wall_samples import paths, walls

import gridslam as gs
from gridslam.estimate_tables import SurfaceEstimate
from gridslam.evaluation.metrics import ospa
from gridslam.evaluation.surface_truth import AudibleSurfaces, assigned_error, surface_scores
from gridslam.simulation.image_source import Truth
from gridslam.world import geometry
from gridslam.world.geometry import line_of_sfv


def truth_of(segments, seen):
    return Truth(None, seen, segments)


def lines_at(feature, owner=None):
    """Found surfaces with these feature vectors (S, 2)."""
    line = line_of_sfv(np.reshape(feature, (-1, 2)))
    one = np.ones(len(line))
    flat = np.zeros((len(line), 2, 2))
    return SurfaceEstimate.from_lines(line, flat, one, one, one, owner=owner)


def single(y, segment, x=0.0):
    """Single bounce at (x, y) from the origin's side and back."""
    return ([[x, 0], [x, y], [x + 0.1, 0]], [segment, -1])


def test_surface_seen_by_no_path_is_not_demanded_and_a_window_is_no_second_wall():
    segments = walls(
        ([0, 2], [1, 2], 0.7, 0), ([1, 2], [2, 2], 0.3, 0), ([5, 0], [5, 1], 0.7, 1), ([9, 0], [9, 1], 0.7, 2)
    )
    seen = paths(
        ([[0, 0], [0.5, 2], [1, 0]], [0, -1]),
        ([[0, 0], [1.5, 2], [3, 0]], [1, -1]),
        ([[0, 0], [0.5, 2], [5, 0.5], [1, 0]], [0, 2]),
    )
    audible = AudibleSurfaces.of(truth_of(segments, seen))
    np.testing.assert_allclose(audible.feature, [[0, 4], [10, 0]], atol=1e-12)
    assert audible.first.tolist() == [0, 2]
    assert [audible.count(step) for step in range(3)] == [1, 1, 2]
    scores = surface_scores(lines_at([[0, 4]]), truth_of(segments, seen))
    counts = {"surfaces_matched": 1, "surfaces_true": 2, "surfaces_false": 0}
    distances = {"surface_ospa_m": pytest.approx(2.5), "surface_gospa_m": pytest.approx(2.5)}
    assert scores == counts | distances
    beside = surface_scores(lines_at([[0, 4], [0, 4.3], [0, 4.6]]), truth_of(segments, seen))
    assert (beside["surfaces_matched"], beside["surfaces_false"]) == (1, 1)
    assert beside["surface_gospa_m"] == pytest.approx(5 + 2.5), "one missed, two false"
    unheard = surface_scores(lines_at([[0, 4], [18, 0]]), truth_of(segments, seen))
    assert (unheard["surfaces_matched"], unheard["surfaces_false"]) == (1, 0), "of an earlier map, say"
    assert audible.ospa(lines_at([[0, 4]]), step=1) == pytest.approx(0, abs=1e-9)


def test_world_without_walls_has_nothing_to_be_found():
    whole = np.zeros(0, int)
    none = geometry.Segments(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), whole, whole, whole)
    truth = truth_of(none, paths(([[2.5, 2.5], [6.5, 2.5]], [-1, -1])))
    audible = AudibleSurfaces.of(truth)
    assert (len(audible.feature), len(audible.first), audible.count()) == (0, 0, 0)
    assert audible.ospa(lines_at([])) == 0
    assert audible.ospa(lines_at([[1, 1]])) == 5
    assert (audible.gospa(lines_at([])), audible.gospa(lines_at([[1, 1], [2, 2]]))) == (0, 5)


@pytest.fixture(scope="module")
def front():
    """A straight wall and a curved one of three facets, all heard."""
    segments = walls(
        ([0, 2], [4, 2], 0.7, 0),
        ([0, -3], [1, -3], 0.3, 1),
        ([1, -3], [2, -4], 0.3, 2),
        ([2, -4], [2, -6], 0.3, 3),
        curve=[-1, 1, 1, 1],
    )
    return AudibleSurfaces.of(truth_of(segments, paths(*(single(1, piece) for piece in range(4)))))


def test_curved_wall_is_there_once_and_any_of_its_facets_may_stand_for_it(front):
    wall, left, middle, right = front.feature
    assert front.count() == 2
    assert front.ospa(lines_at([])) == 5
    assert front.ospa(lines_at([wall])) == pytest.approx(2.5)  # the curved one is missing, once
    for facet in (left, middle, right):
        assert front.ospa(lines_at([wall, facet])) == pytest.approx(0, abs=1e-9)
        assert front.ospa(lines_at([wall, facet + np.array([0.3, 0.4])])) == pytest.approx(0.25)
    assert front.ospa(lines_at([wall, left, right])) == pytest.approx(0, abs=1e-9)
    assert front.ospa(lines_at([wall, left, [40, 40]])) == pytest.approx(5 / 3)  # a ghost stays one
    assert front.ospa(lines_at([wall, [40, 40]])) == pytest.approx(2.5)
    five = [wall, left, middle, right, right]  # more lines than facets
    assert front.ospa(lines_at(five)) == pytest.approx(1)


def test_facet_in_line_with_a_straight_wall_is_part_of_that():
    segments = walls(([0, 2], [4, 2], 0.7, 0), ([4, 2], [5, 2], 0.3, 0), curve=[-1, 1])
    audible = AudibleSurfaces.of(truth_of(segments, paths(single(2, 1))))
    assert audible.curve.tolist() == [-1]


def test_canyon_tells_its_facets_and_no_other_scene_has_any():
    for name, curved in (("canyon", 32), ("hall", 0), ("room", 0)):
        pieces = gs.Scene.load(name).segments()
        assert (pieces.curve >= 0).sum() == curved
        assert (pieces.curve[pieces.curve >= 0] == pieces.wall[pieces.curve >= 0]).all()


@pytest.fixture(scope="module")
def two_anchors():
    """Anchor 0 hears both walls, anchor 1 the first alone, from step 2 on."""
    segments = walls(([0, 2], [4, 2], 0.7, 0), ([6, 0], [6, 3], 0.7, 1))
    seen = paths(single(2, 0), single(2, 1), single(2, 0), anchor=[0, 0, 1])
    return AudibleSurfaces.of(truth_of(segments, seen))


def test_wall_that_two_anchors_each_have_a_line_for_is_no_ghost(two_anchors):
    first, second = two_anchors.feature
    found = [first, second, first]
    assert two_anchors.ospa(lines_at(found)) == pytest.approx(5 / 3)  # as surfaces for all: one too many
    assert two_anchors.ospa(lines_at(found, [0, 0, 1])) == pytest.approx(0, abs=1e-9)
    assert two_anchors.ospa(lines_at(found, [0, 0, 0])) == pytest.approx((5 / 3 + 5) / 2)
    assert two_anchors.ospa(lines_at([*found, second], [0, 0, 1, 1])) == pytest.approx((0 + 2.5) / 2)
    shifted = [first, second, first + np.array([0.6, 0.8])]
    assert two_anchors.ospa(lines_at(shifted, [0, 0, 1])) == pytest.approx(0.5)
    assert two_anchors.ospa(lines_at([first, second], [0, 0]), step=1) == pytest.approx(0, abs=1e-9)
    assert two_anchors.ospa(lines_at(found, [0, 0, 2]), step=1) == pytest.approx(2.5)  # hears nothing at all


@given(found=st.lists(st.tuples(*[st.integers(-80, 80)] * 2), max_size=5))
@settings(max_examples=40, deadline=None)
def test_straight_surfaces_that_serve_all_score_the_plain_ospa(two_anchors, found):
    found = lines_at(np.array(found, float) / 8 + 1 / 16)
    expected = ospa(found.sfv_m, two_anchors.feature)
    assert two_anchors.ospa(found) == pytest.approx(expected, abs=1e-9)
    both = replace(two_anchors, since=np.zeros_like(two_anchors.since))
    twice = SurfaceEstimate.stack([replace(found, owner=np.full(len(found), anchor)) for anchor in (0, 1)])
    assert both.ospa(twice) == pytest.approx(expected, abs=1e-9)


@pytest.mark.slow
def test_surfaces_that_an_earlier_agent_heard_are_there_from_the_start():
    scene = gs.Scene.load("hall")
    truth = gs.ground_truth(scene, "agent1")
    alone = AudibleSurfaces.of(truth)
    later = Truth(truth.trajectory, truth.paths.at(0), truth.segments)
    both = AudibleSurfaces.of(later, [truth])
    assert len(AudibleSurfaces.of(later).feature) < len(both.feature) == len(alone.feature)
    np.testing.assert_array_equal(alone.feature, both.feature)
    assert (both.first == 0).all()
    assert alone.first.max() > 0
    joined = later.joined([truth])
    assert surface_scores(lines_at(alone.feature), joined)["surface_ospa_m"] == pytest.approx(0, abs=1e-9)


def test_each_true_point_gets_one_estimate_or_none_within_the_cutoff():
    truth = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 20.0]])
    found = np.array([[10.0, 1.0], [0.5, 0.0], [0.0, 26.0], [0.1, 0.0]])
    np.testing.assert_allclose(assigned_error(found, truth), [0.1, 1.0, np.nan])
    np.testing.assert_allclose(assigned_error(found[:0], truth), [np.nan] * 3)
    np.testing.assert_allclose(assigned_error(found[:1], truth), [np.nan, 1.0, np.nan])


@pytest.mark.slow
@pytest.mark.parametrize(("method", "owners"), [("va", {0, 1}), ("adaptive", {-1})])
def test_virtual_anchors_name_the_anchor_that_they_serve(method, owners):
    scene = gs.Scene.from_toml(TINY, "tiny")
    run = gs.map_scene(scene, gs.simulate(scene, "agent1"), method=method)
    assert set(run.estimates[-1].surfaces.owner.tolist()) == owners
