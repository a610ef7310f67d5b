"""Surfaces that several agents share: as many as the joint belief takes, and not without a word."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.management.merging import merge
from gridslam.inference.management.network.merging import merge_and_prune_shared
from gridslam.inference.state.population import Population
from gridslam.inference.state.rays import Rays
from gridslam.systems import network


@pytest.mark.slow
def test_surfaces_left_out_for_want_of_room_are_told(monkeypatch):
    """Of four walls that are believed in, two find room: every agent that is there says so."""
    scene = gs.Scene.load("exchange").with_filter(particles=300, adapt_particles=False)
    names = ["agent1", "agent2"]
    slam, left = gs.NetworkSlam(scene, seed=1, agents=names), []

    def few(state, model, infos):
        before = int((state.surfaces.existence > 0.5).sum())
        state, infos_after = merge_and_prune_shared(state, model, infos, most=2)
        left.append(before - len(state.surfaces))
        return state, infos_after

    for number, scan in enumerate(gs.simulate(scene, names, seed=1)):
        if number == 8:
            monkeypatch.setattr(network, "merge_and_prune_shared", few)
        estimate = slam.step(scan)
        if number == 8:
            break
    assert left[0] > 0
    for one in estimate.agents.values():
        assert not one.health.ok
        assert f"{left[0]} surfaces left out for want of room" in one.health.why


@pytest.mark.parametrize("agent", [0, 1])
def test_surfaces_that_a_lost_agent_alone_knows_arent_held_against_those_of_all(agent, monkeypatch):
    """Those born over one anchor are heard over the next, and go with its turn: rows that nobody else has."""
    scene = gs.Scene.load("annex").with_filter(particles=300, adapt_particles=False)
    names, taught = ["agent1", "agent2"], []
    slam = gs.NetworkSlam(scene, seed=1, agents=names)
    row = np.array([7, 8])
    rays = Rays.of(0, 1, row, row, np.ones(2), np.ones(2))
    heard = SimpleNamespace(rays=rays, responsible=np.eye(2), anchor=0)

    def always(bank, belief, apart):
        apart()
        return merge(bank, belief, apart)

    def with_its_own(state, model, infos):
        taught.append([info.teaches for info in infos])
        both = [info if info.teaches else replace(info, exchanges=(heard,)) for info in infos]
        return merge_and_prune_shared(state, model, both)[0], infos

    monkeypatch.setattr("gridslam.inference.management.network.merging.merge", always)
    monkeypatch.setattr(network, "recover_agents", lambda state, *_: state)
    monkeypatch.setattr(network, "merge_and_prune_shared", with_its_own)
    monitor = slam.state.records[agent].monitor.still_lost()
    slam.now = slam.now._replace(believed=Population.of(slam.state.recorded(agent, monitor)))
    estimate = slam.step(next(iter(gs.simulate(scene, names, seed=1))))
    assert "isn't used" in estimate.agents[names[agent]].health.why
    assert taught[0] == [agent != 0, agent != 1]
    assert len(slam.state.surfaces) < 7
