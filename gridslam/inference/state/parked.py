"""Surfaces out of sight: kept beside the joint belief, and correlated with it as if they stood in it.

What is measured depends on the joint belief alone. So given it, the parked lines are as before: they follow
whatever it becomes by their regression on it, docs/model.md, section 9.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief, solved
from gridslam.inference.beliefs.layout import AGENT, HEADING, PER_LINE
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.world.geometry import wrap

Whole = NDArray[np.int64]


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

    def following(self, before: Belief, after: Belief, rows: tuple[Whole, Whole] | None = None) -> Self:
        """The same once the joint belief has become `after`, by whatever it was updated with.

        With G = cross cov(before)^-1, means move by G times what the belief's moved by, covariances by
        G (change of the belief's) G^T; what is new in it is independent of the parked, given the rest.

        Parameters
        ----------
        rows : ((R,), (R,)), optional
            Entries of `before` that are in `after` still, and where. Default: all, at the same places.
        """
        own, there = rows if rows is not None else (np.arange(len(before.mean)),) * 2
        known = before.covariance[np.ix_(own, own)]
        gain = solved(known, self.cross[:, own].T).T
        shift = after.mean[there] - before.mean[own]
        turning = (own == HEADING) | ((own >= before.layout.head) & ((own - before.layout.head) % 2 == 0))
        shift[turning] = wrap(shift[turning])
        covariance = self.covariance + gain @ (after.covariance[np.ix_(there, there)] - known) @ gain.T
        return replace(
            self,
            mean=self.mean + gain @ shift,
            covariance=0.5 * (covariance + covariance.T),
            cross=gain @ after.covariance[there],
        )

    def unlinked(self) -> Self:
        """The same, independent of the agent: it was put elsewhere."""
        cross = self.cross.copy()
        cross[:, :AGENT] = 0.0
        return replace(self, cross=cross)
