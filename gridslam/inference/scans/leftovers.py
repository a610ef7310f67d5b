"""What no known path explained lately: measurements and their poses, or of samples the evidence for lines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

MEMORY = 64
"""Steps for which they are kept."""
MOST = 512
"""Measurements kept at most, the latest."""
REFLECTIONS = np.array([0.3, 0.45, 0.7, 0.9])
"""Coefficients for which evidence is kept."""
LEAST_EVIDENCE, MOST_EVIDENCE = 1e-7, 1e31
"""Between which evidence is, rounding included."""
LEAST_LINES, MOST_LINES = 12, 240
"""Angles of lines for which evidence is kept, at least; angles, and offsets, at most."""


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

    @cached_property
    def begin(self) -> NDArray[np.int32]:
        """Where the measurements of each step begin, (W + 1,)."""
        return self.back.searchsorted(np.arange(len(self.pose) + 1)).astype(np.int32)

    @cached_property
    def rows(self) -> Array:
        """The measurements as kernels take them: anchor, value, deviations, amplitude, (H, 8)."""
        return np.column_stack([self.anchor, self.value, self.std, self.amplitude])

    @classmethod
    def none(cls) -> Self:
        """Before the first step."""
        whole, none = np.zeros(0, np.int64), np.zeros((0, 3))
        return cls(none, np.zeros((0, 3, 3)), whole, whole, none, none, np.zeros(0))

    def joined(
        self, pose: Array, covariance: Array, anchor: NDArray[np.int64], value: Array, std: Array,
        amplitude: Array,
    ) -> Self:  # fmt: skip
        """These and what is left of one more step; the oldest are forgotten.

        Parameters
        ----------
        pose, covariance : (3,), (3, 3)
            Position (m) and heading (rad) as believed after that step.
        anchor : (H,) int64
        value, std : (H, 3)
            Distance (m), AoD and AoA (rad), and their deviations.
        amplitude : (H,)
        """
        recent = int(self.back.searchsorted(MEMORY - 1))
        recent_rows, steps = slice(max(min(recent, MOST - len(anchor)), 0)), slice(MEMORY - 1)
        return type(self)(
            np.concatenate([pose[None], self.pose[steps]]),
            np.concatenate([covariance[None], self.covariance[steps]]),
            np.concatenate([np.zeros(len(anchor), np.int64), self.back[recent_rows] + 1]),
            np.concatenate([anchor, self.anchor[recent_rows]]),
            np.concatenate([value, self.value[recent_rows]]),
            np.concatenate([std, self.std[recent_rows]]),
            np.concatenate([amplitude, self.amplitude[recent_rows]]),
        )


@dataclass(frozen=True, eq=False)
class LineEvidence:
    """What snapshots left unexplained, by the line of which it may be a single bounce.

    Attributes
    ----------
    ratio : (J, A, O, B)
        By anchor, angle of the normal (a half turn), offset from the middle of the region (from one side of
        the circle about it to the other) and coefficient: likelihood of the latest snapshots if the line has
        been heard from some step on, over that if it hasn't.
    """

    ratio: Array

    @classmethod
    def none(cls, anchors: int, radius_m: float, spacing_m: float) -> Self:
        """Before the first snapshot: lines some `spacing_m` apart over a circle of a radius."""
        offsets = min(2 * int(np.ceil(radius_m / spacing_m)) + 1, MOST_LINES)
        angles = int(np.clip(np.ceil(0.5 * np.pi * radius_m / spacing_m), LEAST_LINES, MOST_LINES))
        return cls(np.ones((anchors, angles, offsets, len(REFLECTIONS))))

    def offsets(self, radius_m: float) -> Array:
        """Offsets of the lines from the middle, (O,) m."""
        return np.linspace(-radius_m, radius_m, self.ratio.shape[2])

    def angles(self) -> Array:
        """Angles of the lines' normals, (A,) rad."""
        return np.pi * np.arange(self.ratio.shape[1]) / self.ratio.shape[1]
