"""What follows from the parts of a scene: pieces of walls, tracks of agents, and the prior of a start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.world.geometry import Segments, surfaces_of
from gridslam.world.scene_parts import Agent, Anchor, Wall
from gridslam.world.trajectory import Trajectory
from gridslam.world.waypoints import smooth_track

LEAST_PRIOR = 1e-4
"""Half width of a start prior that a filter is told at least (m, m/s, rad)."""


def segments_of(walls: Sequence[Wall], materials: Mapping[str, float]) -> Segments:
    """Straight pieces of all walls, arcs as facets; collinear pieces share a surface.

    The coefficient of those that don't reflect is 0.
    """
    corners = [wall.corners for wall in walls]
    start = np.concatenate([np.zeros((0, 2)), *(points[:-1] for points in corners)])
    end = np.concatenate([np.zeros((0, 2)), *(points[1:] for points in corners)])
    wall = np.repeat(np.arange(len(corners)), [len(points) - 1 for points in corners]).astype(np.intp)
    coefficient = [materials[w.material] if w.material and w.reflects else 0.0 for w in walls]
    reflection = np.array(coefficient)[wall]
    curved = np.array([w.arc is not None for w in walls], dtype=bool)[wall]
    return Segments(start, end, reflection, surfaces_of(start, end), wall, np.where(curved, wall, -1))


def surface_names(walls: Sequence[Wall], pieces: Segments) -> list[str]:
    """What each surface of the pieces of walls is called, (S,): as the wall of its longest reflecting piece.

    A side of a polyline, or a facet of an arc, is counted in the wall's order, from 1 on. The surface's own
    number stands in for a wall without a name, and beside a name that several walls have.
    """
    length = np.linalg.norm(pieces.end - pieces.start, axis=1) + 1e6 * (pieces.reflection > 0)
    names = []
    for surface in range(int(pieces.surface.max(initial=-1)) + 1):
        piece = np.argmax(np.where(pieces.surface == surface, length, -1.0))
        own = np.flatnonzero(pieces.wall == pieces.wall[piece])
        wall = walls[pieces.wall[piece]]
        part = "facet" if wall.arc is not None else "side"
        which = f", {part} {piece - own[0] + 1}" if len(own) > 1 else ""
        names.append(f"{wall.name}{which}" if wall.name else "")
    once = {name for name in names if name and names.count(name) == 1}
    numbers = [f"surface {number + 1}" for number in range(len(names))]
    return [
        name if name in once else f"{name} ({number})" if name else number
        for name, number in zip(names, numbers, strict=True)
    ]


def mounting_std_of(anchors: Sequence[Anchor]) -> Array:
    """Deviations of the anchors' places (m) and orientations (rad), (J, 2)."""
    each = [(anchor.position_std_m, np.radians(anchor.orientation_std_deg)) for anchor in anchors]
    return np.array(each).reshape(-1, 2)


def require_known_places(scene: str, anchors: Sequence[Anchor], method: str) -> None:
    """Refuse places of anchors with deviations, for a method that takes them as they are.

    Raises
    ------
    InputError
        That of an anchor has one.
    """
    for number, anchor in enumerate(anchors):
        if anchor.position_std_m:
            where, found = f"{scene}: anchors[{number}].position_std_m", f"{anchor.position_std_m:g}"
            allowed = "0, or grid, adaptive or direct grid SLAM by correlated Gaussians, which find places"
            raise InputError(where, f"{found}, for {method}", allowed)


@lru_cache(maxsize=64)
def track_of(agent: Agent) -> Trajectory:
    """Track of an agent with waypoints, cut to its number of steps."""
    whole = smooth_track(agent.way, agent.step_m, agent.interval_s, agent.acceleration_mps2, agent.pauses)
    rows = slice(agent.steps)
    high = None if agent.height_m is None else np.full(len(whole.time_s[rows]), agent.height_m)
    return Trajectory(
        whole.time_s[rows], whole.position_m[rows], whole.velocity_mps[rows], whole.heading_rad[rows], high
    )


def start_prior(agent: Agent) -> tuple[Array, Array]:
    """Mean and variance of [x, y, vx, vy, heading] at the start, (5,) each; m, m/s, rad and their squares.

    Priors are uniform: a third of the half width squared.
    """
    prior = agent.prior
    half = np.array([prior.position_m] * 2 + [prior.velocity_mps] * 2 + [np.radians(prior.heading_deg)])
    variance = np.maximum(half, LEAST_PRIOR) ** 2 / 3
    # the agent moves at an unknown speed from the first step on
    variance[2:4] += (agent.step_m / agent.interval_s) ** 2
    mean = np.array([*agent.start_m, 0.0, 0.0, np.radians(agent.start_heading_deg)])
    return mean, variance
