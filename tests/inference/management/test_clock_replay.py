"""Steps of a search for clocks are taken again once one is set: phantom walls of its anchor are undone."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.inference.management.network import clock_replay
from gridslam.inference.management.network.clock_replay import (
    WALL_M,
    WALL_RAD,
    mistakable,
    taken_again,
    with_clocks_of,
    with_walls_of,
)
from gridslam.inference.state.network.clock_search import SET_VARIANCE
from gridslam.inference.state.network.state import ClockSteps
from gridslam.inference.state.surface_bank import FRESH_SINGLE
from gridslam.simulation.network import simulate_network
from gridslam.systems import network
from gridslam.systems.network import NetworkSlam

AGENTS = ["agent1", "agent2"]
HIDDEN, SILENT_STEPS = 3, 4
"""The anchor that isn't heard in the first steps, and how many these are."""


@pytest.fixture(scope="module")
def scene():
    return short("exchange", 12, particles=500)


@pytest.fixture(scope="module")
def scans(scene):
    data, truth = simulate_network(scene, AGENTS, 5, unlabelled=True)
    early = (truth.source == HIDDEN) & (data.table.step < SILENT_STEPS)
    return [thinned(data, early, step) for step in range(SILENT_STEPS + 4)]


def thinned(data, dropped, step):
    """A scan without some rows of its table."""
    rows = [~dropped[(data.table.step == step) & (data.agent == agent)] for agent in range(len(AGENTS))]
    whole = data.scan(step)
    return replace(whole, scans=tuple(only(own, keep) for own, keep in zip(whole.scans, rows, strict=True)))


def only(scan, rows):
    columns = {name: value[rows] for name, value in vars(scan).items() if isinstance(value, np.ndarray)}
    return replace(scan, **columns)


def until_set(slam, scans):
    """The filter before the step by which the last clock is set, that step's number, and what was believed
    before the first."""
    first = slam.state
    for number, scan in enumerate(scans):
        before = slam.state
        slam.step(scan)
        if not slam.state.clocks.unset.any():
            return first, before, number
    raise AssertionError("the clock wasn't set")


def told_by_hand(slam, before, number, scans):
    """The states that a filter has which is told the clock, and then the walls, before the first step."""
    alone, _ = network.step(before, scans[number], slam.model, slam.work)  # the step that sets it
    walked = slam.model.clocks.walk_m**2 * (scans[number].time_s - scans[0].time_s)
    start = with_clocks_of(alone, before.search.before, SET_VARIANCE + walked)
    once = stepped_through(start, scans[: number + 1], slam)
    return alone, once, stepped_through(with_walls_of(once, start), scans[: number + 1], slam)


def stepped_through(state, scans, slam):
    for scan in scans:
        state, _ = network.step(state, scan, slam.model, slam.work)
    return state


@pytest.mark.slow
@pytest.mark.parametrize("mapped", [True, False])
def test_the_world_is_that_of_a_filter_told_clock_and_walls_before_the_first_step(
    scene, scans, mapped, monkeypatch
):
    if not mapped:
        monkeypatch.setattr(clock_replay, "with_walls_of", lambda after, before: before)
    slam = NetworkSlam(scene, agents=AGENTS, seed=5)
    _, before, number = until_set(slam, scans)
    assert number >= SILENT_STEPS
    assert len(before.search.scans) == number
    alone, once, twice = told_by_hand(slam, before, number, scans)
    given = twice if mapped else once
    np.testing.assert_array_equal(slam.state.belief.covariance, given.belief.covariance)
    np.testing.assert_array_equal(slam.state.los, given.los)
    assert slam.state.search is None
    assert (given.los != alone.los).any()
    head = once.belief.layout.head
    spread = np.diagonal(once.belief.covariance)[:head]
    assert np.abs(np.diagonal(twice.belief.covariance)[:head] / spread - 1).max() < 0.3  # little is told


