"""An agent's clock is set right if lines of sight say so, with those of anchors that it alone hears."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.health.reasons import CLOCK_CONTESTED
from gridslam.inference.messages.network.clock_ties import MOST, challenge_ties
from gridslam.inference.state.network.clock_search import NEVER
from gridslam.simulation.network import simulate_network
from gridslam.systems.network import NetworkSlam, take_turns, turn
from gridslam.world.network_scan import NetworkScan

AGENTS = ["agent1", "agent2"]
WRONG_M = 4.0


@pytest.fixture(scope="module")
def settled():
    """Two agents whose clocks were wide, six steps on, and what is heard at the next four."""
    whole = gs.Scene.load("exchange").model_dump(exclude_none=True)
    whole["filter"] |= {"particles": 300, "adapt_particles": False}
    whole["clocks"] |= {"agent_prior_ns": 50.0, "reference": "A"}
    whole["anchors"][0]["clock"] = {"offset_ns": 0.0}
    for agent, offset in zip(whole["agents"], (-12.0, 9.0), strict=False):
        agent |= {"steps": 10, "clock": {"offset_ns": offset}}
    scene = gs.Scene.checked(whole, "test")
    data, _ = simulate_network(scene, AGENTS, 3)
    slam = NetworkSlam(scene, agents=AGENTS, seed=3)
    scans = list(data)
    for scan in scans[:6]:
        slam.step(scan)
    assert not slam.state.clocks.searched.any()
    return slam, [scan.scans for scan in scans[6:]]


def without(scan, anchors):
    """A scan without what is heard of some anchors."""
    rows = ~np.isin(scan.anchor, anchors)
    columns = {name: value[rows] for name, value in vars(scan).items() if isinstance(value, np.ndarray)}
    return replace(scan, **columns)


def looked(slam, state, scans):
    """The state after looks at what is heard, as if at the same step."""
    for pair in scans:
        state = challenge_ties(replace(state, step=0), pair, slam.model, works=slam.work)
    return replace(state, step=slam.state.step)


def clocks(state):
    return state.belief.clock_offsets()[0]


def off(state, entries, offset):
    """The state with some devices' clocks off."""
    rows = state.belief.layout.devices[entries].tolist()
    return replace(state, belief=state.belief.together(rows, offset, 0.0))


@pytest.mark.slow
def test_clocks_that_are_right_stay_as_they_are(settled):
    slam, scans = settled
    after = looked(slam, slam.state, scans)
    np.testing.assert_array_equal(after.belief.mean, slam.state.belief.mean)
    np.testing.assert_array_equal(after.belief.covariance, slam.state.belief.covariance)
    assert after.clocks.moved.max() < MOST / 2


@pytest.mark.slow
def test_a_wrong_clock_of_an_agent_is_set_right_by_more_than_one_look(settled):
    slam, scans = settled
    wrong = off(slam.state, [5], WRONG_M)
    once = looked(slam, wrong, scans[:1])
    np.testing.assert_array_equal(clocks(once), clocks(wrong))
    after = looked(slam, wrong, scans)
    np.testing.assert_allclose(clocks(after), clocks(slam.state), atol=0.5)
    np.testing.assert_array_equal(np.delete(clocks(after), 5), np.delete(clocks(slam.state), 5))
    rows = slam.state.belief.layout.devices[[5]]
    np.testing.assert_allclose(
        np.diff(np.diagonal([x.belief.covariance for x in (wrong, after)], 0, 1, 2)[:, rows], axis=0), 1.0
    )
    assert not after.clocks.moved.any()


@pytest.mark.slow
def test_what_was_heard_by_a_wrong_clock_is_forgotten_once_it_is_right(settled):
    """Else it stands for another offset of an anchor's clock, and opens that."""
    slam, scans = settled
    wrong = off(slam.state, [5], WRONG_M)
    log = np.where(wrong.clocks.log > NEVER, -50.0 * (np.abs(wrong.clocks.centre) < 5.0), NEVER)
    after = looked(slam, replace(wrong, clocks=replace(wrong.clocks, log=log)), scans)
    common = after.clocks.log[:4]
    assert not common[common > NEVER].any()


@pytest.mark.slow
def test_an_anchor_that_it_alone_hears_moves_with_it(settled):
    """Anchors A, B and C are heard by both, D by the second agent alone: it fits its clock, and moves."""
    slam, scans = settled
    scans = [(without(first, [3]), second) for first, second in scans]
    after = looked(slam, off(slam.state, [3, 5], WRONG_M), scans)
    np.testing.assert_allclose(clocks(after), clocks(slam.state), atol=0.5)


def test_where_nothing_else_is_heard_of_both_nothing_says_so(settled):
    """The first agent hears A alone, the other the rest: how their clocks differ nobody tells."""
    slam, scans = settled
    apart = [(without(first, [1, 2, 3]), without(second, [0])) for first, second in scans]
    wrong = off(slam.state, [1, 2, 3, 5], WRONG_M)
    np.testing.assert_array_equal(clocks(looked(slam, wrong, apart)), clocks(wrong))


@pytest.mark.slow
def test_not_beyond_a_prior(settled):
    slam, scans = settled
    clock = slam.model.clocks
    narrow = clock.half_width_m.copy()
    narrow[4:] = np.abs(clocks(slam.state)[4:]) - [-1.0, 2.6]
    model = replace(slam.model, clocks=replace(clock, half_width_m=narrow))
    wrong = off(slam.state, [5], -WRONG_M)
    state = wrong
    for pair in scans:
        state = challenge_ties(replace(state, step=0), pair, model, works=slam.work)
    np.testing.assert_array_equal(clocks(state), clocks(wrong))


@pytest.mark.slow
def test_health_says_so_before_a_clock_is_set_elsewhere(settled):
    slam, scans = settled
    once = looked(slam, off(slam.state, [5], WRONG_M), scans[:1])
    assert once.clocks.contested(1)
    assert not looked(slam, slam.state, scans).clocks.contested(1)
    later = NetworkScan(6, 6.0, scans[0])
    for state, said in ((slam.state, False), (once, True)):
        _, infos = take_turns(state, later, 5.0, slam.model, slam.work, turn)
        assert (CLOCK_CONTESTED in infos[1].health.why) == said
