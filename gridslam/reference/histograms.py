"""Twins of the kernels that keep histograms of amplitudes."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.reference.messages import log_rician


def rescaled(belief: Array, factor: Array, nodes: Array, fine: float, ratio: float) -> Array:
    """Histograms (n, K) of amplitudes that are now `factor` (n,) times what they were."""
    count = len(nodes)
    place = np.clip(np.arcsinh(np.outer(factor, nodes / fine)) / ratio - 1, 0.0, count - 1.0)
    below = np.minimum(place.astype(np.intp), count - 2)
    total, rows = np.zeros(belief.shape), np.arange(len(belief))[:, None]
    np.add.at(total, (rows, below), belief * (1 - place + below))
    np.add.at(total, (rows, below + 1), belief * (place - below))
    return total


def walk(earlier: Array, length: Array, existence: Array, table: Array, number: Array) -> Array:
    """Twin of `histograms.walk`: histograms ahead (L, K)."""
    nodes, gap, stay, rise, fall = table[:5]
    fine, ratio, at_1m, p_stay, p_appear, _, level, weakened = number
    step = np.diag(stay) + np.diag(rise[:-1], 1) + np.diag(fall[1:], -1)
    free = at_1m / np.maximum(length[2], 1e-3)
    fresh = gap * (nodes <= np.maximum(np.minimum(free, nodes[-1]), 2 * nodes[0])[:, None])
    fresh = fresh / fresh.sum(1, keepdims=True)
    straight, far = length[3] >= 0, np.maximum(length[1], 1e-3)
    mean = np.minimum(at_1m / far, nodes[-1])
    deviation = mean * np.hypot(level, length[3] / far) + fine * ratio
    free = gap * np.exp(-0.5 * ((nodes - mean[:, None]) / deviation[:, None]) ** 2)
    free = (1 - weakened) * free / free.sum(1, keepdims=True) + weakened * fresh
    fresh = np.where(straight[:, None], free, fresh)
    rows, stayed = length[0] >= 0, fresh.copy()
    now = rescaled(earlier[rows], length[0, rows] / np.maximum(length[1, rows], 1e-3), nodes, fine, ratio)
    stayed[rows] = now @ step
    before = np.clip((existence - p_appear) / (p_stay - p_appear), 0.0, 1.0)
    share = (p_appear * (1 - before) / np.maximum(existence, 1e-12))[:, None]
    return np.asarray((1 - share) * stayed + share * fresh)


def listen(
    ahead: Array, scan: Array, responsible: Array, table: Array, number: Array, samples: float
) -> Array:
    """Twin of `histograms.listen`: histograms (L, K) after what was heard."""
    nodes, gap, silent = table[[0, 1, 5]]
    prior = ahead + number[5] * gap
    missed = np.maximum(1 - responsible.sum(1, keepdims=True), 0.0)
    after = missed * prior * silent / (prior * silent).sum(1, keepdims=True)
    for m in np.flatnonzero(responsible.sum(0) > 1e-3):
        audible, density = min(scan[m, 6], nodes[-1]), np.ones(len(nodes))
        if audible > 0:
            log = log_rician(audible, nodes, samples)
            density = np.exp(log - log.max())
        posterior = prior * density
        after += responsible[:, m, None] * posterior / posterior.sum(1, keepdims=True)
    return np.asarray(after / np.maximum(after.sum(1, keepdims=True), 1e-12))
