"""Rival modes of clocks where departures aren't measured: hypotheses that share a histogram's mass."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import gridslam as gs
from gridslam.evaluation.network_scores import without_common
from gridslam.inference.management.network.clock_rivals import (
    HOPELESS,
    branches,
    early_modes,
    likeliest_choices,
    reduced,
    rival_modes,
    unset_clocks,
)
from gridslam.inference.messages.network.clock_setting import tells_no_departure
from gridslam.inference.state.network.clock_search import CELL_M, NEVER
from gridslam.inference.state.network.state import ClockSteps, NetworkState
from gridslam.inference.state.population import Population
from gridslam.runs.network_run import map_network
from gridslam.simulation.network import simulate_network
from gridslam.world.network_scan import NetworkScan
from gridslam.world.network_scene import network_model
from gridslam.world.start import assumed_start

AGENTS = ["agent1", "agent2", "agent3"]
OUTSIDE = -20.0
"""Log mass below which a cell is none of a mode's."""


@pytest.fixture(scope="module")
def fresh():
    scene = gs.Scene.load("exchange")
    return NetworkState.start(network_model(scene, AGENTS[:2]))


def with_peaks(state, *peaks):
    """A state whose first clocks have peaks at (anchor, cell, log mass), and nothing else but a floor."""
    search = state.clocks
    evidence = np.full_like(search.log, -40.0)
    for anchor, cell, log in peaks:
        evidence[anchor, cell] = log
    for anchor in range(len(evidence)):
        if anchor not in [peak[0] for peak in peaks]:
            evidence[anchor] = 0.0
    return replace(state, clocks=search.updated(evidence))


