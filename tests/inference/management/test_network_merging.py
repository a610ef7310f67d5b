"""Surfaces that several agents share: as many as the joint belief takes, and not without a word."""

import pytest

import gridslam as gs
from gridslam.inference.management.network.merging import merge_and_prune_shared
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
