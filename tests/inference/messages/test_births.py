"""Which births are followed, and where their lines come to lie."""

import numpy as np
import pytest
from filter_states import model_of, state_of
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from kernel_worlds import UNKNOWN, random_belief, random_places, random_radio, random_table

import gridslam as gs
from gridslam import reference, runtime
from gridslam.inference.beliefs.belief import Belief, append
from gridslam.inference.messages.births import (
    RIVALS,
    RIVALS_UNLABELLED,
    Births,
    add_chosen,
    initialise_surface,
)
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.world.geometry import trace, wrap

SIGNAL = gs.Scene.load("alcove").signal_model("agent1")
PLACE, AGENT, HEADING = np.array([-0.7, 4.2]), np.array([4.25, -3.2]), np.pi
NOBODY = np.full((1, 2), -1, np.int32)
KNOWN, NEW = np.array([np.pi, 3.0]), np.array([0.5 * np.pi, 5.0])  # x = -3, y = 5
WIDE_WALL = np.array([1.2, 40.0])


def hypotheses(measurement, ratio):
    count = len(ratio)
    none = np.full((count, 2), -1, np.int32)
    anchor = np.zeros(count, np.int32)
    return Births(np.asarray(measurement), none, np.zeros((count, 2)), np.asarray(ratio, float), anchor)


def test_a_fair_rival_is_followed_and_a_poor_one_is_not():
    births = hypotheses([0, 0, 0, 1, 1, 2], [8.0, 1.0, 10.0, 0.1, 30.0, 1e-4])
    chosen = births.chosen(np.zeros(3), 0.05)
    assert [one for one, _ in chosen] == [4, 2, 0]
    assert [chance for _, chance in chosen] == pytest.approx([30 / 31.1, 10 / 20, 8 / 20])


def test_without_a_label_all_fair_rivals_are_followed():
    """Of one measurement, either order of two bounces of one anchor, and another anchor's."""
    births = hypotheses([0, 0, 0, 0], [2.5, 2.5, 1.9, 0.4])
    assert [one for one, _ in births.chosen(np.zeros(1), 0.05)] == [0, 1]
    assert [one for one, _ in births.chosen(np.zeros(1), 0.05, RIVALS_UNLABELLED)] == [0, 1, 2]
    belief = Belief(np.array([*AGENT, 0, 0, HEADING]), np.diag(np.square([0.05, 0.05, 0.05, 0.05, 0.03])))
    model = model_of("alcove", [[*PLACE, 0.0]])
    path = trace(AGENT[None], PLACE[None], NEW[None], NEW[None], np.array([1]))
    value = np.array([[path.distance[0], wrap(path.departure[0]), wrap(path.arrival[0] - HEADING)]])
    for anchor, followed in ((0, 2), (-1, 3)):
        scan = AnchorScan.of(anchor, PLACE, 0.0, value, np.full((1, 3), np.nan), np.array([4.0]))
        found = add_chosen(state_of(belief), births, scan, np.zeros(1), SIGNAL, model)[0]
        assert len(found.surfaces) == followed


@given(st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=8), st.floats(0, 1e3))
@settings(max_examples=60, deadline=None)
def test_chances_of_rivals_stay_a_distribution(ratio, claimed):
    births = hypotheses(np.zeros(len(ratio), int), ratio)
    chosen = births.chosen(np.array([claimed]), 0.0)
    assert 1 <= len(chosen) <= 1 + RIVALS
    assert 0 < sum(chance for _, chance in chosen) < 1
    assert births.ratio[chosen[0][0]] == max(ratio)


