"""Network SLAM: several agents find themselves, each other's clocks, and whose each measurement is."""

import sys
from dataclasses import replace

import h5py
import numpy as np
import pytest

import gridslam as gs
from gridslam.errors import InputError
from gridslam.evaluation.network_scores import label_errors, without_common
from gridslam.inference.health.reasons import CLOCK_OPEN
from gridslam.runs.network_run import map_network
from gridslam.simulation.network import shared_air, simulate_network
from gridslam.systems.adaptive import AdaptiveSlam
from gridslam.systems.network import NetworkSlam, scans_of_teachers
from gridslam.world.network_scan import NetworkScan

AGENTS = ["agent1", "agent2", "agent3"]


def small(name, steps, particles=1000, **agents):
    whole = gs.Scene.load(name).model_dump(exclude_none=True)
    whole["filter"]["particles"] = particles
    for agent in whole["agents"]:
        agent["steps"] = steps
        agent.update(agents.get(agent["name"], {}))
    return whole


@pytest.fixture(scope="module")
def exchange():
    return gs.Scene.checked(small("exchange", 14), "test")


@pytest.fixture(scope="module")
def simulated(exchange):
    return simulate_network(exchange, AGENTS, 4, unlabelled=True)


@pytest.fixture(scope="module")
def run(exchange, simulated):
    return map_network(exchange, simulated[0], seed=4)


def test_one_agent_with_labels_and_known_clocks_is_adaptive_slam_bit_for_bit():
    room = gs.Scene.checked(small("room", 12), "test")
    network, adaptive = NetworkSlam(room, seed=2), AdaptiveSlam(room, seed=2)
    adaptive.branches = False  # one hypothesis, as in a network
    adaptive.now = adaptive.believing(replace(adaptive.state, leftovers=None))  # births by one step alone
    for scan in gs.simulate(room, "agent1", seed=2):
        ours, theirs = network.step(scan), adaptive.step(scan)
        np.testing.assert_array_equal(ours.position_m, theirs.position_m)
        np.testing.assert_array_equal(ours.covariance, theirs.covariance)
        np.testing.assert_array_equal(ours.surfaces.existence, theirs.surfaces.existence)
        np.testing.assert_array_equal(ours.paths.amplitude, theirs.paths.amplitude)


def test_positions_clocks_and_labels_are_found_at_once(run, simulated):
    data, truth = simulated
    for name in AGENTS:
        error = run.runs[name].trajectory.position_m - data.tracks[name].position_m
        assert np.linalg.norm(error[5:], axis=1).max() < 0.3
    error = without_common(run.clocks.errors(data.clocks))
    assert np.abs(error[5:]).max() < 3e-9
    assert not run.clocks.unset[5:].any()
    wrong, judged = label_errors(run.anchor, truth.source)
    assert judged > 300
    assert wrong <= 0.02 * judged
    assert len(next(iter(run.runs.values())).surfaces) == 4


def test_scores_say_what_can_be_known(run, simulated):
    data, truth = simulated
    scores = run.score(data.clocks, truth)
    assert 0 < scores["bound_ps"] < 400
    assert scores["apparent_bias_rmse_ps"] < 3 * scores["bound_ps"]
    assert set(scores["steps_to_synchronise"]) == {"A", "B", "C", "D"}
    assert all(value is None for value in run.score().values())


def test_a_lone_agent_with_labels_finds_the_clocks():
    """What 5 ns of one clock cost adaptive SLAM was 0.6 m."""
    whole = small("room", 14)
    whole["agents"], whole["clocks"] = whole["agents"][:1], {"anchor_prior_ns": 20.0}
    whole["anchors"][0]["clock"], whole["radio"]["window_m"] = {"offset_ns": 5.0}, (-10.0, 60.0)
    scene = gs.Scene.checked(whole, "room")
    data, _ = simulate_network(scene, ["agent1"], 1)
    run = map_network(scene, data, seed=1)
    error = run.runs["agent1"].trajectory.position_m - data.tracks["agent1"].position_m
    assert np.linalg.norm(error[5:], axis=1).max() < 0.15
    assert np.abs(without_common(run.clocks.errors(data.clocks)))[5:].max() < 0.5e-9


