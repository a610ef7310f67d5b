"""Which cells of one grid another grid's cells take over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

ON_LATTICE = 1e-6
"""Largest deviation, in cells, at which two grids still count as aligned."""

Indices = NDArray[np.intp]


def aligned(cells: Array) -> Array:
    """Distances in cells, made whole where they nearly are.

    Parameters
    ----------
    cells : (N,) float64
    """
    whole = np.rint(cells)
    return np.where(np.abs(cells - whole) <= ON_LATTICE * np.maximum(1.0, np.abs(cells)), whole, cells)


@dataclass(frozen=True)
class Lattices:
    """How a new grid lies on an old one.

    A finer cell takes over the cell that its centre lies in; a coarser one takes over one of those whose
    centres lie in it. So each old cell passes on to at least one new one, walls get no thicker, and a finer
    grid and back is the same map. docs/model/grid.md.

    Attributes
    ----------
    ratio : float
        The new cell's side in old ones.
    shift : (2,) float64
        From the old grid's origin to the new one's along x and y, in the smaller of the two cells.
    """

    ratio: float
    shift: Array

    @classmethod
    def of(cls, old: tuple[Array, float], new: tuple[Array, float]) -> Self:
        """Of two grids' origins (2,) m and cells m."""
        (start, side), (origin, cell) = old, new
        finer, coarser = (max(1, round(r)) for r in (side / cell, cell / side))
        whole = abs(cell * finer - side * coarser) <= ON_LATTICE * side
        ratio = coarser / finer if whole else cell / side
        # of an integer ratio the smaller cell is a part of the other
        smaller = cell / coarser if whole else min(cell, side)
        return cls(ratio, aligned((origin - start) / smaller))

    def taken_over(self, axis: int, old: int, new: int) -> tuple[Indices, NDArray[np.bool_]]:
        """Which old cells each new one may take over along an axis.

        Parameters
        ----------
        axis : int
            0: x, 1: y.
        old, new : int
            How many cells there are.

        Returns
        -------
        cell : (new, N) intp
            0 where there is none.
        there : (new, N) bool
            Whether there is one.
        """
        shift = float(self.shift[axis])
        if self.ratio == 1:
            # half a cell goes to the even side: there and back it is the same cell
            cell = (np.arange(new) + np.rint(np.round(shift, 6)).astype(int))[:, None]
        elif self.ratio < 1:
            centre = (np.arange(new) + shift + 0.5) * self.ratio
            cell = np.floor(centre + ON_LATTICE).astype(np.intp)[:, None]
        else:
            centre = (np.arange(old) + 0.5 - shift) / self.ratio
            first, past = np.searchsorted(
                np.floor(centre + ON_LATTICE), [np.arange(new), np.arange(1, new + 1)]
            )
            cell = first[:, None] + np.arange(max(1, (past - first).max(initial=0)))
            cell = np.where(cell < past[:, None], cell, old)
        there = (cell >= 0) & (cell < old)
        return np.where(there, cell, 0).astype(np.intp), there


def covering(finest: tuple[Array, float], low: Array, high: Array) -> tuple[Array, tuple[int, int]]:
    """The grid with the cells of another, and on its lattice, that covers a box.

    Parameters
    ----------
    finest : (2,) float64 m, float m
        Origin and cell.
    low, high : (2,) float64, m

    Returns
    -------
    origin_m : (2,) float64, m
    shape : (int, int)
        Number of cells (ny, nx).
    """
    origin, cell = finest
    before = aligned((origin - low) / cell)
    on_lattice = before == np.rint(before)
    start = np.where(on_lattice, low, origin - np.ceil(before) * cell)
    columns, rows = (int(n) for n in np.ceil(aligned((high - start) / cell)))
    return start, (rows, columns)
