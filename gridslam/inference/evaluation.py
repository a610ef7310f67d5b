"""Likelihood ratios of measurements under paths (paper 002, section IV); owner of the evaluation kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.geometry import wrap
from gridslam.inference.heard import Heard
from gridslam.inference.likelihood import Strengths, deviations
from gridslam.inference.particles import Cloud
from gridslam.inference.prediction import Prediction
from gridslam.inference.rays import Rays
from gridslam.kernels import PATH_BLOCK
from gridslam.signal import SignalModel

Array = NDArray[np.float64]
GATE = 6.0
MARGIN_M = 0.3
"""Widening of the gate for what the linearised spread doesn't tell."""
UNMEASURED = 1e12


@dataclass(frozen=True)
class Pairs:
    """Pairs of a path and a measurement that may belong together, sorted by path.

    Attributes
    ----------
    path, measurement : (K,) int
    variance : (K, 3)
        Of the measured distance (m^2), AoD, AoA (rad^2); `UNMEASURED` stands for none.
    density : (K,)
        What isn't geometry: amplitude over clutter, and the constants of factors left out.
    """

    path: NDArray[np.intp]
    measurement: NDArray[np.intp]
    variance: Array
    density: Array

    def __len__(self) -> int:
        return len(self.path)


def gate(
    predicted: Prediction, heard: Heard, strength: Strengths, worth: Array, signal: SignalModel
) -> Pairs:
    """Pick the pairs worth evaluating: distance and angles within reach of what is predicted.

    Parameters
    ----------
    worth : (L,)
        Paths below a millionth are left out.
    """
    gap = heard.value[None] - predicted.value[:, None]
    gap[..., 1:] = wrap(gap[..., 1:])
    gap = np.abs(np.nan_to_num(gap))
    spread = np.diagonal(predicted.spread, axis1=1, axis2=2)[:, None]
    shape = gap.shape[:2]
    path, measurement = (a.ravel() for a in np.indices(shape))
    std = deviations(heard, measurement, strength.amplitude.ravel(), predicted.value[path, 1:], signal)
    reach = GATE * np.sqrt(spread + np.where(np.isfinite(std), std, 0.0).reshape(*shape, 3) ** 2)
    reach[..., 0] += MARGIN_M
    near = (gap[..., 0] < reach[..., 0]) & (gap[..., 1:] < reach[..., 1:] + 0.3).all(-1)
    near &= (worth > 1e-6)[:, None] & (strength.ratio > 0)
    chosen = np.flatnonzero(near)
    std = std[chosen]
    missing = ~np.isfinite(std)
    # a factor that was not measured is left out on both sides: its clutter density cancels
    flat = np.array([signal.max_distance_m, 2 * np.pi, 2 * np.pi])
    absent = np.where(missing, np.sqrt(2 * np.pi * UNMEASURED) / flat, 1.0).prod(1)
    return Pairs(
        path[chosen],
        measurement[chosen],
        np.where(missing, UNMEASURED, np.maximum(std, 1e-6) ** 2),
        strength.ratio.ravel()[chosen] * absent,
    )


def evaluate(
    rays: Rays, cloud: Cloud, pairs: Pairs, predicted: Prediction, heard: Heard
) -> tuple[Array, Array, NDArray[np.float32]]:
    """Mean over the particles of ratio and possibility, for all paths in one launch.

    Returns
    -------
    (ratio, possible, blocks)
        ratio (L, M): p_d f(z | path) / (mu_fa f_fa(z)), 0 where the path is impossible; possible (L,): share
        of the particles at which the path is possible; blocks (K, P / PATH_BLOCK): sums of each
        pair's weights over blocks of particles.
    """
    runtime.start()
    from gridslam.kernels.paths import evaluate as launch

    count, (rows, particles) = len(rays), cloud.state.shape
    if particles % PATH_BLOCK:
        raise ValueError(f"cloud of {particles}: whole blocks of {PATH_BLOCK} are needed")
    rays.check(rows // 3 - 1, heard.anchor + 1)
    total = cloud.kept * predicted.spread[pairs.path] + pairs.variance[:, None, :] * np.eye(3)
    determinant, inverse = _inverted(total)
    value = np.nan_to_num(heard.value[pairs.measurement])
    table = np.zeros((max(len(pairs), 1), 11), np.float32)
    some = table[: len(pairs)]
    some[:, :3] = value
    some[:, 3:9] = inverse
    reach = np.minimum(GATE * np.sqrt(total[:, 0, 0]), 1e5)
    some[:, 9], some[:, 10] = np.maximum(value[:, 0] - reach, -1e5), value[:, 0] + reach
    start = np.searchsorted(pairs.path, np.arange(count + 1))
    out = np.zeros((count + len(pairs), particles // PATH_BLOCK), np.float32)
    launch(
        cloud.state,
        np.column_stack([rays.table[:, :3], start[:-1], start[1:]]).astype(np.int32),
        table,
        np.array([*heard.place, heard.facing], np.float32),
        out,
    )
    mean = out.sum(1, dtype=np.float64) / particles
    ratio = np.zeros((count, len(heard)))
    scale = np.sqrt((2 * np.pi) ** 3 * determinant)
    ratio[pairs.path, pairs.measurement] = pairs.density * mean[count:] / scale
    return ratio, mean[:count], out[count:]


def _inverted(matrix: Array) -> tuple[Array, Array]:
    """Determinants (K,) of symmetric matrices (K, 3, 3), and their inverses (K, 6): 00 11 22 01 02 12."""
    a, b, c = matrix[:, 0, 0], matrix[:, 1, 1], matrix[:, 2, 2]
    d, e, f = matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2]
    adjugate = np.empty((len(matrix), 6))
    adjugate[:, 0], adjugate[:, 1], adjugate[:, 2] = b * c - f * f, a * c - e * e, a * b - d * d
    adjugate[:, 3], adjugate[:, 4], adjugate[:, 5] = e * f - c * d, d * f - b * e, d * e - a * f
    determinant = a * adjugate[:, 0] + d * adjugate[:, 3] + e * adjugate[:, 4]
    return determinant, adjugate / determinant[:, None]


def effective_sample_size(blocks: NDArray[np.float32]) -> Array:
    """Effective number of the particles behind each pair (K,), from sums of weights over blocks of them.

    Blocks are sums of independent weights, so their spread tells that of the weights.
    """
    particles = blocks.shape[1] * PATH_BLOCK
    sums = blocks.astype(np.float64)
    spread = PATH_BLOCK * sums.var(1) / np.maximum(sums.mean(1), 1e-100) ** 2
    return np.asarray(np.maximum(particles / (1 + np.minimum(spread, 1e12)), 1.0))