def test_order_of_rows_within_a_step_changes_nothing(exchange, simulated):
    slams = [NetworkSlam(exchange, agents=AGENTS, seed=4) for _ in range(2)]
    for step in range(4):
        scan = simulated[0].scan(step)
        turned = tuple(
            replace(one, **{key: value[::-1] for key, value in columns(one).items()}) for one in scan.scans
        )
        estimates = slams[0].step(scan), slams[1].step(replace(scan, scans=turned))
        for name in AGENTS:
            one, other = (estimate.agents[name].position_m for estimate in estimates)
            np.testing.assert_allclose(one, other, atol=1e-4)


def columns(scan):
    return {key: value for key, value in vars(scan).items() if isinstance(value, np.ndarray)}


@pytest.mark.slow
def test_a_checkpoint_goes_on_bit_for_bit(exchange, simulated, tmp_path):
    slam = NetworkSlam(exchange, agents=AGENTS, seed=4)
    for step in range(3):
        slam.step(simulated[0].scan(step))
    slam.save(tmp_path / "three.h5")
    again = NetworkSlam.resume(tmp_path / "three.h5")
    assert again.agent == "agent1,agent2,agent3"
    again_before = again.state
    one, other = slam.step(simulated[0].scan(3)), again.step(simulated[0].scan(3))
    np.testing.assert_array_equal(one.offset_covariance_s2, other.offset_covariance_s2)
    for name in AGENTS:
        np.testing.assert_array_equal(one.agents[name].covariance, other.agents[name].covariance)
    assert slam.now.identity == again.now.identity
    with h5py.File(tmp_path / "three.h5", "r+") as file:  # as an earlier version wrote it
        believed = file["believed"]
        believed.attrs["class"] = "NetworkPopulation"
        for name in ("searching", "waited", "guard", "since"):
            del believed.attrs[name]
        del believed["watch"]
        del believed["states/0/records/0/monitor"].attrs["lost"]
    np.testing.assert_array_equal(NetworkSlam.resume(tmp_path / "three.h5").state.los, again_before.los)
    population, (state,) = slam.now.believed, slam.now.believed.states
    wrong = replace(state, belief=replace(state.belief, mean=np.full_like(state.belief.mean, np.nan)))
    for spoilt in (replace(population, log_weight=(-1.0,)), replace(population, states=(wrong,))):
        with pytest.raises(gs.InputError, match=r"log_weight|mean"):
            slam.require_sound(spoilt, slam.model, "here.h5")


@pytest.mark.slow
def test_an_agent_that_isn_t_there_has_no_misses_and_joins_later():
    scene = gs.Scene.checked(small("exchange", 9, agent2={"present_s": (4.0, 7.0)}), "test")
    data, _ = simulate_network(scene, AGENTS, 1, unlabelled=True)
    slam = NetworkSlam(scene, agents=AGENTS, seed=1)
    for scan in data:
        before = slam.state
        estimate = slam.step(scan)
        assert (estimate.agents["agent2"] is not None) == (4 <= scan.step <= 7)
        if scan.scans[1] is None:
            own = slam.state.belief.layout.pose(1)
            np.testing.assert_allclose(slam.state.belief.mean[own][4:], before.belief.mean[own][4:], atol=0.3)
            np.testing.assert_array_equal(slam.state.los[4:8], before.los[4:8])
    error = slam.state.belief.mean[own][:2] - data.tracks["agent2"].position_m[-1]
    assert np.linalg.norm(error) < 0.3


@pytest.mark.slow
def test_a_clock_that_jumps_is_found_again():
    whole = small("exchange", 16)
    whole["anchors"][1]["clock"] |= {"jump_s": 8.0, "jump_ns": 60.0}
    scene = gs.Scene.checked(whole, "test")
    data, _ = simulate_network(scene, AGENTS, 2, unlabelled=True)
    run = map_network(scene, data, seed=2)
    error = np.abs(without_common(run.clocks.errors(data.clocks))).max(1)
    assert (error[10:] < 3e-9).all()
    assert run.clocks.unset[8:10, 1].any() or error[8] < 3e-9


@pytest.mark.slow
def test_clocks_with_rates_are_followed():
    whole = small("exchange", 12)
    whole["clocks"] |= {"drift_prior_ppb": 25.0, "drift_walk_ppb": 0.03}
    whole["radio"]["window_m"] = (-200.0, 200.0)
    for device, rate in zip(whole["anchors"] + whole["agents"], (-5.0, 3, 5, -2, 20, -12, 7), strict=True):
        device["clock"] = device.get("clock", {}) | {"drift_ppb": rate}
        device["clock"].pop("zigzag_s", None)
    scene = gs.Scene.checked(whole, "test")
    data, _ = simulate_network(scene, AGENTS, 2, unlabelled=True)
    run = map_network(scene, data, seed=2)
    assert np.abs(without_common(run.clocks.errors(data.clocks))[6:]).max() < 3e-9


