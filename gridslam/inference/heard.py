"""What one anchor contributed to a scan, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gridslam.measurements import Scan

Array = NDArray[np.float64]
LOUD = np.log(1000.0)
"""Squared amplitude above the squared threshold that one in a thousand clutter measurements exceeds."""


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
    threshold : float
        Amplitude from which on the radio hears anything.
    """

    anchor: int
    place: Array
    facing: float
    value: Array
    own_std: Array
    amplitude: Array
    threshold: float = 0.0

    def __len__(self) -> int:
        return len(self.amplitude)

    @cached_property
    def loud(self) -> NDArray[np.bool_]:
        """Measurements (M,) that clutter is unlikely to be the cause of: one in a thousand is as loud."""
        excess = np.nan_to_num(self.amplitude, nan=np.inf) ** 2 - self.threshold**2
        return np.asarray(excess > LOUD)

    @classmethod
    def of(cls, scan: Scan, anchor: int, place: Array, facing: float, threshold: float = 0.0) -> Heard:
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
            threshold,
        )
