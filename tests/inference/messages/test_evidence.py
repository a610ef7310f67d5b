"""The log evidence of a step, against enumeration, exact Gaussians and sums over all that could be heard."""

import itertools
from dataclasses import dataclass, replace
from math import factorial

import numpy as np
import pytest
from enumeration import every_matching, random_association
from filter_states import model_of, state_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import shortened
from scipy.stats import multivariate_normal, norm

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.association import associate, log_normaliser
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.path_prediction import predict_paths
from gridslam.inference.messages.updates import update_surfaces_and_agent
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives import tables
from gridslam.systems import grid
from gridslam.systems.grid import GridSlam


def settled(beta, missed, new):
    """The evidence that an association comes to, of paths that share nothing."""
    nu, _ = associate(beta, missed, new)
    return log_normaliser(beta, missed, new, nu, missed + (beta * nu).sum(1))


def sums(beta, missed, new):
    """Normaliser by enumeration of all matchings."""
    total = 0.0
    for matching in every_matching(*beta.shape):
        worth = 1.0
        for path, m in enumerate(matching):
            worth *= missed[path] if m is None else beta[path, m]
        total += worth * np.prod([new[m] for m in range(len(new)) if m not in matching])
    return np.log(total)


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(0, 4))
@settings(max_examples=60, deadline=None)
def test_the_evidence_is_that_of_enumeration_on_a_tree_and_close_to_it_otherwise(seed, paths, count):
    draw = np.random.default_rng(seed)
    beta, missed, new = random_association(draw, paths, count, 0.6)
    nu, _ = associate(beta, missed, new)
    found = log_normaliser(beta, missed, new, nu, missed + (beta * nu).sum(1))
    wanted = sums(beta, missed, new)
    tree = paths <= 1 or count <= 1
    assert found == pytest.approx(wanted, abs=1e-5 if tree else 0.4)
    assert found < wanted + 1e-5, "Bethe's is never above"


def test_evidence_over_all_scans_of_a_tiny_sensor_sums_to_one():
    """Four cells, clutter in all of them, a path into either pair: by (M48) a density over scans.

    Births are left open by a factor, exp of their mean number, that all hypotheses share.
    """
    clutter, births = np.array([0.02, 0.01, 0.016, 0.004]), np.array([0.002, 0.0, 0.004, 0.006])
    there, detected = np.array([0.9, 0.6]), np.array([[0.5, 0.3, 0.0, 0.0], [0.0, 0.0, 0.2, 0.7]])
    missed, total = 1 - there * detected.sum(1), 0.0
    for count in range(6):
        for cells in itertools.product(range(4), repeat=count):
            cells = np.array(cells, np.intp)
            beta = there[:, None] * detected[:, cells] / clutter[cells]
            chance = np.exp(-clutter.sum()) * np.prod(clutter[cells]) / factorial(count)
            total += chance * np.exp(settled(beta, missed, 1 + births[cells] / clutter[cells]))
    assert total == pytest.approx(np.exp(births.sum()), abs=2e-5)  # less than 2e-5 lies beyond five


@dataclass(frozen=True)
class Steady:
    """An amplitude that is known."""

    probability: np.ndarray
    nodes: np.ndarray
    spreading: bool = False


def evaluated(state, scan, model, amplitude):
    """An anchor's measurements against all paths of a state, each of a known amplitude."""
    work = Workspace(model, seed=1)
    paths = predict_paths(state, 0, model, work=work)
    strength = Steady(np.ones((len(paths), 1)), np.array([amplitude]))
    _, ratios = evaluate(scan, paths, np.ones(len(paths)), strength, model.radio, model, work=work)
    ratios.new[:] = 1.0
    return work, paths, ratios


