"""An agent that walks past an anchor within centimetres claims no more than its linearisation is good for."""

import numpy as np
import pytest
from scene_samples import ENOUGH

import gridslam as gs

PASSES_M = 0.03


@pytest.fixture(scope="module")
def scene():
    data = gs.Scene.load("room").with_filter(particles=ENOUGH).model_dump(exclude_none=True)
    agent = {**data["agents"][0], "start_m": (-2.0, -1.4), "waypoints_m": ((2.0, -1.4),), "steps": 60}
    anchors = [{**data["anchors"][0], "position_m": (-0.9, -1.4 + PASSES_M)}, data["anchors"][1]]
    return gs.Scene.checked({**data, "anchors": anchors, "agents": [agent]}, "close")


@pytest.mark.slow
@pytest.mark.parametrize("system", [gs.GridSlam, gs.AdaptiveSlam])
def test_errors_beside_an_anchor_are_as_large_as_claimed(scene, system):
    nees, unwell, nearest = [], 0, []
    for seed in (1, 2):
        slam, track = system(scene, seed=seed), scene.track("agent1").position_m
        for at, scan in zip(track, gs.simulate(scene, "agent1", seed=seed), strict=True):
            estimate, away = slam.step(scan), np.linalg.norm(at - scene.anchor_positions[0])
            error = estimate.position_m - at
            unwell += not estimate.health.ok
            nearest.append(away)
            if away < 0.3:
                nees.append(error @ np.linalg.solve(estimate.covariance[:2, :2], error))
    assert min(nearest) < 1.2 * PASSES_M
    assert len(nees) >= 20
    assert max(nees) < 20
    assert unwell == 0