@pytest.mark.slow
def test_walls_that_two_links_hear_are_told_roughly(scene, scans):
    slam = NetworkSlam(scene, agents=AGENTS, seed=5)
    for scan in scans:
        slam.step(scan)
    state = slam.state
    bank, fresh = state.surfaces, NetworkSlam(scene, agents=AGENTS, seed=5).state
    given = with_walls_of(state, fresh)
    assert len(given.surfaces) == 4
    assert given.next_identity == 4
    assert (given.surfaces.single == FRESH_SINGLE).all()
    entries = given.belief.layout.head + 2 * np.arange(4)
    across = given.belief.covariance[entries[:, None], entries]
    np.testing.assert_allclose(across, np.eye(4) * WALL_RAD**2)
    np.testing.assert_array_equal(given.belief.lines, state.belief.lines[bank.existence > 0.9])
    at_foot = np.array([[-given.surfaces.foot[0], 1.0]])
    first = slice(entries[0], entries[0] + 2)
    assert (at_foot @ given.belief.covariance[first, first] @ at_foot.T)[0, 0] == pytest.approx(WALL_M**2)
    assert len(with_walls_of(state, given).surfaces) == 4 + (bank.identity >= 4).sum()
    single = np.where(np.arange(len(bank.single))[:, None] == 0, bank.single, 0.1)
    phantoms = replace(state, surfaces=replace(bank, single=single))
    assert len(with_walls_of(phantoms, fresh).surfaces) == 0


@pytest.mark.slow
def test_only_modes_of_open_clocks_are_told(scene, scans):
    slam = NetworkSlam(scene, agents=AGENTS, seed=5)
    first, _, _ = until_set(slam, scans)
    half = replace(first, clocks=first.clocks.closed(0))
    given = with_clocks_of(slam.state, half, 2.0)
    devices = given.belief.layout.devices
    mean, variance = given.belief.mean[devices], np.diagonal(given.belief.covariance)[devices]
    later = slam.state.belief.mean[slam.state.belief.layout.devices]
    np.testing.assert_array_equal(mean[1:4], later[1:4])
    np.testing.assert_array_equal(variance[1:4], 2.0)
    assert mean[0] == first.belief.mean[devices[0]]
    np.testing.assert_array_equal(given.belief.mean[: devices[0]], first.belief.mean[: devices[0]])
    assert not given.clocks.unset.any()


@pytest.mark.slow
def test_a_world_that_explains_less_is_not_taken(scene, scans):
    slam = NetworkSlam(scene, agents=AGENTS, seed=5)
    _, before, number = until_set(slam, scans)
    alone, _ = network.step(before, scans[number], slam.model, slam.work)
    steps = replace(before.search, scans=scans[:2], log_evidence=1e9)
    assert taken_again(steps, alone, slam.model, slam.work, network.step) is None
    steps = replace(steps, log_evidence=-1e9)
    state, _, again = taken_again(steps, alone, slam.model, slam.work, network.step)
    assert state.step == 2
    assert again.log_evidence > 0


@pytest.mark.slow
def test_walls_are_told_only_if_that_explains_no_less(scene, scans, monkeypatch):
    slam = NetworkSlam(scene, agents=AGENTS, seed=5)
    _, before, number = until_set(slam, scans)
    alone, once, twice = told_by_hand(slam, before, number, scans)
    steps = replace(before.search, scans=tuple(scans[: number + 1]), log_evidence=0.0)
    for second, expected in ((0.0, once), (2.0, twice)):
        each = iter([1.0] * (number + 1) + [second] * (number + 1))
        monkeypatch.setattr(clock_replay, "evidence", lambda *_, each=each: next(each))
        state, _, again = taken_again(steps, alone, slam.model, slam.work, network.step)
        np.testing.assert_array_equal(state.belief.covariance, expected.belief.covariance)
        assert again.log_evidence == number + 1


@pytest.mark.slow
def test_walls_that_are_told_say_nothing_of_a_clock_that_is_searched_for(scene, scans):
    slam = NetworkSlam(scene, agents=AGENTS, seed=5)
    first, before, number = until_set(slam, scans)
    peak = np.abs(before.clocks.centre - 9.0) < 0.25
    opened = slam.state.clocks.opened(HIDDEN, slam.model.clocks).within(HIDDEN, peak)
    _, info = network.step(before, scans[number], slam.model, slam.work)
    state = replace(slam.state, clocks=opened)  # as every step leaves it
    steps = ClockSteps(first, tuple(scans[:1]), -1e9)
    given, _, _ = taken_again(steps, state, slam.model, slam.work, lambda *_: (state, info))
    entry = given.belief.layout.devices[HIDDEN]
    assert given.belief.mean[entry] == pytest.approx(9.0, abs=0.05)
    assert given.belief.covariance[entry, entry] < 0.1
    assert np.count_nonzero(given.belief.covariance[entry]) == 1
    assert np.count_nonzero(slam.state.belief.covariance[entry]) > 1


