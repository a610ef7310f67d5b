"""Scenes whose anchors are known to no better than is told, and agents that have walked there."""

import numpy as np
from scene_samples import shortened

import gridslam as gs

PLACE, TURN = 0.1, 3.0
"""Deviations, m and degrees."""


def stood(scene="room", steps=60, place=0.0, turn=0.0, aside=None):
    """A scene with deviations of its anchors, or with anchors that stand `aside` (J, 3; m, m, deg)."""
    data = shortened(gs.Scene.load(scene) if isinstance(scene, str) else scene, steps).model_dump(
        exclude_none=True
    )
    for number, anchor in enumerate(data["anchors"]):
        dx, dy, by = np.zeros(3) if aside is None else aside[number]
        x, y, *height = anchor["position_m"]
        anchor["position_m"] = [x + dx, y + dy, *height]
        anchor["orientation_deg"] = anchor.get("orientation_deg", 0.0) + by
        anchor |= {"position_std_m": place, "orientation_std_deg": turn}
    data["filter"]["particles"] = 300
    return gs.Scene.checked(data, data["name"])


def drawn(seed, place=PLACE, turn=TURN, anchors=2):
    return np.random.default_rng(seed).normal(0, [place, place, turn], (anchors, 3))


def stepped(steps=6, **told):
    """A filter some steps on."""
    scene = stood(steps=steps, **told)
    slam = gs.GridSlam(scene, seed=4)
    for scan in gs.simulate(stood(steps=steps, aside=drawn(64)), "agent1", 4):
        estimate = slam.step(scan)
    return slam, estimate
