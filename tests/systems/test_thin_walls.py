"""A thin wall that is heard from both its sides stays a wall in the cells."""

import numpy as np
import pytest

import gridslam as gs

FLAT = """
[radio]
snr_at_1m_db = 38
[grid]
x_m = [-1.0, 11.0]
y_m = [-1.0, 7.0]
cell_m = 0.1
[materials]
concrete = 0.7
plaster = 0.5
[filter]
particles = 300
[[anchors]]
name = "A"
position_m = [0.4, 0.4]
orientation_deg = 45
[[anchors]]
name = "B"
position_m = [9.6, 0.6]
orientation_deg = 135
[[walls]]
name = "around"
material = "concrete"
points_m = [[0, 0], [10, 0], [10, 6], [0, 6], [0, 0]]
[[walls]]
name = "between"
material = "plaster"
points_m = [[4.5, 2.0], [4.5, 6.0]]
[[agents]]
name = "me"
start_m = [1.0, 4.0]
start_heading_deg = -30
waypoints_m = [[4.5, 1.2], [8.8, 4.2]]
step_m = 0.08
"""


@pytest.mark.slow
def test_no_gap_in_a_wall_that_both_sides_hear():
    scene = gs.Scene.from_toml(FLAT, "flat")
    run = gs.map_scene(scene, gs.simulate(scene, "me", seed=3), seed=3, start="exact")
    found = run.map
    beside = 4.5 + np.array([-0.15, -0.05, 0.05, 0.15])
    gaps = []
    for y in np.arange(2.45, 5.2, 0.1):
        cell, _ = found.index(np.stack([beside, np.full(4, y)], axis=-1))
        gaps.append(bool((found.evidence[cell[:, 0], cell[:, 1]] < -1).all()))
    assert not any(gaps), gaps
