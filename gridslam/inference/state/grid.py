"""The grid as a value: evidence of every cell, and beliefs about coefficients of the cells that were hit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import LATER, Array, replace
from gridslam.world.radio import BINS

NEVER_HIT = -1
EVERY_CELL = slice(None), slice(None)
EVIDENCE_CLIP = 12.0
"""Greatest evidence of a cell, either way."""
CHANGED = 0.1
"""Probability that a cell of an earlier agent's map is no longer what it was."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Beliefs about cells, indexed [iy, ix] from the lower left: [Li2026grid], section III-A.

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
    withheld : (ny, nx) float64, optional
        By how much an earlier agent was surer of the cells than the evidence began with; see `inherited`.
    """

    evidence: Array
    observed: NDArray[np.bool_]
    row: NDArray[np.int32]
    hit: NDArray[np.float32]
    withheld: Array | None = field(default=None, metadata=LATER)

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

    @classmethod
    def inherited(
        cls, evidence: Array, observed: NDArray[np.bool_], coefficient: NDArray[np.float32]
    ) -> Self:
        """The grid of an agent that goes on from an earlier one's map; docs/model.md, (M500).

        Since then each cell may have changed. Else a shelf that has moved holds up all paths that go through
        where it stood, by as many factors of a hundredth as they cross cells: what is heard over them is told
        as anything else, and nothing ever clears the cells, since each alone makes no path possible.
        """
        own = np.logaddexp(np.log1p(-CHANGED) + evidence, np.log(CHANGED))
        own -= np.logaddexp(np.log(CHANGED) + evidence, np.log1p(-CHANGED))
        return replace(cls.of(own, observed, coefficient), withheld=np.asarray(evidence, np.float64) - own)

    def whole_evidence(self, at: tuple[Any, Any] = EVERY_CELL) -> Array:
        """The evidence with what was withheld of an earlier map, unless what was heard since outweighs it,
        of all cells (ny, nx) or those at some rows and columns; docs/model.md, (M501)."""
        evidence = self.evidence[at]
        if self.withheld is None:
            return evidence
        withheld = self.withheld[at]
        whole = evidence + np.where(evidence * withheld > 0, withheld, 0.0)
        return np.clip(whole, -EVIDENCE_CLIP, EVIDENCE_CLIP)

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
