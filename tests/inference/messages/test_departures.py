"""Departures of surfaces that double bounces may have borne don't bend clock and pose."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.network import departures
from gridslam.inference.messages.network.departures import (
    PROVEN,
    unproven,
    without_doubtful_departures,
)
from gridslam.inference.messages.path_prediction import predict_paths
from gridslam.inference.messages.ray_amplitudes import predict_amplitudes
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.kernels import UNMEASURED
from gridslam.simulation.network import simulate_network
from gridslam.systems.network import NetworkSlam
from gridslam.systems.network_grid import NetworkGridSlam


@pytest.fixture(scope="module")
def alcove():
    """A scene whose clocks are off, and what is measured there."""
    whole = gs.Scene.load("alcove").model_dump(exclude_none=True)
    whole["agents"][0]["steps"], whole["filter"]["particles"] = 4, 200
    whole["clocks"] = {"anchor_prior_ns": 20.0, "agent_prior_ns": 1.0}
    scene = gs.Scene.checked(whole, "test")
    return scene, simulate_network(scene, ["agent1"], 3)[0]


@pytest.fixture(scope="module")
def evaluated(alcove):
    """State, paths of anchor 0, ratios and model, after three steps."""
    scene, data = alcove
    slam = NetworkSlam(scene, agents=["agent1"], seed=3)
    for step in range(3):
        slam.step(data.scan(step))
    state, model, work = slam.state.part(0), slam.model.agents[0], slam.work[0]
    work.begin()
    scan = split_by_anchor(data.scan(3).scans[0], model)[0]
    paths = predict_paths(state, 0, model, work=work)
    amplitudes = predict_amplitudes(state, paths, scan, model.radio, work=work)
    _, ratios = evaluate(scan, paths, np.ones(len(paths)), amplitudes, model.radio, model, work=work)
    return state, paths.rays, ratios, model


def test_a_surface_is_proven_by_two_anchors_or_by_ten_detections(evaluated):
    bank = evaluated[0].surfaces
    single, seen = np.full_like(bank.single, 0.5), np.full(len(bank), PROVEN - 1)
    single[:, 0], single[1, 1], seen[2] = 0.95, 0.95, PROVEN
    doubtful = unproven(replace(bank, single=single, seen=seen))
    assert doubtful[:4].tolist() == [False, True, False, True]


def test_only_single_bounces_over_unproven_surfaces_lose_their_departure(evaluated):
    state, rays, ratios, model = evaluated
    bank = state.surfaces
    alone = np.zeros_like(bank.single)
    young = np.where(np.arange(len(bank)) == 0, 0, PROVEN)
    state = replace(state, surfaces=replace(bank, single=alone, seen=young))
    pairs, count = without_doubtful_departures(ratios, rays, state, model).pairs, len(ratios.pairs)
    path = ratios.pairs.index[:count, 0]
    lost = (rays.bounces[path] == 1) & (rays.last[path] == 0)
    assert lost.any()
    assert not lost.all()
    np.testing.assert_array_equal(pairs.pair[:count, 4] == UNMEASURED, lost)
    before = ratios.pairs.pair[:count]
    np.testing.assert_array_equal(np.delete(pairs.pair[:count], 4, 1), np.delete(before, 4, 1))
    np.testing.assert_array_equal(pairs.pair[:count][~lost], before[~lost])


def test_where_no_clock_can_yield_or_nothing_bounces_twice_departures_count(evaluated):
    state, rays, ratios, model = evaluated
    young = replace(state.surfaces, single=np.zeros_like(state.surfaces.single), seen=0 * state.surfaces.seen)
    state = replace(state, surfaces=young)
    assert without_doubtful_departures(ratios, rays, state, model) is not ratios
    assert without_doubtful_departures(ratios, rays, state, replace(model, max_bounces=1)) is ratios
    proven = replace(state, surfaces=replace(young, seen=young.seen + PROVEN))
    assert without_doubtful_departures(ratios, rays, proven, model) is ratios
    known = replace(state, belief=replace(state.belief, clocks=0))
    assert without_doubtful_departures(ratios, rays, known, model) is ratios


@pytest.mark.parametrize("system", [NetworkSlam, NetworkGridSlam])
def test_steps_leave_doubtful_departures_out(system, alcove, monkeypatch):
    """With every surface taken for proven they'd end elsewhere."""
    scene, data = alcove

    def after(steps):
        slam = system(scene, agents=["agent1"], seed=3)
        for step in range(steps):
            slam.step(data.scan(step))
        return slam.state.belief.mean

    doubted = after(2)
    monkeypatch.setattr(departures, "PROVEN", 0)
    proven = after(2)
    assert len(proven) == len(doubted)
    assert (proven != doubted).any()