@pytest.mark.slow
def test_a_world_in_which_a_clock_is_doubted_again_is_not_taken(scene, scans):
    slam = NetworkSlam(scene, agents=AGENTS, seed=5)
    _, before, number = until_set(slam, scans)
    alone, _ = network.step(before, scans[number], slam.model, slam.work)

    def doubting(state, *args):
        state, info = network.step(state, *args)
        return replace(state, clocks=state.clocks.opened(HIDDEN, slam.model.clocks)), info

    steps = replace(before.search, log_evidence=-1e9)
    assert taken_again(steps, alone, slam.model, slam.work, doubting) is None


def test_evidence_of_all_steps_of_a_search_is_kept(scene, scans, monkeypatch):
    monkeypatch.setattr(clock_replay, "evidence", lambda *_: 3.0)
    slam = NetworkSlam(scene, agents=AGENTS, seed=5)
    for scan in scans[:3]:
        slam.step(scan)
    assert slam.state.search.log_evidence == 9.0


@pytest.mark.slow
def test_a_checkpoint_keeps_the_steps_of_a_search(scene, scans, tmp_path):
    slam = NetworkSlam(scene, agents=AGENTS, seed=5)
    for scan in scans[:2]:
        slam.step(scan)
    slam.step(replace(scans[2], scans=(scans[2].scans[0], None)))
    slam.save(tmp_path / "search.h5")
    again = NetworkSlam.resume(tmp_path / "search.h5")
    assert again.state.search.scans[2].scans[1] is None
    for scan in scans[3:]:
        slam.step(scan)
        again.step(scan)
    assert not again.state.clocks.unset.any()
    np.testing.assert_array_equal(again.state.belief.covariance, slam.state.belief.covariance)
    search = NetworkSlam.resume(tmp_path / "search.h5").state.search
    nowhere = replace(search.before.belief, mean=search.before.belief.mean * np.nan)
    spoilt = replace(search.before, belief=nowhere)
    others = NetworkSlam(scene, agents=AGENTS[:1], seed=5).state
    stray = replace(search.scans[0].scans[0], anchor=np.full(len(search.scans[0].scans[0]), 9))
    for wrong in (
        replace(search, before=spoilt),
        replace(search, before=others),
        replace(search, before=replace(search.before, los=others.los)),
        replace(search, before=replace(search.before, clocks=only(search.before.clocks, slice(3)))),
        replace(search, before=replace(search.before, search=search)),
        replace(search, scans=(replace(search.scans[0], scans=(stray, None)),)),
    ):
        state = replace(slam.state, search=wrong)
        with pytest.raises(gs.InputError, match=r"here\.h5/states/0/search/(before|scans/0.*anchor)"):
            slam.require_sound(replace(slam.now.believed, states=(state,)), slam.model, "here.h5")
    state = NetworkSlam.resume(tmp_path / "search.h5").state
    slam.require_sound(replace(slam.now.believed, states=(state,)), slam.model, "here.h5")
    for wrong, says in (
        ({"search": replace(search, scans=())}, "search/scans: .*one step or more"),
        ({"time_s": None}, "time_s: .*last step of the search"),
        ({"search": replace(search, scans=search.scans[1::-1] + search.scans[2:])}, "scans: .*go back"),
        ({"search": replace(search, before=replace(search.before, time_s=1.5))}, "scans: .*go back"),
    ):
        with pytest.raises(gs.InputError, match=says):
            slam.require_sound(replace(slam.now.believed, states=(replace(state, **wrong),)), slam.model, "")


def test_a_long_search_remembers_its_latest_steps(scene, scans, monkeypatch):
    monkeypatch.setattr(clock_replay, "MOST_STEPS", 2)
    slam = NetworkSlam(scene, agents=AGENTS, seed=5)
    lengths = []
    for scan in scans[:SILENT_STEPS]:
        slam.step(scan)
        lengths.append(len(slam.state.search.scans))
    assert lengths == [1, 2, 1, 2]
    assert slam.state.search.before.step == 2


def test_nothing_is_remembered_where_nothing_can_be_mistaken(scene, scans):
    slam = NetworkSlam(scene, agents=AGENTS, seed=5)
    slam.step(scans[0])
    state, scan = slam.state, scans[0]
    assert mistakable(state, scan)
    assert not mistakable(replace(state, labelled=True), scan)
    blind = tuple(replace(own, aod_rad=np.full(len(own), np.nan)) for own in scan.scans)
    assert not mistakable(state, replace(scan, scans=blind))
    assert not mistakable(replace(state, belief=replace(state.belief, rates=5)), scan)
