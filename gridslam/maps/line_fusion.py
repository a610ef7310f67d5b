"""Lines of several maps as one Gaussian, conditioned on which of them are the same wall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.maps.map_cells import blocks_of
from gridslam.world.geometry import unit, wrap

SAME = 1e-12
"""Variance (rad^2, m^2) by which two estimates of one wall may differ after all."""


@dataclass(frozen=True)
class JointLines:
    """A Gaussian of lines.

    Attributes
    ----------
    line : (S, 2) [rad, m]
        Normal angles and offsets.
    covariance : (2 S, 2 S)
    """

    line: Array
    covariance: Array

    @property
    def own(self) -> Array:
        """Covariance of each line, (S, 2, 2)."""
        return blocks_of(self.covariance)

    def about(self, point: Array) -> JointLines:
        """The lines with offsets counted from a point (2,) instead of the origin, m."""
        normal, tangent = unit(self.line[:, 0]), unit(self.line[:, 0] + 0.5 * np.pi)
        moved = np.stack([self.line[:, 0], self.line[:, 1] - normal @ point], axis=-1)
        jacobian = np.eye(len(self.covariance))
        entry = 2 * np.arange(len(self.line))
        jacobian[entry + 1, entry] = -tangent @ point
        return JointLines(moved, jacobian @ self.covariance @ jacobian.T)

    def turned(self, rows: NDArray[np.bool_]) -> JointLines:
        """The lines, some of them (S,) with the opposite normal."""
        sign = np.ones(len(self.covariance))
        sign[1::2][rows] = -1.0
        line = self.line.copy()
        line[rows] = np.stack([wrap(line[rows, 0] + np.pi), -line[rows, 1]], axis=-1)
        return JointLines(line, self.covariance * np.outer(sign, sign))

    def united(self, groups: Sequence[Sequence[int]]) -> tuple[JointLines, NDArray[np.bool_]]:
        """One line for each group of estimates of one wall, the rest following by its correlation.

        Conditioned on the lines of each group being one, ``C x = 0``: the same as the product of independent
        Gaussians in information form, ``sum of A^T P^-1 A``, where all of P can be inverted.

        Returns
        -------
        lines : JointLines
            Of each group, in the order of the groups.
        moved : (G,) bool
            Which of them aren't what they were.
        """
        first = np.array([group[0] for group in groups], np.intp)
        facing = self.turned(self._opposite(groups))
        ties = [(group[0], other) for group in groups for other in group[1:]]
        same, gap = np.zeros((2 * len(ties), len(self.covariance))), np.zeros((len(ties), 2))
        for n, (one, other) in enumerate(ties):
            for axis in (0, 1):
                same[2 * n + axis, 2 * one + axis], same[2 * n + axis, 2 * other + axis] = -1.0, 1.0
            gap[n] = facing.line[other] - facing.line[one]
            gap[n, 0] = wrap(gap[n, 0])
        spread = facing.covariance
        core = same @ spread @ same.T + SAME * np.eye(len(same))
        gain = np.linalg.solve(core, same @ spread).T if len(ties) else np.zeros((len(spread), 0))
        line = facing.line - (gain @ gap.reshape(-1)).reshape(-1, 2)
        entry = (2 * first[:, None] + np.arange(2)).reshape(-1)
        covariance = (spread - gain @ same @ spread)[np.ix_(entry, entry)]
        moved = (gain != 0).any(1).reshape(-1, 2).any(1)
        return JointLines(line[first], 0.5 * (covariance + covariance.T)), moved[first]

    def _opposite(self, groups: Sequence[Sequence[int]]) -> NDArray[np.bool_]:
        """Lines whose normal points away from that of the first of their group, (S,)."""
        leader = np.arange(len(self.line))
        for group in groups:
            leader[list(group)] = group[0]
        return np.abs(wrap(self.line[:, 0] - self.line[leader, 0])) > 0.5 * np.pi
