"""Stretches of surfaces that paths were reflected by: of walls of other maps, and without overlap."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.estimate_tables import SurfaceEstimate, SurfaceStretches
from gridslam.world.geometry import unit

NEAR_M = 0.3
"""Off a surface's line, a wall or a bounce is none of the surface's."""


def stretches_of(walls: Array, found: SurfaceEstimate) -> SurfaceStretches:
    """Walls (W, 2, 2), m, as stretches of the surfaces that they are part of; the others are left out."""
    if not len(found) or not len(walls):
        return SurfaceStretches.empty()
    angle, offset = found.line.T
    across = np.abs(walls @ unit(angle).T - offset).max(axis=1)
    row = across.argmin(axis=1)
    along = np.einsum("wei,wi->we", walls, unit(angle[row] + 0.5 * np.pi))
    return joined(SurfaceStretches(row, along).take(across.min(axis=1) < NEAR_M))


def joined(stretches: SurfaceStretches) -> SurfaceStretches:
    """Stretches of surfaces without overlap, in order."""
    extent = np.sort(stretches.extent_m, axis=1)
    rows, whole = list[int](), list[list[float]]()
    for n in np.lexsort((extent[:, 0], stretches.surface)):
        if rows and rows[-1] == stretches.surface[n] and extent[n, 0] <= whole[-1][1]:
            whole[-1][1] = max(whole[-1][1], extent[n, 1])
        else:
            rows.append(int(stretches.surface[n]))
            whole.append(extent[n].tolist())
    return SurfaceStretches(np.array(rows, np.int64), np.reshape(np.array(whole, float), (-1, 2)))
