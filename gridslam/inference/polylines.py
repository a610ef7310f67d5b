"""Paths drawn as polylines at sampled states, for casting through the grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.particles import Cloud

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Polylines:
    """L paths at R states.

    Attributes
    ----------
    bounces : (L,) int
    corners : (L, R, 4, 2) m
        Anchor, interaction points, agent; the agent repeats where there are fewer bounces.
    normals : (L, R, 2, 2)
        Of the surfaces hit first and last.
    valid : (L, R)
        1 where the path is possible; else it is drawn as a point at the anchor.
    """

    bounces: NDArray[np.intp]
    corners: Array
    normals: Array
    valid: Array

    def take(self, rows: NDArray[np.intp]) -> Polylines:
        """Some of the paths."""
        return Polylines(self.bounces[rows], self.corners[rows], self.normals[rows], self.valid[rows])

    @property
    def last_points(self) -> Array:
        """Interaction points before the agent (the anchor's first leg end on a line of sight), (L, R, 2)."""
        rows = np.arange(len(self.bounces))
        return np.asarray(self.corners[rows, :, np.maximum(self.bounces, 1)])

    @property
    def first_points(self) -> Array:
        """Interaction points after the anchor, (L, R, 2)."""
        return self.corners[:, :, 1]


def draw_paths(
    bounces: NDArray[np.intp], last: NDArray[np.intp], first: NDArray[np.intp], cloud: Cloud, place: Array
) -> Polylines:
    """Draw paths over surfaces `last`, `first` (L,) from the anchor at `place` to all states of a cloud."""
    runtime.start()
    from gridslam.kernels.paths import polylines

    count, states = len(bounces), cloud.agent.shape[1]
    corners, normals = np.zeros((count, states, 4, 2)), np.zeros((count, states, 2, 2))
    valid = np.zeros((count, states))
    if count:
        if cloud.lines.shape[1] <= max(int(last.max()), int(first.max())):
            raise ValueError("a path names a surface that the cloud doesn't hold")
        polylines(
            np.ascontiguousarray(cloud.agent[:2], np.float64),
            np.ascontiguousarray(cloud.lines, np.float64),
            np.ascontiguousarray(np.stack([bounces, last, first], -1), np.int32),
            np.asarray(place, np.float64),
            corners,
            normals,
            valid,
        )
    return Polylines(bounces, corners, normals, valid)