@pytest.mark.slow
def test_a_paths_ratios_integrate_to_its_chance_of_being_detected():
    """Over all of distance, angles and amplitude, weighed by clutter's intensity: what "none" lacks."""
    model = model_of(anchors=[[0.0, 0.0, 0.0]], max_bounces=0)
    model = replace(model, radio=replace(model.radio, false_alarms=3.7), max_bounces=0)
    radio, amplitude = model.radio, 2.4
    here = np.array([2.0, 1.0, 0.0, 0.0, 0.3])
    state = state_of(Belief(here, np.diag([1e-9, 1e-9, 1e-4, 1e-4, 1e-9])))
    at = np.array([np.sqrt(5), np.arctan2(1, 2), np.arctan2(1, 2) + np.pi - 0.3])
    level = radio.threshold + 0.2 * (np.arange(30) + 0.5)
    own = np.array([0.02, 0.05, 0.05])
    offsets = np.array(list(itertools.product(np.arange(-5, 6) * 0.9, repeat=3)))
    value = np.repeat((at + own * offsets)[None], len(level), 0).reshape(-1, 3)
    loud = np.repeat(level, len(offsets))
    scan = AnchorScan.of(
        0, np.zeros(2), 0.0, value, np.tile(own, (len(value), 1)), loud, radio.threshold
    )  # fmt: skip
    _, _, ratios = evaluated(state, scan, model, amplitude)
    volume = 0.2 * np.prod(0.9 * own)
    floor = np.maximum(2 * loud * np.exp(-(loud**2 - radio.threshold**2)), np.exp(-25.0))
    clutter = 3.7 * floor / radio.max_distance_m / (2 * np.pi) ** 2
    found = (ratios.beta[0] * clutter).sum() * volume
    wanted = ratios.odds[tables.THERE, 0] * float(radio.detection_probability(amplitude))
    assert found == pytest.approx(wanted, rel=0.005)
    assert 1 - ratios.missed[0] == pytest.approx(wanted, rel=1e-3)


def test_evidence_of_a_certain_matching_is_that_of_all_measurements_stacked():
    """Distances along a line from an anchor, straight and over the walls before and behind: all linear.

    The belief is so wide that the paths' errors are one: each in turn must be judged where the ones before
    have led it.
    """
    model = model_of(anchors=[[0.0, 0.0, 0.0]])
    model = replace(model, max_bounces=1)
    mean = np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.0, 0.0, -6.0])
    draw = np.random.default_rng(5)
    covariance = np.diag([0.0, 1e-12, 1e-6, 1e-6, 1e-12, 1e-12, 0.0, 1e-12, 0.0])
    free = np.ix_([0, 6, 8], [0, 6, 8])
    root = draw.normal(size=(3, 3)) * 0.03 + 0.05
    covariance[free] = root @ root.T
    slope = np.array([[1.0, 0, 0], [-1.0, 2, 0], [1.0, 0, -2]])
    noise = np.full(3, 0.02**2)
    joint = slope @ covariance[free] @ slope.T + np.diag(noise)
    ideal = slope @ mean[[0, 6, 8]]
    distance = ideal + 0.3 * np.linalg.cholesky(joint) @ draw.normal(size=3)
    value = np.column_stack([distance, np.full((3, 2), np.nan)])
    own = np.column_stack([np.sqrt(noise), np.full((3, 2), np.nan)])
    scan = AnchorScan.of(0, np.zeros(2), 0.0, value, own, np.full(3, 30.0), model.radio.threshold)
    state = state_of(Belief(mean, covariance), existence=1 - 1e-7)
    work, paths, ratios = evaluated(state, scan, model, 30.0)
    assert len(paths) == 3
    assert np.count_nonzero(ratios.beta) == 3
    turned = np.zeros(1)
    after, exchange = update_surfaces_and_agent(state, scan, paths, ratios, turned, model, work=work)
    row, pair = ratios.pairs.index[:3, 0], ratios.pairs.pair[:3]
    there = exchange.odds[tables.THERE, row]
    # the angles weren't measured: the density makes up for what the kernel's three dimensions take off there
    density = pair[:, 6] / (2 * np.pi * np.sqrt(pair[:, 4] * pair[:, 5]))
    stacked = multivariate_normal(ideal, joint).logpdf(distance)
    apart = norm(ideal, np.sqrt(np.diagonal(joint))).logpdf(distance).sum()
    assert abs(apart - stacked) > 0.1, "paths that share nothing would come to something else"
    wanted = stacked + np.log(there * density).sum()
    assert exchange.log_evidence == pytest.approx(wanted, abs=5e-7)  # exponentials are single's
    gain = covariance[free] @ slope.T @ np.linalg.inv(joint)
    np.testing.assert_allclose(
        after.belief.mean[[0, 6, 8]], mean[[0, 6, 8]] + gain @ (distance - ideal), atol=1e-9
    )