def beside_the_sight(departs_deg, arrives_deg):
    """A birth of a wall 0.7 m beside a line of sight of 10 m, whose angles were measured so much off."""
    place, agent, wall = np.array([11.5, 4.5]), np.array([1.55, 4.44]), np.array([[0.5 * np.pi, 5.2]])
    path = trace(agent[None], place[None], wall, wall, np.array([1]))
    value = np.array([path.distance[0], wrap(path.departure[0]), wrap(path.arrival[0])])
    value += [0, np.radians(departs_deg), np.radians(arrives_deg)]
    scan = AnchorScan.of(0, place, 0.0, value[None], np.full((1, 3), np.nan), np.array([2.5]))
    belief = Belief(np.array([*agent, 0, 0, 0.0]), np.diag(np.square([0.05, 0.05, 0.05, 0.05, 0.03])))
    model = model_of("alcove", [[*place, 0.0]])
    births = Births(np.zeros(1, int), NOBODY, wall, np.ones(1), np.zeros(1, np.int32))
    found = add_chosen(state_of(belief), births, scan, np.zeros(1), SIGNAL, model)[0]
    return found.belief.lines, initialise_surface(births, 0, scan, belief, SIGNAL, model)


def test_a_line_that_bends_too_much_to_be_linearised_is_put_off():
    lines, (belief, _, misfit) = beside_the_sight(3.0, -2.0)
    assert misfit < 2
    np.testing.assert_array_equal(lines, belief.lines)
    assert abs(lines[0, 1] - 5.2 + 11.5 * np.cos(lines[0, 0])) < 1.5
    for angles in ((-32.0, 6.0), (-23.0, 10.0), (39.0, 15.0)):
        lines, (belief, _, misfit) = beside_the_sight(*angles)
        assert abs(belief.lines[0, 1]) > 15, "tens of metres from where it was heard"
        assert misfit > 100
        assert not len(lines)


def born(off_deg, double, new=NEW):
    """Belief after a birth whose AoA was measured so many degrees off, and the measured length."""
    last, first = (KNOWN, new) if double else (new, new)
    path = trace(AGENT[None], PLACE[None], last[None], first[None], np.array([2 if double else 1]))
    value = np.array(
        [[path.distance[0], wrap(path.departure[0]), wrap(path.arrival[0] - HEADING + np.radians(off_deg))]]
    )
    scan = AnchorScan.of(0, PLACE, 0.0, value, np.full((1, 3), np.nan), np.array([4.0]))
    spread = np.diag(np.square([0.02, 0.02, 0.05, 0.05, np.radians(0.5)]))
    belief = append(Belief(np.array([*AGENT, 0, 0, HEADING]), spread), KNOWN, np.diag([1e-6, 1e-6]))
    hit = np.array([[0 if double else -1, -1]], np.int32)
    births = Births(np.zeros(1, int), hit, new[None], np.ones(1), np.zeros(1, np.int32))
    model = model_of("alcove", [[*PLACE, 0.0]])
    return initialise_surface(births, 0, scan, belief, SIGNAL, model)[0], value[0, 0]


def length(belief, double):
    lines = belief.lines
    last = lines[[0]] if double else lines[[1]]
    return trace(belief.mean[None, :2], PLACE[None], last, lines[[1]], np.array([1 + double])).distance[0]


@pytest.mark.parametrize("double", [True, False])
@pytest.mark.parametrize("off_deg", [-15.0, -5.0, 0.0, 5.0, 15.0])
def test_a_new_line_has_the_measured_length_however_wrong_the_angle(off_deg, double):
    belief, measured = born(off_deg, double)
    assert length(belief, double) == pytest.approx(measured, abs=0.01)
    # AoA and AoD, 4.6 degrees each, meet where both are right: chi-square of two, and the AoA's own error
    gap = np.array([wrap(belief.lines[1, 0] - NEW[0]), belief.lines[1, 1] - NEW[1]])
    assert gap @ np.linalg.solve(belief.covariance[-2:, -2:], gap) < 14


@pytest.mark.parametrize("double", [True, False])
def test_a_new_line_is_consistent_with_its_covariance(double):
    gaps = []
    for off_deg in np.degrees(
        SIGNAL.angle_std(np.array(4.0), np.array(0.7), SIGNAL.agent_aperture)
    ) * np.array([-1.28, -0.84, -0.52, -0.25, 0.0, 0.25, 0.52, 0.84, 1.28]):
        belief, _ = born(off_deg, double)
        gap = np.array([wrap(belief.lines[1, 0] - NEW[0]), belief.lines[1, 1] - NEW[1]])
        gaps.append(gap @ np.linalg.solve(belief.covariance[-2:, -2:], gap))
    # the AoD is exact here, so the error is less than the covariance says; it must not be more
    assert np.mean(gaps) < 2


