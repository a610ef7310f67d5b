"""Paths that a ray tracer found more than once.

Walls in one plane, or triangles of one wall, mirror an antenna to the same place; a tracer that tries each of
them lists one path for each, though waves take it once. Sionna RT does so where a wall has a door.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.geometry import wrap
from gridslam.world.radio import SPEED_OF_LIGHT

SAME_M, SAME_RAD = 1e-4, 1e-3
"""Lengths and angles within which paths are the same: in single precision they agree to 4 um and 0.3 mrad;
of 84 traced rooms, no others are closer than 4 mm and 22 mrad."""


def repeated(delay_s: Array, angles_rad: Sequence[Array]) -> NDArray[np.bool_]:
    """Which paths are the same as one listed before them, (..., L).

    Parameters
    ----------
    delay_s : (..., L) s
        NaN where there is no path.
    angles_rad : sequence of (..., L) rad
        At both ends, azimuths and angles from the vertical.
    """
    order = np.argsort(delay_s, axis=-1, kind="stable")
    length, *angles = (np.take_along_axis(one, order, -1) for one in (SPEED_OF_LIGHT * delay_s, *angles_rad))
    later = np.zeros(delay_s.shape, bool)
    for ahead in range(1, delay_s.shape[-1]):  # others may be as long, and lie between
        with np.errstate(invalid="ignore"):
            same = length[..., ahead:] - length[..., :-ahead] < SAME_M
            if not same.any():
                break
            for one in angles:
                same &= np.abs(wrap(one[..., ahead:] - one[..., :-ahead])) < SAME_RAD
        behind = order[..., ahead:] > order[..., :-ahead]
        later[..., ahead:] |= same & behind
        later[..., :-ahead] |= same & ~behind
    found = np.empty_like(later)
    np.put_along_axis(found, order, later, -1)
    return found
