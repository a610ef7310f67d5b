"""Adaptive SLAM and its reference: amplitude states of rays, and what the systems find on bundled scenes."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from filter_states import model_of
from hypothesis import given, settings
from hypothesis import strategies as st

import gridslam as gs
from gridslam.inference.messages.path_prediction import PredictedPaths, Prediction
from gridslam.inference.messages.ray_amplitudes import (
    forget_amplitudes,
    mean_amplitudes,
    predict_amplitudes,
    start_amplitudes,
    update_amplitudes,
)
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.ray_amplitudes import RayAmplitudes
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives.tables import PREDICTED, UNCLEAR
from gridslam.systems.registry import method_class
from gridslam.world.geometry import sfv

SIGNAL = gs.Scene.load("room").signal_model("agent1")
MODEL = model_of("room", radio=SIGNAL)
WORK = Workspace(MODEL, seed=1)
UNMEASURED = replace(State.start(MODEL), amplitudes=RayAmplitudes())


def one_ray(existence=0.9):
    return Rays.of(*(np.array([v]) for v in (0, 0, -1, -1, existence, 1.0)))


def anchor_scan(*amplitudes, distance=np.nan):
    count = len(amplitudes)
    unknown = np.full((count, 3), np.nan)
    value = unknown.copy()
    value[:, 0] = distance
    return AnchorScan.of(0, np.zeros(2), 0.0, value, unknown, np.array(amplitudes, float))


def one_path(existence, distance, std=0.0):
    predicted = np.full((1, PREDICTED), distance)
    predicted[:, UNCLEAR] = std**2
    return PredictedPaths(one_ray(existence), Prediction(predicted), None)


def ahead(state, existence, distance, std=0.0):
    """Amplitude belief of the one path, a step ahead."""
    return predict_amplitudes(state, one_path(existence, distance, std), anchor_scan(), SIGNAL, work=WORK)


def mean(state, distance):
    return mean_amplitudes(state, one_ray(), np.array([distance]), SIGNAL)


def away(distance):
    """A state that knows no amplitude, whose agent is so far from the anchor."""
    mean = UNMEASURED.belief.mean.copy()
    mean[:2] = MODEL.places[0, :2] + [distance, 0.0]
    return replace(UNMEASURED, belief=replace(UNMEASURED.belief, mean=mean))


def followed(amplitudes, existence=0.9, distance=3.0):
    """Amplitude belief after hearing one path strengths one after the other; None for a miss."""
    state, path = away(distance), one_path(existence, distance)
    for amplitude in amplitudes:
        own = anchor_scan() if amplitude is None else anchor_scan(amplitude)
        belief = predict_amplitudes(state, path, own, SIGNAL, work=WORK)
        ratios = SimpleNamespace(responsible=np.ones((1, len(own))))
        state = update_amplitudes(state, path, belief, own, ratios, MODEL, work=WORK)
    return state, ahead(state, existence, distance)


def test_where_no_amplitude_tells_anything_none_is_kept():
    blind = replace(SIGNAL, given_detection=0.8)
    path, silent, loud = one_path(0.9, 3.0), anchor_scan(np.nan, np.nan), anchor_scan(5.0, np.nan)
    belief = predict_amplitudes(UNMEASURED, path, silent, blind, work=WORK)
    assert belief.spreading
    assert belief.probability.tolist() == [[1.0]]
    assert belief.nodes / 3.0 == pytest.approx(mean(UNMEASURED, 3.0))
    ratios = SimpleNamespace(responsible=np.ones((1, 2)))
    assert (
        update_amplitudes(UNMEASURED, path, belief, silent, ratios, replace(MODEL, radio=blind), work=WORK)
        is UNMEASURED
    )
    for state, own, signal in (
        (UNMEASURED, loud, blind),  # it was measured all the same
        (UNMEASURED, silent, SIGNAL),  # a miss tells of it
        (followed([5.0])[0], silent, blind),  # or it was before
    ):
        assert not predict_amplitudes(state, path, own, signal, work=WORK).spreading


@pytest.mark.slow
@given(
    st.lists(st.one_of(st.none(), st.floats(2.1, 1000)), max_size=6),
    st.floats(0.01, 0.99),
    st.floats(0.5, 30),
)
@settings(max_examples=40, deadline=None)
def test_amplitude_beliefs_stay_distributions(amplitudes, existence, distance):
    _, belief = followed(amplitudes, existence, distance)
    assert (belief.probability >= 0).all()
    np.testing.assert_allclose(belief.probability.sum(1), 1, atol=1e-9)


def test_a_ray_that_was_given_up_and_is_heard_again_is_as_strong_as_it_is_heard():
    """It kept the amplitude of its silence, and what was heard next was taken for another wall's."""
    state, _ = followed([None] * 8, existence=0.2)
    assert ahead(state, 0.95, 3.0).probability[0] @ ahead(state, 0.95, 3.0).nodes < 4
    path, own = one_path(0.004, 3.0), anchor_scan(15.0)
    belief = predict_amplitudes(state, path, own, SIGNAL, work=WORK)
    once = SimpleNamespace(responsible=np.ones((1, 1)))
    back = update_amplitudes(state, path, belief, own, once, MODEL, work=WORK)
    again = ahead(back, 0.95, 3.0)
    assert abs(again.probability[0] @ again.nodes - 15.0) < 1.5
    missed = SimpleNamespace(responsible=np.zeros((1, 0)))
    silent = update_amplitudes(state, path, belief, anchor_scan(), missed, MODEL, work=WORK)
    assert silent.amplitudes is state.amplitudes