@pytest.mark.parametrize("departs", [True, False])
def test_a_new_line_far_away_claims_no_more_than_an_arc_tells(departs):
    """Lengths are measured to 2 mm and angles to 2 degrees, 90 m from the anchor's image, (M577).

    Along the tangent alone, squared errors are 11 and 8 times as large as claimed, where 2 is right.
    """
    draw, place, agent, wall = np.random.default_rng(5), np.zeros(2), np.array([60.0, 0.0]), WIDE_WALL
    path = trace(agent[None], place[None], wall[None], wall[None], np.array([1]))
    spread = np.diag(np.square([1e-3, 1e-3, 0.05, 0.05, 1e-3]))
    belief = Belief(np.array([*agent, 0, 0, 0.0]), spread)
    std = np.array([[0.002, np.radians(2.0), np.radians(2.0)]])
    births = Births(np.zeros(1, int), NOBODY, wall[None], np.ones(1), np.zeros(1, np.int32))
    model, squared = model_of("alcove", [[*place, 0.0]]), []
    for noise in draw.standard_normal((300, 3)):
        value = np.array([[path.distance[0], wrap(path.departure[0]), wrap(path.arrival[0])]]) + noise * std
        if not departs:
            value[0, 1], std[0, 1] = np.nan, np.nan
        scan = AnchorScan.of(0, place, 0.0, value, std, np.array([4.0]))
        found, _, _ = initialise_surface(births, 0, scan, belief, SIGNAL, model)
        gap = np.array([wrap(found.lines[0, 0] - wall[0]), found.lines[0, 1] - wall[1]])
        squared.append(gap @ np.linalg.solve(found.covariance[-2:, -2:], gap))
    assert 1 < np.mean(squared) < 3
    known, radio = belief.layout.head, SIGNAL.numbers
    twin = reference.initialise_surface(
        belief.mean, belief.covariance, known, 0, model.places, scan.table, 0, -1, -1, radio
    )
    np.testing.assert_allclose(found.mean, twin[0], atol=1e-5)
    np.testing.assert_allclose(found.covariance, twin[1], rtol=1e-3, atol=1e-8)


def test_the_normal_of_a_new_line_is_wrapped():
    """Of a wall close behind its anchor: derivatives turn the normal by full turns."""
    close = np.array([np.pi, 0.8])  # 10 cm behind the anchor
    for off_deg in (-15.0, -5.0, -2.0, 2.0, 5.0, 15.0):
        line = born(off_deg, False, close)[0].lines[1]
        assert -np.pi < line[0] <= np.pi
        if abs(off_deg) < 5:
            np.testing.assert_allclose([wrap(line[0] - np.pi), line[1]], [0, 0.8], atol=0.02)
    assert born(-2.0, False, close)[0].lines[1, 0] > 0 > born(2.0, False, close)[0].lines[1, 0]


