"""What true paths tell: slopes of distance and angles by the joint state, and the information in them.

The joint state is [x, y, vx, vy, heading, angle_1, offset_1, ...], as in `gridslam.evaluation.bounds`;
docs/model.md, (M47).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.layout import AGENT, POSE
from gridslam.simulation.image_source import TruePaths
from gridslam.world.geometry import lean, level_of, trace, unit
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory


def surface_lines(scene: Scene) -> Array:
    """Line of every surface of ``scene.segments()``, (S, 2): normal angle (rad), offset (m)."""
    walls = scene.segments()
    if not len(walls):
        return np.zeros((0, 2))
    return walls.line[np.unique(walls.surface, return_index=True)[1]]


def whitened_jacobian(
    scene: Scene, agent: str, paths: TruePaths, surface: NDArray[np.intp], track: Trajectory | None = None
) -> Array:
    """Derivative of (distance, AoD, AoA) of each path by the joint state, over its standard deviations.

    Arguments and what is returned: see `path_jacobian`.
    """
    jacobian, signal = path_jacobian(scene, agent, paths, surface, track), scene.signal_model(agent)
    anchors = signal.anchor_aperture[paths.anchor]
    steep = lean(paths.distance_m, scene.verticals(agent).heights(paths.over, paths.anchor))
    std = (
        signal.distance_std(paths.amplitude),
        signal.angle_std(paths.amplitude, paths.aod_rad, anchors, steep),
        signal.angle_std(paths.amplitude, paths.aoa_rad, signal.agent_aperture, steep),
    )
    measured = [quantity in signal.measures for quantity in ("distance", "aod", "aoa")]
    return jacobian / np.where(measured, np.stack(std, -1), np.inf)[:, :, None]


def path_jacobian(
    scene: Scene, agent: str, paths: TruePaths, surface: NDArray[np.intp], track: Trajectory | None = None
) -> Array:
    """Derivative of (distance, AoD, AoA) of each path by the joint state.

    Parameters
    ----------
    surface : (S,) int, rising
        The surfaces in the state; they hold every one that the paths hit.
    track : Trajectory, optional
        Another way than the scene's.

    Returns
    -------
    (L, 3, 5 + 2 S)
    """
    track = scene.track(agent) if track is None else track
    hit = np.append(scene.segments().surface, -1)[paths.segment]
    double = paths.bounces == 2
    last = np.where(double, hit[:, 1], hit[:, 0])
    lines = surface_lines(scene) if len(scene.walls) else np.zeros((1, 2))
    heights = scene.verticals(agent).heights(paths.over, paths.anchor)
    geometry = trace(
        track.position_m[paths.step],
        scene.anchor_positions[paths.anchor],
        lines[np.maximum(last, 0)],
        lines[np.maximum(hit[:, 0], 0)],
        paths.bounces,
        heights,
    )
    jacobian = np.zeros((len(paths), 3, AGENT + 2 * len(surface)))
    jacobian[:, :, POSE] = geometry.jacobian[:, :, :3]
    for used, which, columns in ((paths.bounces > 0, last, (3, 4)), (double, hit[:, 0], (5, 6))):
        rows = np.flatnonzero(used)
        slot = AGENT + 2 * np.searchsorted(surface, which[rows])
        for side, column in enumerate(columns):
            jacobian[rows, :, slot + side] = geometry.jacobian[rows, :, column]
    return jacobian


def height_slopes(scene: Scene, agent: str, paths: TruePaths) -> Array:
    """Derivative of (distance, AoD, AoA) of each path by unknown rises, over their deviations, (L, 3, G)."""
    ways, signal = scene.verticals(agent), scene.signal_model(agent)
    slopes = np.zeros((len(paths), 3, len(ways.rise_variance)))
    if slopes.size and "distance" in signal.measures:
        rise, heights = ways.rises(paths.over), ways.heights(paths.over, paths.anchor)
        rows = np.flatnonzero(rise >= 0)
        slope = heights / paths.distance_m / signal.distance_std(paths.amplitude)
        slopes[rows, 0, rise[rows]] = slope[rows]
    return slopes


def with_elevations(scene: Scene, agent: str, paths: TruePaths, rows: Array) -> Array:
    """Rows of `whitened_jacobian`, then derivatives by unknown rises, with a row for elevations.

    Both ends of a path see the same elevation; docs/model.md, (M301).

    Returns
    -------
    (L, 3 or 4, N + G)
        3 where no array measures elevations.
    """
    tall, signal, ways = height_slopes(scene, agent, paths), scene.signal_model(agent), scene.verticals(agent)
    whole = np.concatenate([rows, tall], 2)
    if not any(signal.elevated):
        return whole
    heights = ways.heights(paths.over, paths.anchor)
    level, length = level_of(paths.distance_m, heights), paths.distance_m
    by_length = rows[:, 0] * signal.distance_std(paths.amplitude)[:, None]
    slope = by_length * (-heights / (length * np.maximum(level, 1e-6)))[:, None]
    rise, by_rise = ways.rises(paths.over), np.zeros((len(paths), tall.shape[2]))
    known = np.flatnonzero(rise >= 0)
    by_rise[known, rise[known]] = (level / length**2)[known]
    std = signal.elevation_std(paths.amplitude, paths.anchor, lean(length, heights))
    weight = np.sqrt((1 / std**2).sum(1))
    more = np.concatenate([slope, by_rise], 1) * weight[:, None]
    return np.concatenate([whole, more[:, None]], 1)


def path_information(paths: TruePaths, rows: Array, steps: int, chance: Array) -> Array:
    """Information that each step's paths give, (N, state, state), by the share `chance` (L,) that arrives."""
    gained = np.zeros((steps, rows.shape[2], rows.shape[2]))
    for row, step, weight in zip(rows, paths.step, chance, strict=True):
        gained[step] += weight * row.T @ row
    return gained


def hit_surfaces(scene: Scene, paths: TruePaths) -> NDArray[np.intp]:
    """Surfaces that some path hit, rising."""
    return np.unique(scene.segments().surface[paths.segment[paths.segment >= 0]])


def follow_hits(feet: Array, scene: Scene, paths: TruePaths, surface: NDArray[np.intp], line: Array) -> None:
    """Note where along its line each surface was hit last (tangential coordinate, m)."""
    owner = scene.segments().surface
    for bounce in range(2):
        rows = np.flatnonzero(paths.segment[:, bounce] >= 0)
        slot = np.searchsorted(surface, owner[paths.segment[rows, bounce]])
        tangent = unit(line[slot, 0] + 0.5 * np.pi)
        feet[slot] = (paths.points[rows, 1 + bounce] * tangent).sum(-1)
