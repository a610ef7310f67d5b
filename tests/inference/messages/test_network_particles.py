"""Messages of network SLAM as published against sums over all particles and all events."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import gridslam as gs
from gridslam.inference.messages.published.image_particles import path_values
from gridslam.inference.messages.published.network_particle_births import add_network_births, propose_network
from gridslam.inference.messages.published.network_particle_ratios import blurred, evaluate_network
from gridslam.inference.messages.published.network_particles import (
    associate_network,
    clock_messages,
    move_network,
    regularised,
    update_network,
)
from gridslam.inference.scans.anchor_measurements import of_all_anchors
from gridslam.inference.state.published.feature_particles import Features
from gridslam.inference.state.published.network_particles import CLOCK, NetworkParticleState
from gridslam.world.geometry import mirror, wrap
from gridslam.world.network_scene import network_model
from gridslam.world.scan import Scan

COUNT = 400
SCENE = gs.Scene.load("exchange").with_filter(particles=COUNT)
MODEL = network_model(SCENE, ["agent1", "agent2"])
OWN = MODEL.agents[0]
RADIO, ANCHORS = OWN.radio, OWN.anchors
STD = np.array([0.15, 0.04, 0.05])


def state_of(seed):
    """Two agents, clocks about 10, 20, 30 and 40 m, and one virtual anchor of the third anchor."""
    draw = np.random.default_rng(seed)
    state = NetworkParticleState.start(MODEL)
    agents = np.array([-2.0, 1.0, 0, 0, 0.4, 0.2]) + 0.05 * draw.standard_normal((2, COUNT, 6))
    clocks = 10.0 * np.arange(1, 5)[:, None] + 0.3 * draw.standard_normal((4, COUNT))
    place = mirror(np.array([0.0, 12.0]), ANCHORS[2, :2]) + 0.1 * draw.standard_normal((1, COUNT, 2))
    features = Features(
        np.array([4]), np.array([2]), np.zeros(1, bool), np.array([0.7]), place, np.zeros((1, COUNT))
    )
    return replace(state, agents=agents, clocks=clocks, features=features, next_identity=5), draw


def scan_of(state, label=-1, feature=None, shift=(0.1, 0.02, -0.03)):
    """One measurement of the second anchor's line of sight, or of the virtual anchor."""
    anchor = 1 if feature is None else 2
    place = ANCHORS[1, :2] if feature is None else state.features.position[0].mean(0)
    pose = state.agents[0].mean(0)
    mean = path_values(pose[None, :5], place[None, None], np.array([feature is None]), ANCHORS[anchor])[
        :, 0, 0
    ]
    mean[0] += state.clocks[anchor].mean() - pose[CLOCK]
    value, nan = (mean + shift)[:, None], np.full(1, np.nan)
    return of_all_anchors(Scan(3, 3.0, np.array([label]), *value, nan, *STD[:, None]), RADIO.threshold)


def density(state, scan, anchor, agents, places, clocks, sight):
    """Ratio to clutter of every agent with every place and clock, (A, V, C)."""
    ratio = np.empty((len(agents), len(places), len(clocks)))
    for row, agent in enumerate(agents):
        poses = np.tile(agent[:5], (len(places), 1))
        values = path_values(poses, places[None], np.array([sight]), ANCHORS[anchor])[:, 0]
        left = scan.value[0, 0] - values[0][:, None] - clocks + agent[CLOCK]
        ratio[row] = norm.pdf(left, scale=STD[0])
        for kind in (1, 2):
            ratio[row] *= norm.pdf(wrap(scan.value[0, kind] - values[kind]), scale=STD[kind])[:, None]
    return RADIO.given_detection * ratio / (RADIO.false_alarms / (RADIO.span_m * 4 * np.pi**2))


def test_blurring_is_the_mean_of_gaussians():
    draw = np.random.default_rng(0)
    at, weight, where = draw.uniform(-5, 5, 300), draw.uniform(0, 2, 300), draw.uniform(-7, 7, 200)
    for own in (None, weight):
        expected = (norm.pdf(where[:, None] - at, scale=0.2) * (1 if own is None else own)).mean(1)
        np.testing.assert_allclose(blurred(at, own, where, 0.2), expected, atol=0.01 * expected.max())
    one = blurred(np.zeros(5), None, where, 0.2)
    np.testing.assert_allclose(one, norm.pdf(where, scale=0.2), atol=0.02)
    assert not blurred(np.zeros(5), None, np.array([50.0, 60.0]), 0.2).any()


