"""Lines that agree are merged, unless what was measured, or that one walks, shows that they are two;
what that says of the agent counts as far as both exist."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of

from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.management.merging import both_exist, merge, merge_and_prune
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.rays import Rays
from gridslam.kernels.primitives import tables

WALL = [0.5 * np.pi, 3.0]


def merged(paths, shares, seen=0, walk=0.0, anchors=(0, 1)):
    """Numbers left of two surfaces on one line, after an exchange of each of `anchors` (-1: of all).

    `paths` are (anchor, bounces, last, first), `shares` what each has of two measurements of its exchange.
    """
    state = state_of(Belief(np.concatenate([np.zeros(5), WALL, WALL]), 1e-4 * np.eye(9)), 2, 0.9)
    bank = replace(state.surfaces, seen=np.full(2, seen), walk=np.array([[0.0, walk], [0.0, 0.0]]))
    exchanges = []
    for anchor in anchors:
        own = [row for row, path in enumerate(paths) if anchor in (path[0], -1)]
        table = np.array([paths[row] for row in own]).reshape(-1, 4)
        rays = Rays.of(*table.T, np.ones(len(own)), np.ones(len(own)))
        message = np.zeros((5, len(own), 2))
        message[tables.RESPONSIBLE] = np.array([shares[row] for row in own]).reshape(-1, 2)
        nothing = np.zeros((tables.ODDS, len(own))), message, np.zeros((tables.MEASURED_ROWS, 2))
        exchanges.append(Exchange(anchor, rays, *nothing, np.zeros((1, 9)), 64, np.zeros((0, 2))))
    model = model_of(anchors=np.zeros((2, 3)))
    after = merge_and_prune(replace(state, surfaces=bank), model, exchanges=exchanges)
    return after.surfaces.identity.tolist()


FIRST, SECOND = [0.9, 0.05], [0.05, 0.9]


@pytest.mark.parametrize(
    ("paths", "shares", "left"),
    [
        ([], [], [0]),
        ([(0, 1, 0, 0), (0, 1, 1, 1)], [FIRST, SECOND], [0, 1]),
        ([(0, 1, 0, 0), (0, 1, 1, 1)], [[0.45, 0.05], [0.45, 0.05]], [0]),
        ([(0, 1, 0, 0), (1, 1, 1, 1)], [FIRST, SECOND], [0]),
        ([(0, 1, 0, 0), (0, 2, 1, 0)], [FIRST, SECOND], [0]),
    ],
    ids=["nothing measured", "one each", "one shared", "of two anchors", "a double bounce"],
)
def test_two_single_bounces_of_one_scan_are_of_two_surfaces(paths, shares, left):
    assert merged(paths, shares) == left


@pytest.mark.parametrize(("seen", "walk", "left"), [(8, 0.2, [0, 1]), (7, 0.2, [0]), (8, -0.2, [0])])
def test_a_line_that_walks_onto_another_that_was_seen_often_is_not_it(seen, walk, left):
    assert merged([], [], seen, walk) == left


def test_single_bounces_from_two_anchors_in_one_exchange_may_be_of_one_surface():
    assert merged([(0, 1, 0, 0), (1, 1, 1, 1)], [FIRST, SECOND], anchors=(-1,)) == [0]
    assert merged([(1, 1, 0, 0), (1, 1, 1, 1)], [FIRST, SECOND], anchors=(-1,)) == [0, 1]


@pytest.mark.parametrize(("existence", "both"), [(1.0, 1.0), (0.5, 0.965), (0.1, 0.756), (0.02, 0.363)])
def test_a_merger_moves_the_agent_as_far_as_both_surfaces_exist(existence, both):
    """By hand: the agent's y and the birth's offset have variance 0.01 each and are the same error; the birth
    lies 5 cm beyond a wall of variance 0.0001. If both exist, the tie takes 5 cm * 0.01 / 0.0102 off y, and
    of its variance 0.01^2 / 0.0102 (the tie's own noise is 1 cm, the wall's 1 cm). Turns are known to 0.5
    rad, so that lines that are one are that near with density exp(-0.05^2 / 0.0204) / (2 pi sqrt(0.0102 *
    0.2501)) = 2.79 per m and rad; others with 0.1."""
    covariance = 1e-4 * np.eye(9)
    covariance[np.ix_([1, 8], [1, 8])] = 0.01
    covariance[8, 8] += 1e-9
    covariance[7, 7] = 0.25
    mean = np.concatenate([np.zeros(5), WALL, [WALL[0], WALL[1] + 0.05]])
    state = state_of(Belief(mean, covariance), 2, 1.0)
    bank = replace(state.surfaces, existence=np.array([1.0, existence]))
    after, belief = merge(replace(bank, age=np.array([9.0, 1.0])), state.belief)
    step = -0.05 * 0.01 / 0.0102
    assert after.identity.tolist() == [0]
    assert belief.mean[1] == pytest.approx(both * step, rel=5e-3)
    spread = both * (1.0 - both) * step**2
    assert belief.covariance[1, 1] == pytest.approx(0.01 - both * 1e-4 / 0.0102 + spread, rel=1e-2)


def test_one_surface_has_heard_what_both_have():
    """Of two that are one, the angles of all paths count."""
    belief = Belief(np.concatenate([np.zeros(5), WALL, WALL]), 1e-4 * np.eye(9))
    state = state_of(belief, 2, 1.0)
    angles = np.arange(32.0).reshape(state.surfaces.angles.shape)
    bank = replace(state.surfaces, angles=angles, age=np.array([9.0, 4.0]))
    after, _ = merge(bank, belief)
    np.testing.assert_array_equal(after.angles, angles.sum(0, keepdims=True))


def test_a_birth_of_one_per_cent_that_agrees_vaguely_moves_nothing_to_speak_of():
    """Two walls of 1 m and 0.5 rad are near each other by chance as well."""
    belief = Belief(np.zeros(9), np.diag([1e-4] * 6 + [1.0, 0.25, 1.0]))
    jacobian = np.zeros((2, 9))
    jacobian[0, [6, 8]], jacobian[1, [5, 7]] = (1.0, -1.0), (1.0, -1.0)
    assert both_exist(0.01, belief, jacobian, np.zeros(2)) < 0.03
    assert both_exist(0.01, replace(belief, covariance=1e-6 * np.eye(9)), jacobian, np.zeros(2)) > 0.95


@pytest.mark.parametrize(("ages", "moves"), [([9.0, 0.0], False), ([9.0, 0.7], True), ([0.0, 0.0], True)])
def test_a_birth_that_lies_on_a_known_wall_at_once_moves_nobody(ages, moves):
    """The association has weighed whether its measurement came over that wall; of two births it has not."""
    covariance = 1e-4 * np.eye(9)
    covariance[np.ix_([1, 8], [1, 8])] = 0.01
    covariance[8, 8] += 1e-9
    mean = np.concatenate([np.zeros(5), WALL, [WALL[0], WALL[1] + 0.05]])
    state = state_of(Belief(mean, covariance), 2, 0.9)
    bank, belief = merge(replace(state.surfaces, age=np.array(ages)), state.belief)
    assert bank.identity.tolist() == [0]
    assert (abs(belief.mean[1]) > 0.01) == moves
    np.testing.assert_allclose(belief.mean[5:7], WALL, atol=1e-12 if not moves else 0.1)
