"""How far clocks walk, by how far steps move them: docs/model.md, (M331)."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import gridslam as gs
from gridslam.bench.course import changed
from gridslam.inference.messages.network.motion import predict_all
from gridslam.inference.messages.network.walk import (
    FIRST_STEP,
    FORGETTING,
    learn_walk,
    walk_covariance,
)
from gridslam.inference.state.network.clock_walk import PRIOR, SHARES, WAYS, ClockWalk, ways_of
from gridslam.inference.state.network.state import NetworkState
from gridslam.world.clocks import NS
from gridslam.world.network_scene import network_model

AGENTS = ["agent1", "agent2", "agent3"]
J, FREE = 4, 7
ALL = np.ones(FREE, bool)
AMONG_ANCHORS = np.array([1.0, -1, 0, 0, 0, 0, 0])
AMONG_AGENTS = np.array([0.0, 0, 0, 0, 1, 0, -1])
AGAINST = np.array([3.0, 3, 3, 3, -4, -4, -4])


@pytest.fixture(scope="module")
def world():
    """Model and state of `exchange`, all clocks set."""
    model = network_model(gs.Scene.load("exchange"), AGENTS)
    state = NetworkState.start(model)
    clocks = replace(state.clocks, unset=np.zeros(J, bool))
    return model, replace(state, clocks=clocks, step=FIRST_STEP, here=np.ones(3, bool), time_s=0.0)


def with_clocks(state, mean, covariance):
    """The state with the clocks' mean (D,) and covariance (D, D)."""
    own, belief = state.belief.layout.devices, state.belief
    centre, whole = belief.mean.copy(), belief.covariance.copy()
    centre[own], whole[np.ix_(own, own)] = mean, covariance
    return replace(state, belief=replace(belief, mean=centre, covariance=whole))


def learned(world, moved, before=2.0, after=1.0, **changes):
    """What is learned once the clocks, known to `before` m^2 after a first step, are moved in another."""
    model, state = world
    first = learn_walk(
        with_clocks(state, np.zeros(FREE), 2 * before * np.eye(FREE)),
        with_clocks(state, np.zeros(FREE), before * np.eye(FREE)), model,
    )  # fmt: skip
    ahead = with_clocks(replace(first, time_s=1.0), np.zeros(FREE), before * np.eye(FREE))
    return learn_walk(ahead, replace(with_clocks(ahead, moved, after * np.eye(FREE)), **changes), model).walks


def test_ways_are_all_in_which_clocks_can_walk():
    """Orthogonal projections; with what is common to all, they are all that there is."""
    ways = ways_of(J, ALL, common=False)
    np.testing.assert_allclose([np.trace(way) for way in ways], [3, 2, 1], atol=1e-12)
    for a, one in enumerate(ways):
        for b, other in enumerate(ways):
            np.testing.assert_allclose(one @ other, one if a == b else 0 * one, atol=1e-12)
    for number, walk in enumerate((AMONG_ANCHORS, AMONG_AGENTS, AGAINST)):
        np.testing.assert_allclose(ways[number] @ walk, walk, atol=1e-12)
    np.testing.assert_allclose(ways.sum(0) @ np.ones(FREE), 0, atol=1e-12)
    np.testing.assert_allclose(ways_of(J, ALL, common=True).sum(0), np.eye(FREE), atol=1e-12)
    lone = ways_of(1, np.array([True, True]), common=False)
    np.testing.assert_allclose(lone[:2], 0)
    np.testing.assert_allclose(lone[2], [[0.5, -0.5], [-0.5, 0.5]])
    synchronised = ways_of(J, np.arange(FREE) >= J, common=True)  # the agents' alone aren't known
    np.testing.assert_allclose(synchronised.sum(0), np.diag((np.arange(FREE) >= J).astype(float)), atol=1e-12)


def test_each_way_of_walking_is_learned_and_teaches_the_others_a_little(world):
    prior = float(SHARES @ PRIOR)
    prior_walk = world[0].clocks.walk_m
    still = learned(world, 0 * AMONG_ANCHORS, before=prior_walk**2, after=0.5 * prior_walk**2).share
    assert (still < prior).all()
    for way, walk in enumerate((AMONG_ANCHORS, AMONG_AGENTS, AGAINST)):
        moved = prior_walk * walk / np.abs(walk).max()
        share = learned(world, moved, before=prior_walk**2, after=0.5 * prior_walk**2).share
        assert share[way] > 1.02 * still[way]
        grown = share / still
        assert (np.delete(grown, way) > 1).all()  # all ways may be alike
        assert grown.argmax() == way
    common = learned(
        world, 0 * AMONG_ANCHORS + 5 * prior_walk, before=prior_walk**2, after=0.5 * prior_walk**2
    ).share
    np.testing.assert_allclose(common, still)  # what all have in common isn't observed


