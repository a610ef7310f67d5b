"""Paths drawn as polylines at sampled states, for casting through the grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.beliefs.particles import Cloud
from gridslam.inference.state.rays import Rays
from gridslam.kernels.primitives.tables import MEAN_CORNERS, MEAN_VALIDITY, RAY_POSSIBLE, SHARE_POSSIBLE


@dataclass(frozen=True)
class Polylines:
    """L paths at R states.

    Attributes
    ----------
    count : int
        L.
    drawn : (L R or more, 13 or 14)
        Corners (8), normals (4) and possibility as the kernel leaves them; then V, and where the device has
        them, if they were cast.
    seen : (L or more, 6)
        Means over the states: of V where the path is possible (0 if it wasn't cast); how often that is; first
        and second corner after the anchor.
    """

    count: int
    drawn: runtime.Resident
    seen: Array

    @property
    def validity(self) -> Array:
        """V of every path, [Li2026grid], eq. (14): mean over the states at which it is possible, (L,)."""
        return self.seen[: self.count, MEAN_VALIDITY]


def draw_paths(rays: Rays, cloud: Cloud, anchors: Array) -> Polylines:
    """Draw rays from anchors (J, 6), as in `FilterModel.places`, to all states of a cloud."""
    runtime.start()
    from gridslam.kernels.propagation.paths import polylines

    rays.check(cloud.surfaces, len(anchors))
    state, count = cloud.state, len(rays)
    drawn, seen = np.zeros((count * state.shape[1], 13)), np.zeros((count, 6))
    if count:
        polylines(state, rays.table, anchors, drawn)
        own = drawn.reshape(count, -1, 13)
        seen[:, SHARE_POSSIBLE] = own[..., RAY_POSSIBLE].mean(1)
        seen[:, MEAN_CORNERS:] = own[..., 2:6].mean(1)
    return Polylines(count, drawn, seen)