@pytest.mark.slow
def test_labels_may_be_known_of_some_rows_alone(exchange):
    data, truth = shared_air(exchange, AGENTS[:2], 3, sharing=4)
    label = np.where(np.arange(len(truth.source)) % 3 == 0, data.table.anchor, -1)
    partly = replace(data, table=replace(data.table, anchor=label, unlabelled=True))
    slam = NetworkSlam(exchange, agents=AGENTS[:2], seed=3)
    for step in range(3):
        estimate = slam.step(partly.scan(step))
    for name in AGENTS[:2]:
        own, given = partly.scan(2).scans[AGENTS.index(name)].anchor, estimate.anchor[name]
        np.testing.assert_array_equal(given[own >= 0], own[own >= 0])


def test_scans_that_make_no_sense_are_refused(exchange, simulated):
    slam = NetworkSlam(exchange, agents=AGENTS, seed=1)
    scan = simulated[0].scan(0)
    first = scan.scans[0]
    for bad, says in (
        (NetworkScan(0, 0.0, scan.scans[:2]), "2 agents; allowed: 3"),
        (NetworkScan(0, 1.0, scan.scans), "step 0 at 0.0 s"),
        (NetworkScan(0, float("nan"), (None,) * 3), "time_s: found nan"),
        ("nonsense", "a NetworkScan"),
        (replace(scan, scans=(replace(first, anchor=first.anchor + 6), None, None)), "anchor"),
    ):
        with pytest.raises(InputError, match=says):
            slam.step(bad)
    assert slam.state.step == 0
    slam.step(NetworkScan(4, 4.0, (None,) * 3))
    with pytest.raises(InputError, match=r"found 3\.0; allowed: later than 4\.0"):
        slam.step(NetworkScan(5, 3.0, (None,) * 3))
    for names, says in ((["agent1", "agent1"], "twice"), (["nobody"], "nobody"), ([], "none")):
        with pytest.raises(InputError, match=says):
            NetworkSlam(exchange, agents=names)


def work_of(scene, scans, seed):
    """Arrays that kernels are handed by steps of a filter, from the ninth step on: what a step costs."""
    slam, handed = NetworkSlam(scene, seed=seed, agents=AGENTS[: len(scans[0].scans)]), 0

    def count(frame, event, what):
        nonlocal handed
        handed += event == "c_call" and what.__name__ == "set_arg_external_array_with_shape"

    for number, scan in enumerate(scans):
        if number == 8:  # clocks are set by then, and no rivals of theirs are followed any more
            sys.setprofile(count)
        slam.step(scan)
    sys.setprofile(None)
    return handed


@pytest.mark.slow
def test_three_agents_cost_about_three_times_what_one_does(exchange, simulated):
    scans = list(simulated[0])[:11]
    alone = [NetworkScan(scan.step, scan.time_s, scan.scans[:1]) for scan in scans]
    one, three = work_of(exchange, alone, 1), work_of(exchange, scans, 1)
    assert 0 < three < 4 * one  # more births among them: several views of each wall


def astray(scans, agent, first):
    """The same, but that an agent hears another world from a step on."""
    for number, scan in enumerate(scans):
        own = scan.scans[agent]
        if number >= first:
            own = replace(
                own, aoa_rad=-own.aoa_rad, aod_rad=own.aod_rad[::-1], distance_m=own.distance_m + 90
            )
        yield replace(scan, scans=(*scan.scans[:agent], own, *scan.scans[agent + 1 :]))


def without(scans, agent, first):
    """The same without an agent from a step on."""
    for number, scan in enumerate(scans):
        own = scan.scans[agent] if number < first else None
        yield replace(scan, scans=(*scan.scans[:agent], own, *scan.scans[agent + 1 :]))