@pytest.mark.parametrize("true", [4.0, 9.0, 20.0])
def test_amplitude_converges_to_what_is_heard(true):
    draw = np.random.default_rng(1)
    scale = SIGNAL.amplitude_std(np.array(true))
    states, belief = followed(
        np.hypot(true + scale * draw.normal(size=40), scale * draw.normal(size=40)), 0.99, 1.0
    )
    level = mean(states, 1.0)[0]
    # a walk of 2 % a step against noise `scale`: some ten measurements count
    assert abs(level - true) < 4 * scale / np.sqrt(10)
    spread = np.sqrt(belief.probability[0] @ (belief.nodes - level) ** 2)
    assert spread < 2 * scale


@pytest.mark.parametrize("factor", [0.5, 0.9, 1.0, 1.7])
def test_amplitude_follows_the_length_of_the_path(factor):
    states, belief = followed([9.0] * 20, 0.99, 2.0)
    near = ahead(states, 0.99, 2.0 / factor)
    np.testing.assert_allclose(near.probability.sum(), 1, atol=1e-9)
    means = [b.probability[0] @ b.nodes for b in (belief, near)]
    assert means[1] / means[0] == pytest.approx(factor, rel=0.01)


def test_a_line_of_sight_is_as_loud_at_the_next_step_though_it_was_predicted_farther_away():
    own, path = anchor_scan(20.0), one_path(0.9, 4.0, 0.6)
    belief = predict_amplitudes(away(4.0), path, own, SIGNAL, work=WORK)
    once = SimpleNamespace(responsible=np.ones((1, 1)))
    corrected = away(2.5)
    state = update_amplitudes(corrected, path, belief, own, once, MODEL, work=WORK)
    after = ahead(state, 0.9, 2.5)
    assert after.probability[0] @ after.nodes == pytest.approx(20.0, rel=0.1)


def test_an_agent_at_an_anchor_is_loud_but_heard():
    loud = float(SIGNAL.amplitude(0.05))
    states, belief = followed([loud] * 3, 0.99, 0.05)
    assert belief.probability[0, -1] > 0.5
    assert np.isfinite(mean(states, 0.05)).all()


def test_silence_makes_a_ray_fainter_but_not_for_good():
    _, before = followed([6.0, 6.0, 6.0])
    _, after = followed([6.0, 6.0, 6.0] + [None] * 6)
    _, again = followed([6.0, 6.0, 6.0] + [None] * 6 + [6.0, 6.0])
    level = [b.probability[0] @ b.nodes for b in (before, after, again)]
    assert level[1] < 0.7 * level[0]
    assert level[2] > 0.7 * level[0]


@pytest.mark.parametrize(("std", "nearest"), [(0.0, 4.0), (0.5, 2.5)])
def test_a_reflection_that_appears_may_have_any_amplitude_of_free_space(std, nearest):
    """At the least length that it may have, three deviations below what is predicted."""
    bank = UNMEASURED.surfaces.add(8, 0.9, np.full(20, 0.05), 0.0, (0, -1, -1))
    path = replace(one_path(0.005, 4.0, std), rays=Rays.of(0, 1, 0, 0, np.array([0.005]), np.ones(1)))
    state = replace(UNMEASURED, surfaces=bank)
    belief = predict_amplitudes(state, path, anchor_scan(), SIGNAL, work=WORK)
    top = belief.nodes[belief.probability[0] > 0].max()
    assert top <= SIGNAL.amplitude(nearest)
    assert top > 0.9 * SIGNAL.amplitude(nearest)


def test_a_line_of_sight_that_appears_has_that_of_free_space():
    """(M557): to a decibel, but for one in fifty; and as much less surely as its length is."""
    told = replace(UNMEASURED.calibration, pull=1e4, weight=1e4)
    state = replace(UNMEASURED, calibration=told)
    belief = ahead(state, 0.005, 4.0)
    nodes, level = belief.nodes, float(SIGNAL.amplitude(4.0))
    assert belief.probability[0][np.abs(nodes / level - 1) < 0.4].sum() > 0.97
    assert 0.005 < belief.probability[0][nodes < 0.5 * level].sum() < 0.02
    loud = ahead(state, 0.005, 4.0, 2.0)
    assert loud.probability[0][nodes > 1.5 * level].sum() > 0.1


