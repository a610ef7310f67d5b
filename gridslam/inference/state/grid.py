"""The grid as a value: evidence of every cell, and beliefs about coefficients of the cells that were hit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.radio import BINS

NEVER_HIT = -1


@dataclass(frozen=True, eq=False)
class Grid:
    """Beliefs about cells, indexed [iy, ix] from the lower left.

    Few cells are ever hit, so coefficients stand in rows of a table of their own: a state is light, and so
    are many of them.

    Attributes
    ----------
    evidence : (ny, nx) float64
        Log odds of occupancy without the prior, 0 where nothing was learned.
    observed : (ny, nx) bool
        Cells to which the messages of some step added up to more than 0.01, `occupancy.TOUCHED`.
    row : (ny, nx) int32
        A cell's row in the table; `NEVER_HIT` for none.
    hit : (H, BINS) float32
        Log-likelihood over `REFLECTION_BINS` of the cells that were hit.
    """

    evidence: Array
    observed: NDArray[np.bool_]
    row: NDArray[np.int32]
    hit: NDArray[np.float32]

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> Self:
        """Nothing is known of (ny, nx) cells."""
        none = np.zeros((0, BINS), np.float32)
        return cls(np.zeros(shape), np.zeros(shape, dtype=bool), np.full(shape, NEVER_HIT, np.int32), none)

    @classmethod
    def of(cls, evidence: Array, observed: NDArray[np.bool_], coefficient: NDArray[np.float32]) -> Self:
        """Take over whole arrays; `coefficient` (ny, nx, BINS) is 0 where nothing was hit."""
        logs = np.asarray(coefficient, np.float32)
        known = logs.any(-1)
        row = np.full(known.shape, NEVER_HIT, np.int32)
        row[known] = np.arange(np.count_nonzero(known))
        whole = np.ascontiguousarray(evidence, np.float64), np.array(observed, dtype=bool, order="C")
        return cls(*whole, row, np.ascontiguousarray(logs[known]))

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx)."""
        return self.row.shape[0], self.row.shape[1]

    @property
    def coefficient(self) -> NDArray[np.float32]:
        """Log-likelihood over `REFLECTION_BINS` of every cell, 0 where nothing was hit, (ny, nx, BINS)."""
        whole = np.zeros((*self.shape, BINS), np.float32)
        known = self.row >= 0
        whole[known] = self.hit[self.row[known]]
        return whole
