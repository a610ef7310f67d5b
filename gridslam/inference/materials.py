"""Reflection coefficients: beliefs about products of them along paths, and what amplitudes say of each; owner
of the kernel of the former."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.cells import Cells
from gridslam.inference.likelihood import DetectionTable
from gridslam.inference.polylines import Polylines
from gridslam.inference.rays import Rays
from gridslam.inference.surfaces import Bank
from gridslam.inference.told import Told
from gridslam.signal import REFLECTION_BINS, SignalModel

Array = NDArray[np.float64]
BINS = len(REFLECTION_BINS)
PRODUCTS: Array = np.arange(1, 2 * BINS + 1) / (2 * BINS)
"""Nodes for products of coefficients; they hold every bin's centre, and 1 for the line of sight."""
OTHER_MATERIAL = 0.05
"""Share of the belief that a wall is of another material where it is hit next."""


@dataclass(frozen=True)
class Reflected:
    """Amplitudes by reflection: node c of a path of length d stands for ``c u_1m / d``.

    Attributes
    ----------
    probability : (L, K)
        Belief over `PRODUCTS`.
    """

    probability: Array
    signal: SignalModel

    def levels(self, distance: Array) -> Array:
        """Amplitudes of the nodes at distances (n,) m, shape (n, K)."""
        return self.signal.amplitude(distance[:, None], PRODUCTS)


def reflected(rays: Rays, bank: Bank, drawn: Polylines, cells: Cells, signal: SignalModel) -> Reflected:
    """Belief over the product of the coefficients along every ray (paper 003, eq. (2)).

    A hit's own is made up of what the surface and the cells there believe, and of room for a surprise.

    Parameters
    ----------
    drawn : Polylines
        The rays as cast at sampled states.
    """
    from gridslam.kernels.coefficients import recall

    rays.check(len(bank), int(rays.anchor.max(initial=0)) + 1)
    belief = np.empty((len(rays), len(PRODUCTS)))
    if len(rays):
        frame = np.array([*cells.origin, cells.cell, OTHER_MATERIAL])
        recall(drawn.flat, rays.table, cells.held, bank.reflection, frame, belief)
    return Reflected(belief, signal)


def coefficient_factors(
    told: Told, rows: NDArray[np.intp], other: Array, table: DetectionTable, signal: SignalModel
) -> Array:
    """Log-likelihood over one coefficient of some paths, softly weighted by association, (n, BINS).

    Rician for detections, ``1 - p_d`` for misses: detections alone are biased by the threshold
    (model.md, section 2.5).

    Parameters
    ----------
    rows : (n,)
        Which of the paths; one may come up several times, with different others.
    other : (n,)
        Product of the path's other coefficients.
    """
    level = signal.amplitude(told.distance[rows, None], REFLECTION_BINS * other[:, None])
    missed = np.maximum(1 - told.share[rows], 0.0)[:, None]
    factor = missed * np.log(1 - told.chance[rows, None] * table(level) + 1e-9)
    row, pair = np.nonzero(rows[:, None] == told.path)
    if len(row):
        said = signal.log_rician(told.amplitude[pair, None], level[row])
        np.add.at(factor, row, told.weight[pair, None] * said)
    return np.asarray(factor)


def learn_reflection(bank: Bank, surface: NDArray[np.intp], factor: Array) -> None:
    """Multiply log-likelihoods (n, BINS) into the surfaces' beliefs, in place."""
    for row, log in zip(surface, factor, strict=True):
        posterior = bank.reflection[row] * np.exp(log - log.max()) + 1e-9
        bank.reflection[row] = posterior / posterior.sum()
