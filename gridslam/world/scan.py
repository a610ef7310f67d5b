"""What is heard at one step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scan:
    """What was heard at one step; NaN stands for not measured.

    Attributes
    ----------
    step : int
    time_s : float
    anchor : (M,) int
        Index of the anchor.
    distance_m : (M,) float64
    aod_rad, aoa_rad : (M,) float64
        Departure relative to the anchor's orientation, arrival relative to the heading.
    amplitude : (M,) float64
        Square root of the path's SNR.
    distance_std_m, aod_std_rad, aoa_std_rad : (M,) float64 or None
        Used instead of the Fisher-information values.
    """

    step: int
    time_s: float
    anchor: NDArray[np.intp]
    distance_m: Array
    aod_rad: Array
    aoa_rad: Array
    amplitude: Array
    distance_std_m: Array | None = None
    aod_std_rad: Array | None = None
    aoa_std_rad: Array | None = None

    def __len__(self) -> int:
        return len(self.anchor)
