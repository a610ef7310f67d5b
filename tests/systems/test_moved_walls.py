"""A map of the day before, since when a wall was moved: what it reflects now goes through where it stood."""

from dataclasses import replace

import numpy as np
import pytest
from map_samples import surfaces

import gridslam as gs
from gridslam.maps.contradictions import moved_walls
from gridslam.maps.map import Map

THEN_M, NOW_M = 1.0, -0.5
"""Where the wall stood, and where it stands: y, between x = -2 and 2, and now -3 and 3 m."""


def room():
    """A room of 14 by 10 m, whose inner wall the agent passes."""
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    data["radio"]["snr_at_1m_db"] = 36.0
    data["grid"].update(x_m=[-8.0, 8.0], y_m=[-6.0, 6.0])
    places = {"A": [-6.5, 4.4], "B": [6.4, 4.3]}
    data["anchors"] = [{"name": n, "position_m": p, "orientation_deg": -90.0} for n, p in places.items()]
    outer = [[-7.0, -5.0], [7.0, -5.0], [7.0, 5.0], [-7.0, 5.0]]
    inner = [[-3.0, NOW_M], [3.0, NOW_M]]
    data["walls"] = [
        {"material": "concrete", "points_m": outer, "closed": True},
        {"material": "concrete", "points_m": inner},
    ]
    own = {"start_m": [-4.8, 3.0], "waypoints_m": [[5.0, 3.0]], "step_m": 0.2, "steps": 45}
    data["agents"] = [data["agents"][0] | own]
    return gs.Scene.checked(data, "moved")


def yesterday(scene):
    """The map of the day before: sure of the outer walls, the inner wall as it stood, and free cells."""
    blank = Map.of_scene(scene)
    lines = [(0.0, 7.0), (np.pi, 7.0), (np.pi / 2, 5.0), (-np.pi / 2, 5.0), (np.pi / 2, THEN_M)]
    found = surfaces(lines, std=(1e-3, 1e-2), existence=0.999, reflection=0.7)
    extent = np.array([[-5.0, 5.0], [-5.0, 5.0], [-7.0, 7.0], [-7.0, 7.0], [-2.0, 2.0]])
    found = replace(found, extent_m=extent)
    evidence, coefficient = np.zeros(blank.shape), blank.coefficient.copy()
    y, x = 0.1 * (np.indices(blank.shape) + 0.5) + blank.origin_m[::-1, None, None]
    evidence[(np.abs(x) < 7) & (np.abs(y) < 5)] = -12.0
    wall = (np.abs(x) < 2) & (np.abs(y - THEN_M) < 0.15)
    wall |= (np.abs(np.abs(x) - 7) < 0.15) & (np.abs(y) < 5) | (np.abs(np.abs(y) - 5) < 0.15) & (
        np.abs(x) < 7
    )
    evidence[wall] = 12.0
    posterior = np.full((len(lines), coefficient.shape[-1]), 1 / coefficient.shape[-1])
    return replace(
        blank, evidence=evidence.astype(np.float32), observed=evidence != 0, surfaces=found,
        surface_reflection=posterior, coefficient=coefficient,
    )  # fmt: skip


@pytest.fixture(scope="module")
def maps():
    scene = room()
    first = yesterday(scene)
    slam = gs.GridSlam(scene, prior_map=first, seed=1, same_frame=True)
    for scan in gs.simulate(scene, "agent1", seed=1):
        slam.step(scan)
    return first, slam.map()


def beside(table, y):
    """Surfaces along y = const."""
    turned = np.abs(np.sin(table.line[:, 0])) > np.cos(0.05)
    return turned & (np.abs(table.line[:, 1] * np.sin(table.line[:, 0]) - y) < 0.05)


@pytest.mark.slow
def test_a_wall_behind_where_one_stood_is_found(maps):
    found = maps[1].surfaces
    assert beside(found, NOW_M).sum() == 1
    assert np.ptp(found.extent_m[beside(found, NOW_M)]) > 3.0


def test_the_wall_that_was_moved_is_gone_and_named(maps):
    first, later = maps
    assert beside(first.surfaces, THEN_M).any()
    assert not beside(later.surfaces, THEN_M).any()
    assert not (np.abs(later.wall_segments().ends_m[:, :, 1] - THEN_M) < 0.2).all(1).any()
    said = moved_walls(first, later, "one/map.h5")
    assert said is not None
    assert said.startswith("walls of one/map.h5 through which paths went since, ")
    assert "1.0) to (" in said


def test_walls_that_nobody_heard_stay_as_they_were_left(maps):
    first, later = maps
    assert sum(beside(later.surfaces, y).any() for y in (5.0, -5.0)) == 2
    far = first.index(np.array([[0.05, -4.95]]))[0][0]
    assert later.evidence[tuple(far)] == pytest.approx(12.0, abs=0.5)