@pytest.mark.slow
@pytest.mark.parametrize("feature", [None, 0])
def test_ratios_and_messages_to_clocks_integrate_over_all_others(feature):
    state, _ = state_of(1)
    scan = scan_of(state, feature=feature)
    seen = evaluate_network(state, 0, scan, OWN)
    row, anchor = (1, 1) if feature is None else (4, 2)
    places = ANCHORS[1:2, :2] if feature is None else state.features.position[0]
    agents, clocks, some = state.agents[0], state.clocks[anchor], np.arange(12)
    mean = density(state, scan, anchor, agents[some], places, clocks, feature is None).mean((1, 2))
    np.testing.assert_allclose(seen.ratio[row, 0, some], mean, atol=0.03 * mean.max())
    if feature is not None:
        mean = density(state, scan, anchor, agents, places[some], clocks, False).mean((0, 2))
        np.testing.assert_allclose(seen.by_place[0, 0, some], mean, atol=0.03 * mean.max())
    found = associate_network(seen, propose_network(state, 0, scan, OWN, np.random.default_rng(0)).odds)
    assert found.given.tolist() == [anchor]
    logs = clock_messages(state, seen, found)
    exists, nu = seen.existence[row], found.nu[row, 0]
    mean = density(state, scan, anchor, agents, places, clocks[some], feature is None).mean((0, 1))
    expected = np.log(exists * (nu * mean + 1 - RADIO.given_detection) + 1 - exists)
    others = logs[anchor][some] - expected  # of the anchor's other features, which weigh the same everywhere
    assert np.ptp(expected) > 0.5
    np.testing.assert_allclose(others, others.mean(), atol=0.05)


def test_regularising_keeps_the_moments_and_parts_copies():
    draw = np.random.default_rng(0)
    few = draw.standard_normal((20, 6)) * [1, 2, 0.1, 0.1, 0.2, 0.3] + [0, 0, 0, 0, np.pi, 0]
    copies = few[draw.integers(0, 20, 6000)]
    copies[:, 4] = wrap(copies[:, 4])
    apart = regularised(copies, draw)
    assert len(np.unique(apart[:, 0])) == 6000
    before, after = copies.copy(), apart.copy()
    for whole in (before, after):
        whole[:, 4] = wrap(whole[:, 4] - np.pi)
    np.testing.assert_allclose(after.mean(0), before.mean(0), atol=0.02 * before.std(0).max())
    np.testing.assert_allclose(np.cov(after.T), np.cov(before.T), atol=0.05 * np.cov(before.T).max())


def test_births_of_a_lone_measurement_are_those_of_all_events():
    state, draw = state_of(2)
    scan = scan_of(state, feature=0)
    state = replace(state, features=state.features.take(np.zeros(1, bool)))
    seen, new = evaluate_network(state, 0, scan, OWN), propose_network(state, 0, scan, OWN, draw)
    found = associate_network(seen, new.odds)
    beta, missed = seen.ratio.mean(-1)[:, 0], np.full(4, 1 - RADIO.given_detection)
    nothing = missed.prod()
    events = (1 + new.odds.sum()) * nothing + sum(beta[f] * np.delete(missed, f).prod() for f in range(4))
    born = add_network_births(state, new, found, draw).features
    expected = new.odds[0] * nothing / events
    for anchor, existence in zip(born.anchor, born.existence, strict=True):
        assert existence == pytest.approx(expected[anchor], rel=1e-3)
    assert len(born) == (expected > 1e-3).sum()
    assert expected[2] > 0.01


def test_a_label_keeps_other_anchors_out():
    state, draw = state_of(3)
    scan = scan_of(state, label=1)
    seen, new = evaluate_network(state, 0, scan, OWN), propose_network(state, 0, scan, OWN, draw)
    assert seen.ratio[1].any()
    assert not np.delete(seen.ratio, 1, 0).any()
    assert new.odds[0, 1] > 0
    assert not np.delete(new.odds[0], 1).any()
    free = propose_network(state, 0, scan_of(state), OWN, np.random.default_rng(0)).odds[0, 1]
    ratio = propose_network(state, 0, scan, OWN, np.random.default_rng(0)).odds[0, 1]
    assert ratio == pytest.approx(4 * free)


def test_only_the_agent_whose_turn_it_is_moves_and_known_clocks_stay():
    state, draw = state_of(4)
    state = replace(state, time_s=2.0, here=np.ones(2, bool))
    known = replace(MODEL, clocks=replace(MODEL.clocks, half_width_m=np.array([0, 1, 1, 1, 0, 1.0])))
    quiet = Scan(3, 3.0, np.zeros(0, int), *np.zeros((4, 0)))
    moved = move_network(state, 3.0, (quiet, None), known, draw)
    np.testing.assert_array_equal(moved.agents[1, :, :CLOCK], state.agents[1, :, :CLOCK])
    np.testing.assert_array_equal(moved.agents[0, :, CLOCK], state.agents[0, :, CLOCK])
    np.testing.assert_array_equal(moved.clocks[0], state.clocks[0])
    assert moved.clocks[1:].tolist() != state.clocks[1:].tolist()
    scan = scan_of(state)
    seen = evaluate_network(state, 0, scan, OWN)
    found = associate_network(seen, propose_network(state, 0, scan, OWN, draw).odds)
    after = update_network(state, 0, seen, found, draw)
    np.testing.assert_array_equal(after.agents[1], state.agents[1])
    assert after.clocks[1].std() < 0.9 * state.clocks[1].std()
