"""Clocks that nobody set, and measurements of which nobody told the anchor."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_worlds import random_belief

import gridslam as gs
from gridslam import reference
from gridslam.inference.beliefs.belief import Belief, append
from gridslam.inference.beliefs.layout import StateLayout
from gridslam.inference.messages.association import associate
from gridslam.inference.messages.birth_proposals import propose_births
from gridslam.inference.messages.births import add_births
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.path_prediction import EVERY_ANCHOR, predict_paths
from gridslam.inference.messages.reflection import PRODUCTS, Reflected
from gridslam.inference.messages.updates import update_surfaces_and_agent
from gridslam.inference.scans.anchor_measurements import of_all_anchors, split_by_anchor
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.geometry import trace, wrap

ANCHORS = np.array([[-4.0, -3.0, 0.4, 1.2], [5.0, -2.0, 2.5, 0.0]])
WALLS = np.array([[0.1, 6.0], [1.6, 4.0]])
POSE, LATE = np.array([0.5, -0.7, 0.0, 0.0, 0.3]), np.array([12.0, -9.0])
AT_1M = gs.Scene.load("room").filter_model().radio.amplitude_at_1m


def world(clocks=True, late=LATE):
    """A state that knows two walls, and the clocks of two anchors badly, and what a filter may know."""
    model = model_of("room", ANCHORS, births=0.1)
    radio = replace(model.radio, anchor_aperture=np.tile(model.radio.anchor_aperture[:1], (2, 1)))
    belief = Belief(POSE, np.diag(np.square([0.03, 0.03, 0.01, 0.01, 0.01])))
    if clocks:
        spread = np.diag(np.append(np.diag(belief.covariance), [1.0, 1.0]))
        belief = Belief(np.append(POSE, late), spread, clocks=2)
    for wall in WALLS:
        belief = append(belief, wall, np.diag([1e-5, 1e-4]))
    return state_of(belief, anchors=2, existence=0.95), replace(model, radio=radio)


def scan_of(rows, late, label):
    """A scan of paths (anchor, lines by number), and of their lengths by these clocks."""
    lines, value, strength = np.concatenate([WALLS, [[-2.0, 5.0]]]), [], []
    for anchor, *hits in rows:
        last, first = (lines[[hits[n]]] if hits else lines[[0]] for n in (-1, 0))
        bounces = np.array([len(hits)])
        path = trace(POSE[None, :2], ANCHORS[[anchor], :2], last, first, bounces, ANCHORS[anchor, 3])
        departure, arrival = path.departure[0] - ANCHORS[anchor, 2], path.arrival[0] - POSE[4]
        value.append([path.distance[0] + late[anchor], wrap(departure), wrap(arrival)])
        strength.append(AT_1M * 0.6 ** len(hits) / path.distance[0])
    distance, aod, aoa = np.array(value).T
    return gs.Scan(0, 0.0, np.asarray(label), distance, aod, aoa, np.array(strength))


def taken_in(state, model, scan, anchor=EVERY_ANCHOR):
    """State, ratios, births and exchange after a scan."""
    work = Workspace(model, seed=1)
    measured = of_all_anchors(scan) if anchor == EVERY_ANCHOR else split_by_anchor(scan, model)[anchor]
    paths = predict_paths(state, anchor, model, work=work)
    probability = np.full((len(paths), len(PRODUCTS)), 1 / len(PRODUCTS))
    amplitudes, open_ = Reflected(probability, model.radio), np.ones(len(paths))
    cloud, ratios = evaluate(measured, paths, open_, amplitudes, model.radio, model, work=work)
    births, ratios = propose_births(state, measured, cloud, ratios, model.radio, model, work=work)
    after, exchange = update_surfaces_and_agent(state, measured, paths, ratios, np.zeros(2), model, work=work)
    after, exchange, born = add_births(after, births, measured, exchange, model.radio, model, work=work)
    return after, ratios, births, exchange, born


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.booleans())
@settings(max_examples=20, deadline=None)
def test_slopes_are_differences_of_the_prediction_for_clocks_and_rises_too(seed, surfaces, rises):
    draw = np.random.default_rng(seed)
    mean, covariance, path = random_belief(draw, surfaces, 2, rises)
    path[:, 3] = draw.integers(0, 2, len(path))
    places = np.column_stack([ANCHORS, ANCHORS[:, 3], [0.0, 1.0] if rises else [-1.0, -1.0]])
    value, slope, _ = reference.predict(mean, covariance, 7, path, places)
    far = value[:, 0] - reference.late(mean, 7, path[:, 3], places) > 0.5
    for entry in range(len(mean)):
        step = 1e-6 * (np.arange(len(mean)) == entry)
        more, less = (reference.predict(mean + s, covariance, 7, path, places)[0] for s in (step, -step))
        change = more - less
        change[:, 1:] = wrap(change[:, 1:])
        np.testing.assert_allclose(slope[far, :, entry], change[far] / 2e-6, atol=1e-5)
    own = path[:, 3] == 0
    np.testing.assert_array_equal(slope[own][:, :, 6], 0.0)
    if rises:
        return
    np.testing.assert_array_equal(slope[own][:, :, 5], np.tile([1.0, 0.0, 0.0], (own.sum(), 1)))


ROWS = [(0,), (1,), (0, 0), (1, 1), (1, 2)]


def test_clocks_that_are_off_are_found_and_by_all_paths():
    state, model = world(late=LATE + np.array([0.8, -0.6]))
    after, _, _, exchange, _ = taken_in(state, model, scan_of(ROWS[:4], LATE, [-1] * 4))
    layout = after.belief.layout
    np.testing.assert_allclose(after.belief.mean[layout.anchor_clocks], LATE, atol=0.1)
    spread = np.sqrt(np.diag(after.belief.covariance)[layout.anchor_clocks])
    assert (spread < 0.1).all()
    np.testing.assert_allclose(after.belief.mean[:2], POSE[:2], atol=0.05)
    sent = exchange.rays.anchor[exchange.responsible.argmax(0)]
    assert sent.tolist() == [0, 1, 0, 1]


def test_a_constant_on_a_clock_and_its_distances_changes_nothing_else():
    shift = np.array([17.0, -40.0])  # distances are negative then
    found = []
    for late in (LATE, LATE + shift):
        state, model = world(late=late)
        found.append(taken_in(state, model, scan_of(ROWS, late, [-1] * 5)))
    (one, ratios, births, _, born), (other, more, others, _, again) = found
    np.testing.assert_allclose(more.beta, ratios.beta, rtol=2e-3, atol=1e-6)
    np.testing.assert_allclose(others.ratio, births.ratio, rtol=2e-3)
    np.testing.assert_allclose(others.line, births.line, atol=1e-9)
    assert again == born
    assert len(born) > 0
    change = other.belief.mean - one.belief.mean
    np.testing.assert_allclose(change[one.belief.layout.anchor_clocks], shift, atol=1e-4)
    change[one.belief.layout.anchor_clocks] = 0.0
    np.testing.assert_allclose(change, 0.0, atol=1e-4)
    np.testing.assert_allclose(other.belief.covariance, one.belief.covariance, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(other.surfaces.existence, one.surfaces.existence, atol=1e-4)


@pytest.mark.parametrize("clocks", [False, True])
def test_known_labels_make_one_association_of_all_that_of_each_anchor(clocks):
    state, model = world(clocks)
    scan = scan_of(ROWS, LATE if clocks else np.zeros(2), [row[0] for row in ROWS])
    _, ratios, births, exchange, _ = taken_in(state, model, scan)
    for anchor in range(2):
        _, own, mine, apart, _ = taken_in(state, model, scan, anchor)
        rows, columns = np.flatnonzero(exchange.rays.anchor == anchor), np.flatnonzero(scan.anchor == anchor)
        block = np.ix_(rows, columns)
        np.testing.assert_array_equal(ratios.beta[block], own.beta)
        assert not np.delete(ratios.beta[rows], columns, 1).any()
        np.testing.assert_array_equal(ratios.missed[rows], own.missed)
        np.testing.assert_array_equal(ratios.new[columns], own.new)
        theirs = births.anchor == anchor
        np.testing.assert_array_equal(births.measurement[theirs], columns[mine.measurement])
        np.testing.assert_array_equal(births.ratio[theirs], mine.ratio)
        nu, claimed = associate(own.beta, own.missed, own.new)
        whole, claims = associate(ratios.beta, ratios.missed, ratios.new)
        np.testing.assert_allclose(whole[block], nu, rtol=1e-5)
        np.testing.assert_allclose(claims[columns], claimed, rtol=1e-5, atol=1e-9)
        fit = exchange.fit[anchor]
        assert fit[5] == apart.fit[0, 5] > 0, "loud measurements count for the anchor that sent them"


def test_a_new_wall_is_thought_of_for_every_anchor_and_the_right_one_is_likeliest():
    state, model = world()
    scan = scan_of([(1, 2)], LATE, [-1])
    _, ratios, births, _, born = taken_in(state, model, scan)
    assert ratios.new[0] == pytest.approx(1 + births.ratio.sum())
    assert born[0][0][0] == births.anchor[births.ratio.argmax()] == 1
    few = np.array([0], np.int32)
    work = Workspace(model, seed=1)
    measured, paths = of_all_anchors(scan), predict_paths(state, EVERY_ANCHOR, model, work=work)
    amplitudes = Reflected(np.full((len(paths), len(PRODUCTS)), 1 / len(PRODUCTS)), model.radio)
    cloud, again = evaluate(measured, paths, np.ones(len(paths)), amplitudes, model.radio, model, work=work)
    fewer, _ = propose_births(state, measured, cloud, again, model.radio, model, few, work=work)
    assert (fewer.anchor == 0).all()


def test_a_new_line_shares_the_error_of_the_clock_that_made_it():
    state, model = world()
    after, _, _, _, born = taken_in(state, model, scan_of([(1, 2)], LATE, [1]))
    assert len(born) == 1
    layout, covariance = after.belief.layout, after.belief.covariance
    clock, offset = layout.anchor_clocks.start + 1, layout.line(2)[1]
    share = covariance[clock, offset] / np.sqrt(covariance[clock, clock] * covariance[offset, offset])
    assert abs(share) > 0.7
    assert abs(covariance[clock - 1, offset]) < 1e-9, "the other anchor's clock has no part in it"


def test_a_layout_knows_its_places_and_refuses_sizes_that_fit_none():
    layout = StateLayout(agents=2, clocks=3, surfaces=2, own_clocks=True)
    assert layout.size == 2 * 6 + 3 + 2 * 2
    assert (layout.pose(1), layout.agent_clock(1)) == (slice(6, 11), 11)
    assert (layout.anchor_clocks, layout.lines) == (slice(12, 15), slice(15, 19))
    assert layout.line([1, 0]).tolist() == [[17, 18], [15, 16]]
    assert layout.owner.tolist() == [0] * 15 + [1, 1, 2, 2]
    for size, clocks in ((4, 0), (6, 0), (7, 1), (5, 1)):
        with pytest.raises(ValueError, match="no state"):
            StateLayout.of_view(size, clocks)
    with pytest.raises(ValueError, match="no clocks"):
        StateLayout().agent_clock(0)
