"""What no known path explained lately: measurements, and the poses at which they were taken."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

MEMORY = 64
"""Steps for which they are kept."""
MOST = 512
"""Measurements kept at most, the latest."""


@dataclass(frozen=True, eq=False)
class Leftovers:
    """Measurements of the latest W steps that are probably no known path's, the latest step first.

    Attributes
    ----------
    pose : (W, 3) m, m, rad
        Position and heading as they were believed after each step.
    covariance : (W, 3, 3)
    back : (H,) int64
        Row of `pose` at which each measurement was taken.
    anchor : (H,) int64
    value, std : (H, 3)
        Distance (m), AoD and AoA (rad), and their deviations.
    amplitude : (H,)
    """

    pose: Array
    covariance: Array
    back: NDArray[np.int64]
    anchor: NDArray[np.int64]
    value: Array
    std: Array
    amplitude: Array

    def __len__(self) -> int:
        return len(self.back)

    @classmethod
    def none(cls) -> Self:
        """Before the first step."""
        whole, none = np.zeros(0, np.int64), np.zeros((0, 3))
        return cls(none, np.zeros((0, 3, 3)), whole, whole, none, none, np.zeros(0))

    def joined(
        self, pose: Array, covariance: Array, anchor: NDArray[np.int64], value: Array, std: Array,
        amplitude: Array,
    ) -> Self:  # fmt: skip
        """These and what is left of one more step; the oldest are forgotten."""
        kept = (self.back < MEMORY - 1) & (np.arange(len(self)) < MOST - len(anchor))
        return type(self)(
            np.concatenate([pose[None], self.pose[: MEMORY - 1]]),
            np.concatenate([covariance[None], self.covariance[: MEMORY - 1]]),
            np.concatenate([np.zeros(len(anchor), np.int64), self.back[kept] + 1]),
            np.concatenate([anchor, self.anchor[kept]]),
            np.concatenate([value, self.value[kept]]),
            np.concatenate([std, self.std[kept]]),
            np.concatenate([amplitude, self.amplitude[kept]]),
        )