def test_modes_that_count_are_kept_and_what_is_left_only_if_it_counts(fresh):
    after = with_peaks(fresh, (0, 400, 0.0), (0, 445, -5.0), (0, 600, -20.0), (1, 300, 0.0))
    modes = rival_modes(after.clocks)
    assert 1 not in modes  # one mode is no rival
    assert [int(np.flatnonzero(own)[len(own[own]) // 2]) for own in modes[0]] == [400, 445]
    assert {2, 3} < set(modes)  # nothing heard: whatever is left counts
    assert all(not (one & other).any() for one, other in zip(modes[2], modes[2][1:], strict=False))


def test_in_the_first_steps_a_likely_mode_and_what_is_left_are_kept(fresh):
    grid, flat = fresh.clocks.centre, -np.log(len(fresh.clocks.centre))

    def with_peaks(*peaks):
        """Of the first clock: shares of the mass about offsets (m), with deviations."""
        mass = np.full(len(grid), np.exp(flat) * (1 - sum(share for _, _, share in peaks)))
        for centre, std, share in peaks:
            bell = np.exp(-0.5 * ((grid - centre) / std) ** 2)
            mass += share * bell / bell.sum()
        evidence = np.zeros_like(fresh.clocks.log)
        evidence[0] = np.log(mass)
        return fresh.clocks.updated(evidence)

    likely = with_peaks((5.0, 0.5, 0.9))
    modes = early_modes(likely)
    assert set(modes) == {0}  # nothing was heard of the others
    first, left = modes[0]
    assert np.abs(grid[first] - 5.0).max() == pytest.approx(2.5)
    assert not (first & left).any()
    assert (first | left).sum() == (likely.log[0] > NEVER).sum()
    assert len(early_modes(with_peaks((5.0, 0.5, 0.6), (-9.0, 0.5, 0.3)))[0]) == 3
    assert not early_modes(with_peaks((5.0, 0.5, 0.15)))  # less than a fifth
    assert not early_modes(with_peaks((5.0, 1.5, 0.9)))  # no mode: too wide
    assert not early_modes(replace(likely, since=np.full(4, 4)))


def test_a_pose_doesn_t_wait_for_a_clock_that_is_likely_but_not_sure():
    """Seed 24: both lines of sight are heard at once, one with angles that leave its clock in doubt."""
    whole = gs.Scene.load("exchange").model_dump(exclude_none=True)
    whole["radio"]["snr_at_1m_db"], whole["anchors"] = 52.0, whole["anchors"][:2]
    scene = gs.Scene.checked(whole, "test")
    data, truth = simulate_network(scene, AGENTS[:1], 24, unlabelled=True)
    slam = gs.NetworkSlam(scene, seed=24)
    slam.start_all({"agent1": assumed_start(scene, "agent1", 24)})
    estimate = slam.step(data.scan(0))
    assert len(slam.now.believed) > 1
    assert estimate.unset.any()
    true = truth.agents["agent1"].trajectory.position_m[0]
    assert np.linalg.norm(estimate.agents["agent1"].position_m - true) < 0.1  # 0.23 m without the clock
    for step in range(1, 4):
        estimate = slam.step(data.scan(step))
    assert len(slam.now.believed) == 1
    assert not estimate.unset.any()


def test_branches_share_out_the_mass_that_there_was(fresh):
    after = with_peaks(
        fresh, (0, 400, 0.0), (0, 445, -5.0), (1, 300, 0.0), (1, 380, -1.0), (2, 500, 0.0), (3, 9, 0.0)
    )
    modes = rival_modes(after.clocks)
    assert sorted(modes) == [0, 1]
    everything = np.isfinite(fresh.clocks.log[0]) & (fresh.clocks.log[0] > NEVER)
    whole = {anchor: [*own, everything & ~np.any(own, axis=0)] for anchor, own in modes.items()}
    cells = range(fresh.clocks.log.shape[1])
    made = branches(fresh, with_peaks(fresh, *[(a, c, 0.0) for a in (0, 1) for c in cells]), whole, 9, 0.0)
    assert len(made) == 9
    assert np.exp([share for _, share in made]).sum() == pytest.approx(1)
    likeliest = branches(fresh, after, modes, 1, 0.0)
    assert len(likeliest) == 1
    state, share = likeliest[0]
    left = [np.flatnonzero(own > OUTSIDE) for own in state.clocks.log]
    for anchor, cell in ((0, 400), (1, 300)):
        assert np.abs(left[anchor] - cell).max() * CELL_M <= 1.26
    np.testing.assert_array_equal(state.clocks.log[2:], fresh.clocks.log[2:])
    cells = everything.sum()
    assert share == pytest.approx(np.log(len(left[0]) / cells) + np.log(len(left[1]) / cells))
    assert likeliest[0][0].belief is fresh.belief


def test_a_branch_keeps_to_its_modes_in_the_steps_that_it_may_take_again(fresh):
    """One clock of two was set when the search began; by then both had walked by 0.4 m."""
    before = replace(fresh, time_s=7.0, clocks=fresh.clocks.closed(1))
    search = ClockSteps(before, (NetworkScan(0, 8.0, (None, None)),), 0.0)
    now = replace(fresh, time_s=11.0, search=search)
    modes = {
        anchor: [np.arange(fresh.clocks.log.shape[1]) // 10 == row for row in (40, 41)] for anchor in (0, 1)
    }
    (state, _), *_ = branches(now, with_peaks(now, (0, 405, 0.0), (1, 405, 0.0)), modes, 9, 0.2)
    first = state.search.before.clocks
    np.testing.assert_allclose(first.log[0], fresh.clocks.within(0, modes[0][0], 0.16).log[0])
    assert (np.flatnonzero(first.log[0] > OUTSIDE)[[0, -1]] < [400, 430]).all()
    np.testing.assert_array_equal(first.log[1:], before.clocks.log[1:])
    assert (state.clocks.log[1] > OUTSIDE).sum() == 10
    begun = replace(now, search=replace(search, before=replace(before, time_s=None)))
    (state, _), *_ = branches(begun, with_peaks(now, (0, 405, 0.0), (1, 405, 0.0)), modes, 9, 0.2)
    np.testing.assert_allclose(
        state.search.before.clocks.log[0], fresh.clocks.within(0, modes[0][0], 0.12).log[0]
    )


def test_the_likeliest_combinations_of_many_clocks_are_those_of_a_full_list():
    draw = np.random.default_rng(1)
    likely = [list(np.log(draw.dirichlet(np.ones(count)))) for count in (3, 1, 4, 2, 5)]
    picks = product(*(range(len(own)) for own in likely))
    whole = [(sum(own[k] for own, k in zip(likely, pick, strict=True)), pick) for pick in picks]
    expected = sorted(whole, key=lambda choice: -choice[0])[:20]
    found = likeliest_choices(likely, 20)
    assert [pick for _, pick in found] == [pick for _, pick in expected]
    np.testing.assert_allclose([log for log, _ in found], [log for log, _ in expected])
    assert len(likeliest_choices([[-1.0] * 6] * 12, 48)) == 48  # 6^12 of them are never listed


def test_hypotheses_far_behind_go_and_so_do_those_that_have_become_the_same(fresh):
    def with_clock(offset_m, searched=False):
        belief = fresh.belief
        for device, place in zip(belief.layout.devices[:4], (0.0, 1.0, 2.0, offset_m), strict=True):
            belief = belief.independent(int(device), place, 1.0)
        unset = np.array([searched, False, False, False])
        return replace(fresh, belief=belief, clocks=replace(fresh.clocks, unset=unset))

    states = [with_clock(3.0), with_clock(3.2), with_clock(8.0), with_clock(30.0), with_clock(3.1, True)]
    population = Population.of(fresh).having(states, [0.0, -1.0, -2.0, -HOPELESS - 1, -3.0])
    left = reduced(population)
    assert left.states == (states[0], states[2], states[4])
    whole = np.exp([0.0, -1.0, -2.0, -3.0])
    together = np.array([whole[0] + whole[1], whole[2], whole[3]])  # weights of those that are one are added
    np.testing.assert_allclose(left.weights, together / whole.sum(), rtol=1e-12)
    np.testing.assert_array_equal(unset_clocks(left), [False, False, False, True])
    elsewhere = replace(states[1], belief=moved(states[1].belief))
    both = Population.of(fresh).having([states[0], elsewhere], [0.0, -1.0])
    assert reduced(both) is both


def moved(belief):
    mean = belief.mean.copy()
    mean[belief.layout.pose(1).start] += 3.0
    return replace(belief, mean=mean)


def test_departures_are_missed_only_where_something_was_heard():
    scene = gs.Scene.load("exchange")
    scans = simulate_network(scene, AGENTS[:1], 1, unlabelled=True)[0].scan(0).scans
    blind = [replace(scan, aod_rad=np.full(len(scan), np.nan)) for scan in scans]
    assert not tells_no_departure(scans)
    assert tells_no_departure([None, *blind])
    assert not tells_no_departure([None])


@pytest.mark.slow
def test_a_wall_behind_an_anchor_isn_t_taken_for_it():
    """Seed 6: a wall two metres behind an anchor set its clock 13 ns off, for good."""
    whole = gs.Scene.load("exchange").model_dump(exclude_none=True)
    whole["radio"] |= {"measures": ["distance", "aoa"], "false_alarms": 1.25}
    whole["filter"]["particles"] = 500
    for agent in whole["agents"]:
        agent["steps"] = 10
    scene = gs.Scene.checked(whole, "test")
    data, truth = simulate_network(scene, ["agent1"], 6)
    run = map_network(scene, data, seed=6)
    assert run.clocks.unset[0].any()
    assert np.abs(without_common(run.clocks.errors(truth.clocks))[5:]).max() < 3e-9
    assert not run.clocks.unset[5:].any()
