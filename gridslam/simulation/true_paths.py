"""The paths that there truly are, as a perfect receiver would measure them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array


@dataclass(frozen=True)
class TruePaths:
    """All visible paths of a track, one row per path.

    Attributes
    ----------
    step, anchor : (L,) int
    distance_m, aod_rad, aoa_rad, amplitude : (L,) float64
        As a perfect receiver would measure them; angles relative to anchor orientation and heading.
    bounces : (L,) int, 0 to 2
    segment : (L, 2) int
        Wall pieces hit first and last; -1 where there is none.
    points : (L, 4, 2) m
        Anchor, first and second interaction point (NaN where there is none), agent.
    over : (L,) int
        Whether the path also goes over floor or ceiling: `DIRECT`, `FLOOR` or `CEILING`; not a bounce, as
        seen from above.
    """

    step: NDArray[np.intp]
    anchor: NDArray[np.intp]
    distance_m: Array
    aod_rad: Array
    aoa_rad: Array
    amplitude: Array
    bounces: NDArray[np.intp]
    segment: NDArray[np.intp]
    points: Array
    over: NDArray[np.intp]

    @classmethod
    def empty(cls) -> TruePaths:
        """No paths."""
        return cls(
            *(np.zeros(0, np.intp),) * 2, *(np.zeros(0),) * 4, np.zeros(0, np.intp),
            np.zeros((0, 2), np.intp), np.zeros((0, 4, 2)), np.zeros(0, np.intp),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.step)

    def joined(self, *others: TruePaths) -> TruePaths:
        """All rows of these tables, by step."""
        whole = [np.concatenate([getattr(t, f.name) for t in (self, *others)]) for f in fields(self)]
        order = np.argsort(whole[0], kind="stable")
        return TruePaths(*(column[order] for column in whole))

    @property
    def of_walls(self) -> NDArray[np.bool_]:
        """Which paths are lines of sight or go over walls alone (L,): not those over scatterers."""
        return (self.bounces == 0) | (self.segment[:, 0] >= 0)

    def at(self, step: int) -> TruePaths:
        """The paths of one step."""
        return self.take(self.step == step)

    def take(self, rows: NDArray[np.bool_]) -> TruePaths:
        """The paths chosen by a mask (L,)."""
        return TruePaths(*(getattr(self, f.name)[rows] for f in fields(self)))

    @property
    def legs(self) -> tuple[Array, Array, NDArray[np.intp]]:
        """Straight legs of all paths: starts (K, 2), ends (K, 2) in m and the path of each (K,)."""
        filled = self.points.copy()
        for corner in (2, 1):  # an absent interaction point collapses onto the next one
            absent = np.isnan(filled[:, corner, 0])
            filled[absent, corner] = filled[absent, corner + 1]
        start, end = filled[:, :-1].reshape(-1, 2), filled[:, 1:].reshape(-1, 2)
        real = ((start != end).any(-1)) & ~np.isnan(start[:, 0])
        return start[real], end[real], np.repeat(np.arange(len(self)), 3)[real]