def worth_a_birth(draw, surfaces, clocks, rises):
    """A belief, and a measurement of the path over a new line, maybe with one of its surfaces."""
    mean, covariance, _ = random_belief(draw, surfaces, clocks, rises)
    covariance *= draw.choice([1e-4, 0.01, 1.0])
    places = random_places(draw, 2, rises)
    ends = [(-1, -1), *(pair for s in range(surfaces) for pair in ((s, -1), (-1, s)))]
    last, first = ends[draw.integers(len(ends))]
    line = np.array([draw.uniform(-np.pi, np.pi), draw.choice([-1, 1]) * draw.uniform(1, 6)])
    lines = np.concatenate([mean[5 + clocks :].reshape(-1, 2), line[None]])
    bounces = np.array([1 if last == first else 2])
    height = reference.tall(mean, 5 + clocks, 1, places)
    path = trace(mean[None, :2], places[1:, :2], lines[[last]], lines[[first]], bounces, height)
    value = np.array([path.distance[0], path.departure[0] - places[1, 2], path.arrival[0] - mean[4]])
    table = random_table(draw, 3)
    table[1, :3] = value + draw.normal(0, [0.02, 0.1, 0.2])
    table[1, 0] += reference.late(mean, 5 + clocks, 1, places)
    table[1, 1:3] = wrap(table[1, 1:3])
    table[1, 3:6] = draw.choice([0.0, 0.05], 3)
    table[1, 4:6] = [(-1.0, 0.0), (0.0, 0.0), (0.05, 0.05), (0.0, -1.0), (0.05, -1.0)][draw.integers(5)]
    radio = random_radio(draw)
    if table[1, 5] >= 0:
        radio[:, 2:4] *= draw.choice([0.0, 1.0], p=[0.2, 0.8])  # an array without extent tells no AoD
    return mean, covariance, 5 + clocks, 1, places, table, 1, last, first, radio


def nudged(into):
    """The same with a measured distance that is a millimetre longer."""
    table = into[5].copy()
    table[into[6], 0] += 1e-3
    return *into[:5], table, *into[6:]


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(0, 3), UNKNOWN)
@settings(max_examples=200, deadline=None)
def test_a_new_surface_joins_the_belief_as_in_its_twin(seed, surfaces, unknown):
    runtime.start()
    from gridslam.kernels.management.initialisation import initialise_surface as launch

    draw = np.random.default_rng(seed)
    into = worth_a_birth(draw, surfaces, *unknown)
    size = len(into[0]) + 2
    mean, covariance, reflection = np.full(size, np.nan), np.full((size, size), np.nan), np.full(20, np.nan)
    names = "mean", "covariance", "head", "anchor", "places", "scan", "m", "last", "first", "radio"
    out = {"spread": np.full(size, np.nan), "fresh": mean, "joint": covariance, "coefficient": reflection}
    out["missed"] = misfit = np.full(1, np.nan)
    launch.named(**dict(zip(names, into, strict=True)), **out)
    wanted = reference.initialise_surface(*into)
    # an image next to its anchor makes no line: none that differences tell, and it is moved round and round
    assume(abs(wanted[0][-2]) < 5)
    assume(np.abs(wanted[0][-2:] - reference.initialise_surface(*nudged(into))[0][-2:]).max() < 0.02)
    scale = np.sqrt(np.diag(wanted[1]))
    assert (np.abs(mean - wanted[0]) < 0.01 * scale + 1e-5).all()  # directions are worked out to 1e-6 rad
    np.testing.assert_allclose(
        covariance / np.outer(scale, scale), wanted[1] / np.outer(scale, scale), atol=0.01
    )
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-13, atol=1e-15)  # processors round apart
    np.testing.assert_allclose(reflection, wanted[2], rtol=1e-5, atol=1e-9)
    assert misfit[0] == pytest.approx(wanted[3], rel=0.02, abs=0.02)


def test_a_birth_of_what_is_not_there_is_refused():
    scan = AnchorScan.of(0, PLACE, 0.0, np.ones((1, 3)), np.full((1, 3), np.nan), np.array([4.0]))
    belief, anchors = Belief(np.zeros(5), np.eye(5)), np.array([[*PLACE, 0.0]])
    row, line, ratio = np.zeros(1, int), NEW[None], np.ones(1)
    for births, places in (
        (Births(row, np.array([[0, -1]]), line, ratio, row), anchors),
        (Births(row + 1, np.array([[-1, -1]]), line, ratio, row), anchors),
        (Births(row, np.array([[-1, -1]]), line, ratio, row), anchors[:0]),
    ):
        with pytest.raises(ValueError, match="doesn't exist"):
            initialise_surface(births, 0, scan, belief, SIGNAL, model_of("alcove", places))