def test_what_agents_have_in_common_is_learned_beside_clocks_that_are_known():
    known = changed(gs.Scene.load("exchange"), clocks={"anchor_prior_ns": 0.0})
    known = known.model_copy(
        update={"anchors": tuple(a.model_copy(update={"clock": None}) for a in known.anchors)}
    )
    model = network_model(known, AGENTS)
    assert model.clocks.known.tolist() == [True] * J + [False] * 3
    state = NetworkState.start(model)
    clocks = replace(state.clocks, unset=np.zeros(J, bool))
    there = model, replace(state, clocks=clocks, step=FIRST_STEP, here=np.ones(3, bool), time_s=0.0)
    prior_walk, together = model.clocks.walk_m, np.append(np.zeros(J), np.ones(3))
    still = learned(there, 0 * together, before=prior_walk**2, after=0.5 * prior_walk**2).share
    moved = learned(there, prior_walk * together, before=prior_walk**2, after=0.5 * prior_walk**2).share
    assert moved[2] > 1.02 * still[2]
    assert moved[0] == still[0] == 1  # anchors' clocks don't walk


def test_walks_are_weighed_by_what_they_expect(world):
    """By hand: one direction, 2 told^2 after the first step, heard to told^2 in the second."""
    prior_walk = world[0].clocks.walk_m ** 2
    moved = np.sqrt(prior_walk) * AGAINST / np.linalg.norm(AGAINST)
    walks = learned(world, moved, before=2 * prior_walk, after=prior_walk)
    # halves the variance, and so moves half of the way
    noise, value = 2 * prior_walk, 2 * np.sqrt(prior_walk)
    ahead = 2 * prior_walk + prior_walk * SHARES
    wanted = -0.5 * (value**2 / (ahead + noise) + np.log(ahead + noise))
    np.testing.assert_allclose(walks.log[2], wanted - wanted.max())
    gain = ahead / (ahead + noise)
    np.testing.assert_allclose(walks.variance[2], (1 - gain) * ahead)
    np.testing.assert_allclose(walks.mean[2] @ AGAINST / np.linalg.norm(AGAINST), gain * value)


def test_a_clock_that_jumps_says_nothing_of_walks(world):
    prior_walk = world[0].clocks.walk_m
    jumped = learned(world, 40 * prior_walk * AMONG_ANCHORS, before=prior_walk**2, after=0.5 * prior_walk**2)
    np.testing.assert_array_equal(jumped.log, 0)  # as before it
    np.testing.assert_allclose(jumped.mean[0], np.tile(40 * prior_walk * AMONG_ANCHORS, (len(SHARES), 1)))
    np.testing.assert_allclose(jumped.variance, 0.5 * prior_walk**2)


def test_steps_that_say_nothing_of_the_walk_leave_it_alone(world):
    model, state = world
    open_one = replace(state.clocks, unset=np.array([False, True, False, False]))
    astray = replace(state.records[0], monitor=replace(state.records[0].monitor, lost=1))
    before = with_clocks(state, np.zeros(FREE), np.eye(FREE))
    for changes in (
        {"step": FIRST_STEP - 1}, {"clocks": open_one}, {"records": (astray,) * 3}, {"time_s": None},
    ):  # fmt: skip
        other = replace(with_clocks(before, np.ones(FREE), 0.5 * np.eye(FREE)), **changes)
        assert learn_walk(before, other, model) is other
    silent = learned(world, np.zeros(FREE), before=1.0, after=1.0)
    np.testing.assert_array_equal(silent.log, 0)
    assert (np.diff(silent.variance) > 0).all()  # but clocks have walked on
    without = learned(world, 1e-3 * AMONG_AGENTS, records=(astray, *state.records[1:]))
    assert without.free.tolist() == [True] * 4 + [False, True, True]
    np.testing.assert_array_equal(without.log, 0)  # filters start again where other clocks are heard
    np.testing.assert_array_equal(without.mean[..., 4], 0)
    np.testing.assert_array_equal(without.share, 1)  # nothing was weighed: clocks walk as they are told
    assert (learned(world, 1e-3 * AMONG_AGENTS).share < 1).all()