@pytest.mark.slow
def test_a_lost_agent_teaches_the_others_nothing(exchange, simulated):
    scans, first = list(simulated[0]), 9
    lost, gone = (NetworkSlam(exchange, seed=1, agents=AGENTS) for _ in range(2))
    for number, (one, other) in enumerate(
        zip(astray(scans, 1, first), without(scans, 1, first), strict=True)
    ):
        ours, theirs = lost.step(one), gone.step(other)
        if number >= first:
            assert "isn't used" in ours.agents["agent2"].health.why
            for name in ("agent1", "agent3"):
                np.testing.assert_allclose(
                    ours.agents[name].position_m, theirs.agents[name].position_m, atol=1e-6
                )
                assert "isn't used" not in ours.agents[name].health.why
    own = lost.state.belief.layout.devices[:4]
    np.testing.assert_allclose(lost.state.belief.mean[own], gone.state.belief.mean[own], atol=1e-6)
    assert len(lost.state.surfaces) == len(gone.state.surfaces)
    np.testing.assert_allclose(lost.state.surfaces.existence, gone.state.surfaces.existence, atol=1e-6)


def test_agents_that_are_lost_say_nothing_of_clocks_until_enough_is_heard_or_long_nothing_tells(
    exchange, simulated
):
    scan, state = simulated[0].scan(0), NetworkSlam(exchange, seed=1, agents=AGENTS).state
    lost = state.records[1].monitor.still_lost()
    assert scans_of_teachers(state, scan) == list(scan.scans)
    assert scans_of_teachers(state.recorded(1, lost), scan) == [scan.scans[0], None, scan.scans[2]]
    assert not lost.followed(4, 3).astray
    assert lost.followed(0, 0) is lost
    few = lost
    for _ in range(19):
        few = few.followed(2, 2)
        assert few.astray
    assert not few.followed(2, 2).astray


@pytest.mark.slow
@pytest.mark.parametrize("labelled", [True, False])
def test_agents_whose_clocks_are_as_wide_as_anchors_find_each_other_and_claim_no_common_time(labelled):
    """Differences are right, and what nothing observes stays as wide as priors leave it."""
    whole = small("exchange", 8, particles=500)
    whole["clocks"]["agent_prior_ns"] = 50.0
    for agent, offset in zip(whole["agents"], (-31.0, 44.0), strict=False):
        agent["clock"] = {"offset_ns": offset}
    scene = gs.Scene.checked(whole, "test")
    data, _ = simulate_network(scene, AGENTS[:2], 3, unlabelled=not labelled)
    run = map_network(scene, data, seed=3)
    error, last = run.clocks.errors(data.clocks)[-1], run.clocks.covariance_s2[-1]
    apart = error[:4, None] - error[4:]
    variance = np.diag(last)
    claimed = np.sqrt(variance[:4, None] + variance[4:] - 2 * last[:4, 4:])
    assert np.abs(apart / np.maximum(claimed, 0.1e-9)).max() < 4
    assert np.abs(apart).max() < 2e-9
    assert np.sqrt(variance).min() > 10e-9
    assert np.abs(error / np.sqrt(variance)).max() < 3
    said = "; ".join(one.health.why for name in AGENTS[:2] for one in run.runs[name].estimates)
    assert "turned" not in said


@pytest.mark.slow
def test_a_clock_that_nothing_ties_to_the_time_is_said_to_be_open():
    """One agent that hears no anchor has no clock, and health says so; with the first anchor it has one."""
    whole = small("exchange", 8, particles=300)
    whole["agents"] = whole["agents"][:1]
    whole["clocks"] |= {"agent_prior_ns": 50.0, "reference": "A"}
    whole["anchors"][0]["clock"] = {"offset_ns": 0.0}
    scene = gs.Scene.checked(whole, "test")
    data, _ = simulate_network(scene, AGENTS[:1], 3)
    slam = NetworkSlam(scene, agents=AGENTS[:1], seed=3)
    scans = [data.scan(step) for step in range(8)]
    open_clocks = slam.state.part(0).belief.covariance[5:9]
    assert np.count_nonzero(open_clocks) == 4  # independent of the pose and of each other
    deaf = replace(scans[0], scans=(only_anchor(scans[0].scans[0], -7),))
    assert CLOCK_OPEN in slam.step(deaf).agents["agent1"].health.why
    for scan in scans[1:]:
        health = slam.step(scan).agents["agent1"].health
    assert CLOCK_OPEN not in health.why
    assert np.sqrt(slam.state.belief.clock_offsets()[1][4, 4]) < 1.5


def only_anchor(scan, anchor):
    """The rows of a scan that are of one anchor."""
    rows = scan.anchor == anchor
    columns = {name: value[rows] for name, value in vars(scan).items() if isinstance(value, np.ndarray)}
    return replace(scan, **columns)
