"""What one anchor contributed to a scan, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.measurements import Scan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Heard:
    """Measurements of one anchor at one step; NaN stands for not measured.

    Attributes
    ----------
    anchor : int
    place : (2,) m
    facing : float, rad
    value : (M, 3)
        Distance (m), AoD and AoA (rad).
    own_std : (M, 3)
        Deviations that came with the table.
    amplitude : (M,)
    """

    anchor: int
    place: Array
    facing: float
    value: Array
    own_std: Array
    amplitude: Array

    def __len__(self) -> int:
        return len(self.amplitude)

    @classmethod
    def of(cls, scan: Scan, anchor: int, place: Array, facing: float) -> Heard:
        """Rows of `scan` that belong to `anchor`."""
        rows = np.flatnonzero(scan.anchor == anchor)
        unknown = np.full(len(rows), np.nan)
        own = [scan.distance_std_m, scan.aod_std_rad, scan.aoa_std_rad]
        return cls(
            anchor,
            place,
            float(facing),
            np.stack([scan.distance_m[rows], scan.aod_rad[rows], scan.aoa_rad[rows]], -1),
            np.stack([unknown if o is None else o[rows] for o in own], -1),
            scan.amplitude[rows],
        )
