"""Reflection coefficients: beliefs about products of them along paths, and what amplitudes say of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.likelihood import DetectionTable
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


def _split() -> Array:
    """Weights (BINS, BINS, K) that share the product of two bins between its neighbouring nodes."""
    place = np.outer(REFLECTION_BINS, REFLECTION_BINS) * len(PRODUCTS) - 1
    low = np.clip(np.floor(place).astype(int), 0, len(PRODUCTS) - 2)
    part = np.clip(place - low, 0.0, 1.0)
    weights = np.zeros((BINS, BINS, len(PRODUCTS)))
    i, j = np.indices((BINS, BINS))
    weights[i, j, low] += 1 - part
    weights[i, j, low + 1] += part
    return weights


SPLIT = _split()


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


def reflected(rays: Rays, bank: Bank, at_last: Array, at_first: Array, signal: SignalModel) -> Reflected:
    """Belief over the product of the coefficients along every ray (paper 003, eq. (2)).

    Parameters
    ----------
    at_last, at_first : (L, BINS)
        Log-likelihoods that the cells hold where the ray meets its last and first surface.
    """
    probability = np.zeros((len(rays), len(PRODUCTS)))
    probability[rays.bounces == 0, -1] = 1.0
    single, double = np.flatnonzero(rays.bounces == 1), np.flatnonzero(rays.bounces == 2)
    probability[single, ::2] = _local(bank, rays.last[single], at_last[single])
    last = _local(bank, rays.last[double], at_last[double])
    first = _local(bank, rays.first[double], at_first[double])
    joint = (last[:, :, None] * first[:, None, :]).reshape(len(double), BINS * BINS)
    probability[double] = joint @ SPLIT.reshape(BINS * BINS, -1)
    return Reflected(probability, signal)


def _local(bank: Bank, surface: NDArray[np.intp], at_cell: Array) -> Array:
    """Belief over the coefficient at a hit: the surface's, the cell's own, and room for a surprise."""
    local = bank.reflection[surface] * np.exp(at_cell - at_cell.max(1, keepdims=True, initial=-np.inf))
    total = local.sum(1, keepdims=True)
    local = np.where(total > 1e-12, local / np.maximum(total, 1e-12), 1 / BINS)
    return (1 - OTHER_MATERIAL) * local + OTHER_MATERIAL / BINS


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
