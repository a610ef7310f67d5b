"""In which order a scene lists its anchors doesn't matter: the loudest is heard first, (M550)."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.estimates import Estimate
from gridslam.systems import grid

STEPS = 12


@pytest.mark.parametrize(
    ("system", "apart_m"),
    [(gs.AdaptiveSlam, 1e-9), (gs.VirtualAnchorSlam, 1e-9), (gs.GridSlam, 1e-3), (gs.NetworkGridSlam, 1e-3)],
)
def test_listed_the_other_way_round(system, apart_m):
    """Rays through cells are drawn anchor by anchor; otherwise it was 13 mm in the first step."""
    scene = gs.Scene.load("room").with_filter(particles=512)
    other = scene.model_copy(update={"anchors": scene.anchors[::-1]})
    here, there = system(scene, seed=1), system(other, seed=1)
    for scan in list(gs.simulate(scene, "agent1", 3))[:STEPS]:
        turned = replace(scan, anchor=len(scene.anchors) - 1 - scan.anchor)
        found = [of_agent(slam.step(heard)) for slam, heard in ((here, scan), (there, turned))]
        np.testing.assert_allclose(found[0].position_m, found[1].position_m, atol=apart_m)
    assert len(found[0].surfaces) == len(found[1].surfaces)


def test_of_samples_too():
    """Of `chamber` it was 31 mm."""
    scene = gs.Scene.load("chamber")
    here = gs.DirectGridSlam(scene, seed=1)
    there = gs.DirectGridSlam(scene.model_copy(update={"anchors": scene.anchors[::-1]}), seed=1)
    for scan in list(gs.simulate(scene, "agent1", 3, what="signal"))[:STEPS]:
        turned = replace(scan, samples=scan.samples[::-1].copy(), heard=scan.heard[::-1].copy())
        np.testing.assert_allclose(here.step(scan).position_m, there.step(turned).position_m, atol=4e-3)


def test_what_follows_has_them_in_the_order_of_the_scene():
    scene = gs.Scene.load("canyon")
    slam = gs.GridSlam(scene, seed=1)
    heard = next(iter(gs.simulate(scene, "agent1", 3)))
    for loudest in (0, 2):
        amplitude = heard.amplitude + 100.0 * (heard.anchor == loudest)
        _, info = grid.step(slam.state, replace(heard, amplitude=amplitude), slam.model, slam.work)
        assert [exchange.anchor for exchange in info.exchanges] == [0, 1, 2]


def of_agent(estimate):
    """The estimate of the only agent."""
    return estimate if isinstance(estimate, Estimate) else estimate.agents["agent1"]
