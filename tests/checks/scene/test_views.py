"""Anchors in view, all walls at once, as wall by wall."""

import numpy as np

import gridslam as gs
from gridslam.checks.scene.views import in_view
from gridslam.simulation.occlusion import visible


def test_all_walls_at_once_hide_what_each_hides():
    scene, draw = gs.Scene.load("seminar"), np.random.default_rng(1)
    walls = scene.segments()
    low, high = walls.start.min(0), walls.start.max(0)
    start, end = draw.uniform(low, high, (2, 500, 2))
    end[:20] = walls.start[np.arange(20) % len(walls)]  # corners, and legs of no length
    start[20:40] = end[20:40]
    clear = in_view(start, end, walls)
    assert (clear[:20] | ~visible(start[:20], end[:20], walls)).all()
    assert (clear[20:] == visible(start[20:], end[20:], walls)).all()
    assert 0.5 < clear.mean() < 0.95
    assert in_view(start, end, scene.model_copy(update={"walls": ()}).segments()).all()
