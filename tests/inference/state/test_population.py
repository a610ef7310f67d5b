"""Several hypotheses: ordering, splitting, merging, pruning, and the moments of their mixture."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.health.doubt import places
from gridslam.inference.management.branching import NARROW, conditioned, placed, split, split_along, widest
from gridslam.inference.management.mixture import (
    CAP,
    HOPELESS,
    agent_moments,
    merged,
    moment_matched,
    same_world,
    together,
)
from gridslam.inference.state.population import GUARDED, NONE, Population, moments

MODEL = model_of(anchors=[[0.0, 0.0, 0.0]])


def random_state(draw, surfaces=2, spread=0.5):
    mean = draw.normal(size=5 + 2 * surfaces)
    root = spread * draw.normal(size=(len(mean), len(mean)))
    return state_of(Belief(mean, root @ root.T + 1e-4 * np.eye(len(mean))), existence=0.9)


def places_of(population):
    """How many places the agent may be at."""
    states = population.states
    return places(population.log_weight, lambda rows: together([states[k].belief for k in rows]))


def mixture(parts):
    """Mean and covariance of weighted Gaussians, headings near each other."""
    mean = sum(weight * part.mean for part, weight in parts)
    spread = sum(
        weight * (part.covariance + np.outer(part.mean - mean, part.mean - mean)) for part, weight in parts
    )
    return mean, spread


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.6))
@settings(max_examples=40, deadline=None)
def test_a_split_keeps_mean_and_covariance_and_its_parts_are_narrow(seed, width):
    draw = np.random.default_rng(seed)
    belief = random_state(draw).belief
    belief.mean[4] = 0.0
    axis = np.linalg.eigh(belief.covariance[:2, :2])[1][:, 1]
    parts = split_along(belief, axis, width)
    unwrapped = [
        (replace(part, mean=np.where(np.arange(9) == 4, belief.mean[4] + turned(part, belief), part.mean)), w)
        for part, w in parts
    ]
    mean, covariance = mixture(unwrapped)
    assert sum(weight for _, weight in parts) == pytest.approx(1)
    np.testing.assert_allclose(mean, belief.mean, atol=1e-8)
    np.testing.assert_allclose(covariance, belief.covariance, atol=1e-8)
    if len(parts) > 1:
        own = np.sqrt(axis @ parts[0][0].covariance[:2, :2] @ axis)
        assert own == pytest.approx(NARROW * width)
        assert np.linalg.eigvalsh(parts[0][0].covariance).min() > -1e-9


def turned(part, belief):
    """How far a part's heading is from the whole's, where it may have gone round."""
    gain = belief.covariance[4, :2] @ np.linalg.pinv(belief.covariance[:2, :2])
    return float(gain @ (part.mean[:2] - belief.mean[:2]))


def test_parts_are_counted_before_they_are_made_and_coarser_where_too_many():
    belief = random_state(np.random.default_rng(1), spread=1.0).belief
    assert widest(belief) > 1
    many = split(belief, 0.2, 10_000)
    assert len(many) > 20
    few = split(belief, 0.2, 12)
    assert 1 < len(few) <= 12
    assert split(belief, 0.2, 1) == [(belief, 1.0)]


def test_a_split_whose_parts_are_merged_at_once_is_the_parent():
    state = random_state(np.random.default_rng(2), spread=0.1)
    state.belief.mean[4] = 0.3
    parts = split_along(state.belief, np.array([1.0, 0.0]), 0.1)
    assert len(parts) > 2
    whole, log = replace(state, belief=parts[0][0]), np.log(parts[0][1])
    for part, weight in parts[1:]:
        whole = moment_matched(whole, replace(state, belief=part), log, np.log(weight))
        log = np.logaddexp(log, np.log(weight))
    np.testing.assert_allclose(whole.belief.mean, state.belief.mean, atol=1e-9)
    np.testing.assert_allclose(whole.belief.covariance, state.belief.covariance, atol=1e-9)


def test_copies_of_one_hypothesis_are_one():
    state = random_state(np.random.default_rng(3))
    twice = Population((state, state), tuple(np.log([0.7, 0.3])))
    once = merged(twice, MODEL)
    assert len(once) == 1
    assert once.log_weight == (0.0,)
    np.testing.assert_allclose(once.best.belief.mean, state.belief.mean)
    np.testing.assert_allclose(once.best.belief.covariance, state.belief.covariance)
    mean, covariance = agent_moments(twice)
    np.testing.assert_allclose(mean, state.belief.mean[:5])
    np.testing.assert_allclose(covariance, state.belief.covariance[:5, :5])


def test_agents_or_walls_that_differ_keep_worlds_apart():
    state = random_state(np.random.default_rng(4), spread=0.02)
    away = placed(state, state.belief.mean[[0, 1, 4]] + [0.5, 0, 0], 1e-4 * np.eye(3), 1e-4)
    other = state.belief.mean.copy()
    other[5] += 0.3  # the first wall is turned
    bent = replace(state, belief=replace(state.belief, mean=other))
    doubted = replace(bent, surfaces=replace(bent.surfaces, existence=np.array([0.3, 0.9])))
    assert not same_world(state, bent, MODEL)
    for rival in (away, bent):
        assert len(merged(Population((state, rival), (np.log(0.5),) * 2), MODEL)) == 2
    assert not same_world(state, doubted, MODEL), "the wall that one believes in has no twin"
    flipped = state.belief.mean.copy()
    flipped[5], flipped[6] = flipped[5] + np.pi, -flipped[6]
    assert same_world(state, replace(state, belief=replace(state.belief, mean=flipped)), MODEL)


@given(st.permutations(range(4)))
@settings(max_examples=12, deadline=None)
def test_the_order_of_hypotheses_changes_nothing(order):
    draw = np.random.default_rng(5)
    states = [random_state(draw, spread=0.05) for _ in range(4)]
    log = np.log([0.5, 0.3, 0.15, 0.05])
    plain = Population.of(states[0]).having(states, log)
    mixed = Population.of(states[0]).having([states[k] for k in order], log[list(order)], order.index(2))
    assert [id(state) for state in mixed.states] == [id(state) for state in plain.states]
    assert mixed.states[mixed.guard] is states[2]
    for here, there in zip(agent_moments(plain), agent_moments(mixed), strict=True):
        np.testing.assert_allclose(here, there)


def test_the_mixture_spans_all_places_across_the_turn_of_an_angle():
    here, there = (state_of(Belief(m, 0.01 * np.eye(5))) for m in np.zeros((2, 5)))
    here.belief.mean[[0, 4]], there.belief.mean[[0, 4]] = [1.0, 3.1], [-1.0, -3.1]
    whole = Population((here, there), (np.log(0.5),) * 2)
    mean, covariance = agent_moments(whole)
    assert mean[0] == pytest.approx(0)
    assert abs(np.cos(mean[4]) + 1) < 1e-9, "the headings' middle is pi, not 0"
    assert covariance[0, 0] == pytest.approx(1.01)
    assert covariance[4, 4] == pytest.approx(0.01 + (np.pi - 3.1) ** 2)
    assert places_of(whole) == 2
    assert places_of(Population((here, here), (np.log(0.5),) * 2)) == 1
    assert places_of(Population((here, there), tuple(np.log([1 - 1e-4, 1e-4])))) == 1, "too unlikely to count"
    fresh = Population((here, there), tuple(np.log([1 - 2e-4, 2e-4])), since=3)
    assert places_of(fresh) == 2
    assert places_of(replace(fresh, since=40)) == 2, "however long ago they branched"


def test_unlikely_hypotheses_go_and_the_parent_of_a_branching_stays_for_a_while():
    state = random_state(np.random.default_rng(6))
    log = np.array([0.0, -HOPELESS + 1, -HOPELESS - 1, -HOPELESS - 2])
    whole = Population.of(state).having((state,) * 4, log, guard=3, since=1)
    early = whole.pruned(HOPELESS, CAP)
    assert len(early) == 3
    assert early.guard == 2
    late = replace(whole, since=GUARDED + 1).pruned(HOPELESS, CAP)
    assert len(late) == 2
    assert late.guard == NONE
    assert np.exp(late.log_weight).sum() == pytest.approx(1)


def test_a_population_of_any_states_is_ordered_pruned_and_merged_by_what_is_the_same():
    few = Population.of("z").having("dabc", np.log([1.0, 4.0, 3.0, 2.0]), guard=3)
    assert few.states == ("a", "b", "c", "d")
    assert few.states[few.guard] == "c"
    np.testing.assert_allclose(few.weights, [0.4, 0.3, 0.2, 0.1])
    assert few.likely(np.log(3.0), 2) == [0, 1]
    assert replace(few, since=GUARDED).likely(np.log(3.0), 1) == [0, 2]
    vowels = few.merged(lambda one, other: (one in "ae") == (other in "ae"))
    assert vowels.states == ("b", "a")
    np.testing.assert_allclose(vowels.weights, [0.6, 0.4])
    assert vowels.states[vowels.guard] == "b"
    joined = few.merged(lambda one, other: True, join=lambda one, other, *logs: one + other)
    assert joined.states == ("abcd",)
    assert joined.log_weight == (0.0,)
    guarded = replace(few, since=0)
    assert guarded.merged(lambda one, other: True).states == ("a", "c")
    near = np.eye(4, dtype=bool)
    assert few.merged(lambda one, other: True, near) is few
    assert few.merged(lambda one, other: False, among=[0, 3]).states == ("a", "d")
    with pytest.raises(ValueError, match="0 states"):
        Population(())


def test_moments_are_those_of_a_mixture_worked_out_by_hand():
    mean, covariance = moments(np.array([0.25, 0.75]), np.array([[0.0], [4.0]]), np.array([[[1.0]], [[3.0]]]))
    assert mean == pytest.approx([3.0])
    assert covariance == pytest.approx(np.array([[0.25 * 10 + 0.75 * 4]]))


def test_a_state_given_a_pose_is_the_gaussian_given_it():
    state = random_state(np.random.default_rng(7), spread=0.1)
    state.belief.mean[4] = 0.2
    pose, rows = state.belief.mean[[0, 1, 4]], np.array([0, 1, 4])
    own = state.belief.covariance[np.ix_(rows, rows)]
    same = conditioned(state, pose, own).belief
    np.testing.assert_allclose(same.mean, state.belief.mean, atol=1e-6)
    np.testing.assert_allclose(same.covariance, state.belief.covariance, atol=1e-6)
    shift = np.array([0.1, -0.05, 0.02])
    sure = conditioned(state, pose + shift, 1e-12 * np.eye(3)).belief
    np.testing.assert_allclose(sure.mean[rows], pose + shift, atol=1e-6)
    rest = np.setdiff1d(np.arange(9), rows)
    gain = state.belief.covariance[np.ix_(rest, rows)] @ np.linalg.inv(own)
    np.testing.assert_allclose(sure.mean[rest], state.belief.mean[rest] + gain @ shift, atol=1e-5)
    left = state.belief.covariance[np.ix_(rest, rest)] - gain @ state.belief.covariance[np.ix_(rows, rest)]
    np.testing.assert_allclose(sure.covariance[np.ix_(rest, rest)], left, atol=1e-5)
