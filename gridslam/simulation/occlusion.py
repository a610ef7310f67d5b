"""Which straight legs of paths walls block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.geometry import Segments, crossing

GRAZE = 1e-9
"""Share of a leg at either end in which a wall does not block it: the wall that it starts or ends on."""


def visible(start: Array, end: Array, walls: Segments) -> NDArray[np.bool_]:
    """Which legs (K, 2) -> (K, 2) meet no wall strictly inside."""
    clear = np.ones(len(start), dtype=bool)
    lines = walls.line
    for wall in range(len(walls)):
        line = lines[wall]
        here = crossing(start, end, line)
        span = walls.end[wall] - walls.start[wall]
        with np.errstate(invalid="ignore"):
            point = start + here[:, None] * (end - start)
            along = (point - walls.start[wall]) @ span / (span @ span)
            blocked = (here > GRAZE) & (here < 1 - GRAZE) & (along >= 0) & (along <= 1)
        clear &= ~blocked
    return clear
