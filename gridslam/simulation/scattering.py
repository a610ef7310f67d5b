"""Paths by way of points that scatter to all sides, and the dense tail of what is too weak to tell apart."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.simulation.occlusion import visible
from gridslam.simulation.true_paths import TruePaths
from gridslam.world.geometry import direction, slant, wrap
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory
from gridslam.world.waveform import Waveform

NEAREST_M2 = 1e-3
"""Least product of both ways over a scatterer."""
RAYS = 64
"""Of a dense tail, at each step and anchor."""


def scattered_paths(scene: Scene, agent: str, track: Trajectory, places: Array, sizes_m: Array) -> TruePaths:
    """A path per anchor, scatterer and step where no wall blocks either way; docs/model.md, (M207).

    A path has one interaction point and no wall piece (-1). Walls that block sights alone don't count. Under
    anchors at heights a scatterer is a post, at which paths keep their slope.

    Parameters
    ----------
    places : (S, 2) m
    sizes_m : (S,)
    """
    walls, tables = scene.segments(), [TruePaths.empty()]
    heights = scene.heights(agent)
    walls = walls.take(np.array([wall.blocks == "all" for wall in scene.walls], dtype=bool)[walls.wall])
    for place, size in zip(places, sizes_m, strict=True):
        there = np.broadcast_to(place, track.position_m.shape)
        seen = visible(there, track.position_m, walls)
        for anchor, source in enumerate(scene.anchor_positions):
            here = seen & visible(source[None], place[None], walls)
            corners = [np.broadcast_to(source, there.shape)[here], there[here], track.position_m[here]]
            to, fro = (np.linalg.norm(b - a, axis=1) for a, b in pairwise(corners))
            strength = size * (to + fro) / np.maximum(to * fro, NEAREST_M2)
            strength *= (to + fro) / slant(to + fro, heights[anchor])  # both ways are longer in space
            tables.append(path_rows(scene, agent, track, anchor, corners, here, strength))
    return tables[0].joined(*tables[1:])


def path_rows(
    scene: Scene, agent: str, track: Trajectory, anchor: int, corners: list[Array],
    here: NDArray[np.bool_], strength: Array | float,
) -> TruePaths:  # fmt: skip
    """Rows of paths with these corners (each (K, 2)), at the steps where `here` (N,); without wall pieces."""
    step = np.flatnonzero(here)
    level = sum(np.linalg.norm(b - a, axis=1) for a, b in pairwise(corners))
    distance = slant(np.asarray(level), scene.heights(agent)[anchor])
    points = np.full((len(step), 4, 2), np.nan)
    points[:, 0], points[:, 3] = corners[0], corners[-1]
    if len(corners) == 3:
        points[:, 1] = corners[1]
    return TruePaths(
        step,
        np.full(len(step), anchor),
        distance,
        wrap(direction(corners[0], corners[1]) - scene.anchor_orientations[anchor]),
        wrap(direction(corners[-1], corners[-2]) - track.heading_rad[step]),
        scene.signal_model(agent).amplitude(distance, strength),
        np.full(len(step), len(corners) - 2),
        np.full((len(step), 2), -1),
        points,
        np.zeros(len(step), np.intp),
    )


def dense_tail(
    scene: Scene, agent: str, place: Array, waveform: Waveform, draw: np.random.Generator
) -> NDArray[np.complex128]:
    """Samples (J, A, B, M) of the dense tail at one step: rays, complex Gaussian, drawn anew; (M208).

    They begin at the length of each anchor's line of sight, seen or not, and come from all sides; all
    together carry ``radio.dense.power_db`` of its power.
    """
    total = np.zeros(waveform.shape, np.complex128)
    dense = scene.radio.dense
    if dense is None:
        return total
    for anchor, source in enumerate(scene.anchor_positions):
        first = float(np.hypot(*(source - place)))
        level = scene.signal_model(agent).amplitude(first) * 10 ** (dense.power_db / 20) / np.sqrt(2 * RAYS)
        gain = level * (draw.standard_normal((2, RAYS)) * [[1], [1j]]).sum(0)
        length = first + dense.decay_m * draw.exponential(size=RAYS)
        leaving, arriving = draw.uniform(-np.pi, np.pi, (2, RAYS))
        total[anchor] = np.einsum(
            "la,lb,lm->abm", waveform.anchor_response(anchor, leaving), waveform.agent_response(arriving),
            gain[:, None] * waveform.delay_response(length), optimize=True,
        )  # fmt: skip
    return total
