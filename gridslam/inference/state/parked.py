"""Surfaces out of sight: kept beside the joint belief, and correlated with it as if they stood in it.

What is measured depends on the joint belief alone. So given it, the parked lines are as before: they follow
whatever it becomes by their regression on it, docs/model.md, (M575).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import AGENT, PER_LINE
from gridslam.inference.beliefs.regression import Beside, Rows, following
from gridslam.inference.state.surface_bank import SurfaceBank


@dataclass(frozen=True, eq=False)
class Parked:
    """P surfaces out of sight. A value.

    Attributes
    ----------
    surfaces : SurfaceBank
        Existence and coefficients as they were when each was last in sight.
    mean : (2 P,)
        Angle and offset of line after line.
    covariance : (2 P, 2 P)
    cross : (2 P, N)
        Covariance with the entries of the joint belief.
    """

    surfaces: SurfaceBank
    mean: Array
    covariance: Array
    cross: Array

    def __post_init__(self) -> None:
        size = PER_LINE * len(self.surfaces)
        if not (
            self.mean.shape == (size,)
            and self.covariance.shape == (size, size)
            and self.cross.shape == (size, self.cross.shape[-1])
        ):
            raise ValueError("parked surfaces and lines don't belong together")

    def __len__(self) -> int:
        return len(self.surfaces)

    @property
    def lines(self) -> Array:
        """Mean lines, (P, 2): normal angle (rad) and offset (m)."""
        return self.mean.reshape(-1, PER_LINE)

    def predicted(self, dt: float, shift: float) -> Self:
        """A step on: the agent has moved, and lines jitter as those in the joint belief do.

        Parameters
        ----------
        dt : float, s
        shift : float, m
            Jitter of a surface along its normal at the point where it was hit.
        """
        cross, covariance = self.cross.copy(), self.covariance.copy()
        cross[:, :2] += dt * cross[:, 2:4]
        turn, foot = (shift / 5.0) ** 2, self.surfaces.foot
        angle = PER_LINE * np.arange(len(self))
        covariance[angle, angle] += turn
        covariance[angle, angle + 1] += turn * foot
        covariance[angle + 1, angle] += turn * foot
        covariance[angle + 1, angle + 1] += turn * foot**2 + shift**2
        return replace(self, cross=cross, covariance=covariance)

    def following(self, before: Belief, after: Belief, rows: tuple[Rows, Rows] | None = None) -> Self:
        """The parked surfaces once the joint belief has become `after`; see `regression.following`."""
        mean, covariance, cross = following(
            Beside(self.mean, self.covariance, self.cross), before, after, rows
        )
        return replace(self, mean=mean, covariance=covariance, cross=cross)

    def unlinked(self) -> Self:
        """The parked surfaces, independent of the agent: it was put elsewhere."""
        cross = self.cross.copy()
        cross[:, :AGENT] = 0.0
        return replace(self, cross=cross)
