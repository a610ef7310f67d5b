"""What a double bounce over a corner explains as well bears no wall while it would move a vague pose."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.messages.birth_proposals import propose_births
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.network import double_births
from gridslam.inference.messages.network.double_births import KNOWN_M, without_double_bounces
from gridslam.inference.messages.path_prediction import predict_paths
from gridslam.inference.messages.ray_amplitudes import predict_amplitudes
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.simulation.network import simulate_network
from gridslam.systems.network import NetworkSlam
from gridslam.systems.network_grid import NetworkGridSlam
from gridslam.world.geometry import wrap


@pytest.fixture(scope="module")
def alcove():
    """A scene whose clocks are off, and what is measured there."""
    whole = gs.Scene.load("alcove").model_dump(exclude_none=True)
    whole["agents"][0]["steps"], whole["filter"]["particles"] = 3, 500
    whole["clocks"] = {"anchor_prior_ns": 20.0, "agent_prior_ns": 1.0}
    scene = gs.Scene.checked(whole, "test")
    return scene, simulate_network(scene, ["agent1"], 3)[0]


def proposed(alcove, corner, spread_m=0.3):
    """Births of anchor 0 from a pose of that deviation, and the rest of what is asked; as over a corner."""
    scene, data = alcove
    slam = NetworkSlam(scene, agents=["agent1"], seed=3)
    slam.step(data.scan(0))
    state, model, work = slam.state.part(0), slam.model.agents[0], slam.work[0]
    covariance = state.belief.covariance.copy()
    covariance[:2] = covariance[:, :2] = 0.0
    covariance[0, 0] = covariance[1, 1] = 0.5 * spread_m**2
    state = replace(state, belief=replace(state.belief, covariance=covariance))
    work.begin()
    scan = split_by_anchor(data.scan(1).scans[0], model)[0]
    if corner:  # it departs the way it arrives
        table, value = scan.table.copy(), scan.value.copy()
        value[:, 1] = table[:, 1] = wrap(value[:, 2] + state.belief.mean[4] - model.places[0, 2])
        scan = replace(scan, table=table, value=value)
    paths = predict_paths(state, 0, model, work=work)
    amplitudes = predict_amplitudes(state, paths, scan, model.radio, work=work)
    cloud, ratios = evaluate(scan, paths, np.ones(len(paths)), amplitudes, model.radio, model, work=work)
    senders = np.zeros(1, np.int32)
    births, ratios = propose_births(state, scan, cloud, ratios, model.radio, model, senders, work=work)
    return births, (state, scan, cloud, ratios, model.radio, model, senders), work


def test_what_departs_the_way_it_arrives_bears_less_than_what_a_mirror_sends(alcove):
    births, asked, work = proposed(alcove, corner=False)
    kept = without_double_bounces(births, *asked, work=work)
    corner, asked, work = proposed(alcove, corner=True)
    left = without_double_bounces(corner, *asked, work=work)
    assert len(births) > 2
    assert 0 < len(kept)
    assert len(left) / len(corner) < 0.5 * len(kept) / len(births)
    names = list(zip(left.measurement.tolist(), left.ratio.tolist(), strict=True))
    assert set(names) <= set(zip(corner.measurement.tolist(), corner.ratio.tolist(), strict=True))


def test_without_an_arrival_nothing_is_born_while_the_position_is_vague(alcove):
    births, (state, scan, *rest), work = proposed(alcove, corner=False)
    deaf = scan.table.copy()
    deaf[:, 5] = -1.0
    asked = state, replace(scan, table=deaf), *rest
    assert len(births)
    assert not len(without_double_bounces(births, *asked, work=work))
    births, (state, *_), work = proposed(alcove, corner=False, spread_m=0.9 * KNOWN_M)
    assert without_double_bounces(births, state, *asked[1:], work=work) is births


def test_known_poses_known_clocks_and_single_bounces_leave_births_as_they_are(alcove):
    births, asked, work = proposed(alcove, corner=True, spread_m=0.9 * KNOWN_M)
    assert without_double_bounces(births, *asked, work=work) is births
    births, (state, *rest), work = proposed(alcove, corner=True)
    known = replace(state, belief=replace(state.belief, clocks=0))
    assert without_double_bounces(births, known, *rest, work=work) is births
    alone = [*rest[:-2], replace(rest[-2], max_bounces=1), rest[-1]]
    assert without_double_bounces(births, state, *alone, work=work) is births


@pytest.mark.parametrize("system", [NetworkSlam, NetworkGridSlam])
def test_steps_put_doubtful_births_off(system, alcove, monkeypatch):
    """With every pose taken for known they'd end elsewhere."""
    scene, data = alcove

    def after():
        slam = system(scene, agents=["agent1"], seed=3)
        for scan in data:
            slam.step(scan)
        return slam.state.belief.mean

    put_off = after()
    monkeypatch.setattr(double_births, "KNOWN_M", np.inf)
    borne = after()
    assert len(put_off) != len(borne) or (put_off != borne).any()