def test_how_loud_a_line_of_sight_is_hangs_on_what_others_have_told():
    """A scene may state twice the amplitude: nothing is told at first, (M557), then it is known."""
    level = float(SIGNAL.amplitude(4.0))
    halved = replace(UNMEASURED.calibration, pull=5e3, weight=1e4)
    (open_,) = ahead(UNMEASURED, 0.005, 4.0).probability
    belief = ahead(replace(UNMEASURED, calibration=halved), 0.005, 4.0)
    assert 0.03 < open_[belief.nodes < 0.5 * level].sum() < 0.15
    np.testing.assert_allclose(belief.probability[0] @ belief.nodes, 0.5 * level, rtol=0.03)


def test_over_a_floor_a_path_that_appears_is_no_line_of_sight():
    """An image of the anchor sends it, without a wall: how much the floor reflects isn't in (M557)."""
    radio = SIGNAL.imaged(np.array([1.0, 0.3]))
    table = Rays.of(np.array([0, radio.senders]), 0, -1, -1, np.full(2, 0.005), np.ones(2))
    predicted = np.full((2, PREDICTED), 4.0)
    predicted[:, UNCLEAR] = 0.0
    paths = PredictedPaths(table, Prediction(predicted), None)
    belief = predict_amplitudes(UNMEASURED, paths, anchor_scan(), radio, work=WORK)
    faint = belief.probability[:, belief.nodes < 0.5 * SIGNAL.amplitude(4.0)].sum(1)
    assert faint[0] < 0.15
    assert faint[1] > 0.45


def test_amplitudes_of_dropped_surfaces_are_forgotten():
    measured = anchor_scan(5.0, distance=3.0)
    one = replace(UNMEASURED.surfaces.add(8, 0.9, np.full(20, 0.05), 0.0, (0, -1, -1)))
    born = [((0, 7, 7), 0), ((0, 8, 7), 0), ((0, 8, 8), 0)]
    state = replace(start_amplitudes(UNMEASURED, born, measured, SIGNAL), surfaces=one)
    assert set(state.amplitudes.known) == {key for key, _ in born}
    kept = forget_amplitudes(state)
    assert set(kept.amplitudes.known) == {(0, 8, 8)}
    assert forget_amplitudes(kept).amplitudes is kept.amplitudes


def first_steps(method, name, steps, seed):
    scene = gs.Scene.load(name).with_filter(particles=2000)
    slam = method_class(method)(scene, seed=seed)
    return slam, [slam.step(scan) for scan in itertools.islice(gs.simulate(scene, "agent1", seed), steps)]


@pytest.mark.slow
def test_adaptive_slam_finds_the_floor_by_its_double_bounce_alone():
    floor = sfv(gs.Scene.load("alcove").segments().line)[2]
    found = 0
    for seed in (1, 2, 3):
        _, estimates = first_steps("adaptive", "alcove", 60, seed)
        known = estimates[-1].surfaces.take(estimates[-1].detected).sfv_m
        found += np.linalg.norm(known - floor, axis=1).min() < 0.5
    assert found >= 2


@pytest.mark.slow
def test_virtual_anchors_serve_their_own_anchor_by_single_bounces():
    slam, estimates = first_steps("va", "alcove", 25, 1)
    bank = slam.state.surfaces
    assert set(bank.owner.tolist()) <= {0, 1}
    for estimate in estimates:
        assert (estimate.paths.surfaces[:, 0] == estimate.paths.surfaces[:, 1]).all()
        owner = dict(
            zip(slam.state.surfaces.identity.tolist(), slam.state.surfaces.owner.tolist(), strict=True)
        )
        for anchor, surface in zip(estimate.paths.anchor, estimate.paths.surfaces[:, 0], strict=True):
            assert surface < 0 or owner.get(int(surface), anchor) == anchor


@pytest.mark.slow
@pytest.mark.parametrize("method", ["adaptive", "va"])
def test_a_run_repeats_bit_for_bit(method):
    one, two = (first_steps(method, "room", 6, 3)[1][-1] for _ in range(2))
    np.testing.assert_array_equal(one.covariance, two.covariance)
    np.testing.assert_array_equal(one.position_m, two.position_m)


@pytest.mark.slow
def test_separate_beliefs_are_a_setting():
    scene = gs.Scene.load("room").with_filter(particles=1000)
    anchor_scan = list(itertools.islice(gs.simulate(scene, "agent1", 1), 12))
    for correlated in (True, False):
        slam = gs.GridSlam(scene.with_filter(correlated=correlated), seed=1)
        for scan in anchor_scan:
            slam.step(scan)
        cross = slam.state.belief.covariance[:5, 5:]
        assert cross.size
        assert cross.any() == correlated