def test_walks_are_weighed_over_all_groupings_of_the_ways():
    """Against plain enumeration: which ways walk by the same, and by how much each group does."""
    log = 3 * np.random.default_rng(1).standard_normal((WAYS, len(SHARES)))
    weight = np.zeros_like(log)
    for grouping in ((0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 1, 1), (0, 1, 2)):
        for walks in product(range(len(SHARES)), repeat=max(grouping) + 1):
            own = [walks[group] for group in grouping]
            weight[range(WAYS), own] += np.prod(PRIOR[list(walks)]) * np.exp(log[range(WAYS), own].sum())
    blank = np.zeros((WAYS, len(SHARES), FREE))
    found = ClockWalk(log - log.max(1, keepdims=True), blank, blank[..., 0], ALL, 0.0)
    np.testing.assert_allclose(found.weight, weight / weight.sum(1, keepdims=True))


def test_clocks_walk_as_was_learned(world):
    model, state = world
    prior_walk, own = model.clocks.walk_m**2, state.belief.layout.devices
    np.testing.assert_allclose(walk_covariance(state, model), prior_walk * np.eye(FREE))
    log = np.full((WAYS, len(SHARES)), -1e3)
    log[[0, 1, 2], [1, 5, 9]] = 0.0
    blank = np.zeros((WAYS, len(SHARES), FREE))
    walks = ClockWalk(log, blank, blank[..., 0], ALL, 0.0)
    np.testing.assert_allclose(walks.share, SHARES[[1, 5, 9]])
    after = predict_all(replace(state, walks=walks), 2.0, [None] * 3, model)
    grown = (after.belief.covariance - state.belief.covariance)[np.ix_(own, own)]
    for walk, share in ((AMONG_ANCHORS, 1), (AMONG_AGENTS, 5), (AGAINST, 9), (np.ones(FREE), 9)):
        np.testing.assert_allclose(grown @ walk, 2.0 * prior_walk * SHARES[share] * walk, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("true", [(1.0, 1.0, 1.0), (0.3, 0.3, 0.3), (0.03, 1.0, 0.2), (0.0, 0.0, 0.0)])
def test_the_walks_of_simulated_clocks_are_found(world, true):
    """Clocks alone, all pairs of anchors and agents measured at each step, by a textbook Kalman filter."""
    model, state = world
    prior_walk, noise, draw = model.clocks.walk_m, 3 * NS * 0.1, np.random.default_rng(5)
    rows = np.array([np.eye(FREE)[j] - np.eye(FREE)[i] for i in (4, 5, 6) for j in range(J)])
    root = np.einsum("w,wij->ij", np.array(true), ways_of(J, ALL, common=True))
    offset, state = np.zeros(FREE), with_clocks(state, np.zeros(FREE), np.eye(FREE))
    own, squares = state.belief.layout.devices, []
    ways = ways_of(J, ALL, common=False).sum(0)
    for step in range(400):
        offset = offset + prior_walk * root @ draw.standard_normal(FREE)
        mean, covariance = state.belief.mean[own], state.belief.covariance[np.ix_(own, own)]
        covariance = covariance + walk_covariance(state, model)
        before = replace(with_clocks(state, mean, covariance), time_s=float(step))
        size = rows @ covariance @ rows.T + noise**2 * np.eye(len(rows))
        gain = np.linalg.solve(size, rows @ covariance).T
        received = rows @ offset + noise * draw.standard_normal(len(rows))
        mean, covariance = mean + gain @ (received - rows @ mean), covariance - gain @ rows @ covariance
        after = with_clocks(before, mean, covariance)
        state = learn_walk(before, after, model)
        error = ways @ (mean - offset)
        squares.append(error @ np.linalg.pinv(ways @ covariance @ ways, rcond=1e-6) @ error / (FREE - 1))
    np.testing.assert_allclose(np.sqrt(state.walks.share), true, rtol=0.35, atol=0.02)
    # clocks that stand still aren't told from ones that hardly walk; without a share of none it is below 0.5
    assert (0.7 if any(true) else 0.6) < np.mean(squares[100:]) < 1.3
    assert state.walks.log.min() > -1e4
    assert 0.99 < FORGETTING < 1


def test_walks_of_old_checkpoints_are_as_told(world):
    """Fields that such a file lacks: None, and the scene's walk."""
    model, state = world
    assert state.walks is None
    same = predict_all(state, 1.0, [None] * 3, model)
    own = state.belief.layout.devices
    grown = (same.belief.covariance - state.belief.covariance)[np.ix_(own, own)]
    np.testing.assert_array_equal(grown, np.diag(np.diag(grown)))
    np.testing.assert_allclose(np.diag(grown), model.clocks.walk_m**2, rtol=1e-6)
