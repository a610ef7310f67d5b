"""Which anchors walls leave in sight, all walls at once: the filter of lines of sight asks at every step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.simulation.occlusion import GRAZE
from gridslam.world.geometry import Segments, unit

FAR_M, WAYS, OPEN = 1e4, 16, 2
"""Where no wall is any more; directions in which walls are looked for; how many may miss, as by doors."""


def in_view(start: Array, end: Array, walls: Segments) -> NDArray[np.bool_]:
    """Which legs (..., 2) -> (..., 2) meet no wall strictly inside, as `simulation.occlusion.visible` says.

    Parameters
    ----------
    start, end : (..., 2) m
        They broadcast.
    """
    leg = end - start
    if not len(walls):
        return np.ones(leg.shape[:-1], dtype=bool)
    span, away = walls.end - walls.start, walls.start - np.asarray(start)[..., None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = _cross(leg[..., None, :], span)
        here, along = _cross(away, span) / across, _cross(away, leg[..., None, :]) / across
        blocked = (here > GRAZE) & (here < 1 - GRAZE) & (along >= 0) & (along <= 1)
    return np.asarray(~blocked.any(-1))


def enclosed(place: Array, walls: Segments) -> NDArray[np.bool_]:
    """Whether walls stand around places (..., 2) in m, but for gaps as of doors (...); never without any."""
    rays = FAR_M * unit(2 * np.pi * (np.arange(WAYS) + 0.5) / WAYS)
    return np.asarray(in_view(place[..., None, :], place[..., None, :] + rays, walls).sum(-1) <= OPEN)


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
