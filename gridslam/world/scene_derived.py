"""What follows from the parts of a scene: pieces of walls, tracks of agents, and the prior of a start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.world.geometry import Segments, distance_to_segments, surfaces_of
from gridslam.world.overlaps import clipped
from gridslam.world.scene_parts import Agent, Anchor, Wall
from gridslam.world.trajectory import Trajectory
from gridslam.world.waypoints import smooth_track

MOST_NAMED = 3
"""Walls that repeat others, up to which each is named."""
LEAST_PRIOR = 1e-4
"""Half width of a start prior that a filter is told at least (m, m/s, rad)."""


def segments_of(walls: Sequence[Wall], materials: Mapping[str, float]) -> Segments:
    """Straight pieces of all walls, arcs as facets; collinear pieces share a surface.

    Where reflecting pieces of one surface overlap, the overlap belongs to the wall listed first alone: both
    would reflect each path. Other pieces are as drawn, to the bit. The coefficient of those that don't
    reflect is 0.
    """
    start, end, wall = _drawn(walls)
    surface = surfaces_of(start, end)
    coefficient = [materials[w.material] if w.material and w.reflects else 0.0 for w in walls]
    reflection = np.array(coefficient)[wall]
    curved = np.array([w.arc is not None for w in walls], dtype=bool)[wall]
    piece, share, _, _ = clipped(start, end, surface, _ranks(walls, wall))
    span, whole = end[piece] - start[piece], (share == [0.0, 1.0])[:, :, None]
    cut = start[piece][:, None] + share[:, :, None] * span[:, None]
    ends = np.where(whole, np.stack([start[piece], end[piece]], 1), cut)
    return Segments(
        np.ascontiguousarray(ends[:, 0]), np.ascontiguousarray(ends[:, 1]), reflection[piece],
        surface[piece], wall[piece], np.where(curved, wall, -1)[piece],
    )  # fmt: skip


def _drawn(walls: Sequence[Wall]) -> tuple[Array, Array, NDArray[np.intp]]:
    """Pieces of walls as drawn: starts and ends (P, 2), m, and their walls (P,)."""
    corners = [wall.corners for wall in walls]
    start = np.concatenate([np.zeros((0, 2)), *(points[:-1] for points in corners)])
    end = np.concatenate([np.zeros((0, 2)), *(points[1:] for points in corners)])
    count = [len(points) - 1 for points in corners]
    wall = np.repeat(np.arange(len(corners)), count).astype(np.intp)
    return start, end, wall


def _ranks(walls: Sequence[Wall], wall: NDArray[np.intp]) -> NDArray[np.intp]:
    """Who of overlapping pieces (P,) stays whole: the first listed, but what blocks all first; or -1."""
    later = np.array([w.blocks != "all" for w in walls], dtype=bool)[wall]
    mirrors = np.array([w.reflects for w in walls], dtype=bool)[wall]
    return np.where(mirrors, np.arange(len(wall)) + later * len(wall), -1).astype(np.intp)


def repeated_walls(walls: Sequence[Wall]) -> list[str]:
    """Which walls repeat others, and how much of them: "walls[1] repeats 6 m of walls[0]"."""
    start, end, wall = _drawn(walls)
    _, _, pair, length_m = clipped(start, end, surfaces_of(start, end), _ranks(walls, wall))
    sums: dict[tuple[int, int], float] = {}
    for (later, first), metres in zip(wall[pair].tolist(), length_m.tolist(), strict=True):
        sums[later, first] = sums.get((later, first), 0.0) + metres
    called = [f"walls[{n}]" + (f" ({w.name!r})" if w.name else "") for n, w in enumerate(walls)]
    return [
        f"{called[later]} repeats {metres:.3g} m of {'itself' if later == first else called[first]}"
        for (later, first), metres in sums.items()
    ]


def repeats_note(walls: Sequence[Wall]) -> str | None:
    """What to say of walls that repeat others, in one line; None if none does."""
    found = repeated_walls(walls)
    rest = f" and {len(found) - MOST_NAMED} more" * (len(found) > MOST_NAMED)
    meaning = "what is there twice reflects once, as the wall listed first"
    return f"{', '.join(found[:MOST_NAMED])}{rest}: {meaning}" if found else None


def surface_names(walls: Sequence[Wall], pieces: Segments) -> list[str]:
    """What each surface of the pieces of walls is called, (S,): as the wall of its longest reflecting piece.

    A side of a polyline, or a facet of an arc, is counted in the wall's order, from 1 on. The surface's own
    number stands in for a wall without a name, and beside a name that several walls have.
    """
    length = np.linalg.norm(pieces.end - pieces.start, axis=1) + 1e6 * (pieces.reflection > 0)
    names = []
    for surface in range(int(pieces.surface.max(initial=-1)) + 1):
        piece = np.argmax(np.where(pieces.surface == surface, length, -1.0))
        wall = walls[pieces.wall[piece]]
        corners, middle = wall.corners, 0.5 * (pieces.start[piece] + pieces.end[piece])
        side = int(distance_to_segments(middle, corners[:-1], corners[1:]).argmin())  # pieces may be cut
        part = "facet" if wall.arc is not None else "side"
        which = f", {part} {side + 1}" if len(corners) > 2 else ""
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
