"""Measurements that no known surface explains, of a whole run; docs/model.md, (M432)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

MOST = 2048
"""Measurements kept, the latest."""


@dataclass(frozen=True, eq=False)
class Unexplained:
    """H measurements that probably were no known path's, nor bore a surface.

    Attributes
    ----------
    anchor, step : (H,) int64
    value, std : (H, 2)
        Distance (m) and angle of arrival (rad), and their deviations.
    amplitude : (H,)
    pose : (H, 3) m, m, rad
        Position and heading as they were believed after the step.
    covariance : (H, 3, 3)
    """

    anchor: NDArray[np.int64]
    step: NDArray[np.int64]
    value: Array
    std: Array
    amplitude: Array
    pose: Array
    covariance: Array

    @classmethod
    def none(cls) -> Self:
        """Before the first step."""
        whole, pair = np.zeros(0, np.int64), np.zeros((0, 2))
        return cls(whole, whole, pair, pair, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))

    def __len__(self) -> int:
        return len(self.anchor)

    def joined(self, other: Self) -> Self:
        """These and later ones; the oldest beyond `MOST` are forgotten."""
        first = max(len(self) + len(other) - MOST, 0)
        return type(self)(
            *(np.concatenate([getattr(self, f.name)[first:], getattr(other, f.name)]) for f in fields(self))
        )