@pytest.fixture(scope="module")
def scene():
    return shortened(gs.Scene.load("room"), 8).with_filter(particles=256)


@pytest.fixture(scope="module")
def scans(scene):
    return list(gs.simulate(scene, "agent1", seed=2))


def test_the_evidence_of_a_right_world_is_higher_than_that_of_a_wrong_one(scene, scans):
    """The same scans, by a filter that starts where the agent is and by one that is sure to be 1 m off."""
    total = []
    for off in (0.0, 1.0):
        slam, log = GridSlam(scene, seed=1), 0.0
        there = slam.model.start_mean + np.array([0.0, off, 0.0, 0.0, 0.0])
        sure = replace(slam.model, start_mean=there, start_variance=np.full(5, 1e-3))
        slam.now = slam.believing(grid.start(sure))
        for scan in scans[:3]:
            slam.step(scan)
            log += slam.info.log_evidence
        total.append(log)
    assert np.isfinite(total).all()
    assert total[0] > total[1] + 10


def of_rows(scan, rows):
    """Some of a scan's measurements."""
    names = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    return replace(scan, **{name: getattr(scan, name)[rows] for name in names})


def test_an_anchor_that_listens_and_hears_nothing_tells_against_its_paths(scene, scans):
    """The evidence of silence is that of all misses; nobody's own scan may be left out for being empty."""
    slam = GridSlam(scene, seed=1)
    for scan in scans[:5]:
        slam.step(scan)
    kept = slam.now
    for silent in ({0, 1}, {1}):
        slam.now = kept
        rows = np.array([a not in silent for a in scans[5].anchor])
        slam.step(of_rows(scans[5], rows))
        assert {exchange.anchor for exchange in slam.info.exchanges} == {0, 1}
        for exchange in slam.info.exchanges:
            if exchange.anchor in silent:
                missed = np.log(exchange.odds[tables.MISSED]).sum()
                assert exchange.log_evidence == pytest.approx(missed, abs=1e-9)
                assert missed < -5, "five paths that are heard at almost every step weren't"
            else:
                assert exchange.log_evidence > 30


def test_births_are_in_the_evidence(scene, scans):
    """Of a first scan, all but the line of sight is new: the evidence is what births are worth."""
    slam = GridSlam(scene, seed=1)
    slam.step(scans[0])
    first = slam.info.exchanges[0]
    new = first.measured[tables.NEW]
    assert (new > 100).sum() >= 2, "the walls' single bounces"
    beta, missed, nu = first.message[tables.BETA], first.odds[tables.MISSED], first.message[tables.NU]
    without = log_normaliser(beta, missed, np.ones_like(new), nu, missed + (beta * nu).sum(1))
    loudest = np.sort(np.log(new))[-2:].sum()
    assert first.log_evidence > without + 0.8 * loudest


def draw_scans(draw, places, detected, scans):
    """Distances heard from walls at `places`, with clutter over 20 m, scan by scan."""
    for _ in range(scans):
        seen = places[draw.random(len(places)) < detected]
        yield np.concatenate([draw.normal(seen, 0.05), draw.uniform(0, 20, draw.poisson(1.0))])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "rival"),
    [((4.0,), (4.0, 4.0)), ((4.0, 7.0), (4.0, 7.0, 9.0)), ((4.0, 7.0, 9.0), (4.0, 7.0))],
    ids=["one or the same twice", "two or three", "three or two"],
)
def test_evidence_chooses_the_true_number_of_walls(truth, rival):
    """In 95 of 100 draws of ten scans at least; walls are born at 1 in 10, so a third one costs something."""
    draw, won, draws, detected = np.random.default_rng(8), 0, 200, 0.9
    for _ in range(draws):
        lead = 0.0
        for scan in draw_scans(draw, np.array(truth), detected, 10):
            for places, sign in ((truth, 1), (rival, -1)):
                gap = (scan - np.array(places)[:, None]) / 0.05
                ratio = np.exp(-0.5 * gap**2) / (np.sqrt(2 * np.pi) * 0.05) * 20
                beta, missed = 0.98 * detected * ratio, np.full(len(places), 1 - 0.98 * detected)
                lead += sign * settled(beta, missed, np.full(len(scan), 1.1))
        won += lead > 0
    assert won >= 0.95 * draws
