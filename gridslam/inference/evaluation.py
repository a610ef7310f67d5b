"""Likelihood ratios of measurements under paths (paper 002, section IV); owner of these kernels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.heard import Heard
from gridslam.inference.likelihood import FAINTEST, Strengths
from gridslam.inference.particles import Cloud, Recipe
from gridslam.inference.prediction import Prediction
from gridslam.inference.rays import Rays
from gridslam.kernels import PATH_BLOCK
from gridslam.signal import SignalModel

Array = NDArray[np.float64]
GATE = 6.0
MARGIN_M, MARGIN_RAD = 0.3, 0.3
"""Widening of the gate for what the linearised spread doesn't tell."""
LEAST_STD = 1e-6
UNMEASURED = 1e12
"""Variance that stands for "not measured"."""


@dataclass(frozen=True)
class Pairs:
    """Pairs of a path and a measurement that may belong together, sorted by path.

    Attributes
    ----------
    path, measurement : (K,) int
    start : (L + 1,) int32
        Where the pairs of each path begin.
    pair : (K, 9)
        Measured distance, AoD, AoA; their variances (m^2, rad^2), `UNMEASURED` for none; density, which is
        what isn't geometry (amplitude over clutter, and the constants of factors left out); a place for the
        message nu; determinant of a particle's covariance.
    table : (K or 1, 11) float32
        What the evaluation kernel takes.
    """

    path: NDArray[np.int32]
    measurement: NDArray[np.int32]
    start: NDArray[np.int32]
    pair: Array
    table: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.path)

    @property
    def variance(self) -> Array:
        """Variances of the measured distance, AoD and AoA, (K, 3)."""
        return self.pair[:, 3:6]

    def against(self, clutter: float) -> Pairs:
        """The same against a clutter level `clutter` times as high."""
        scaled = self.pair.copy()
        scaled[:, 6] /= clutter
        return replace(self, pair=scaled)


def gate(
    predicted: Prediction, heard: Heard, strength: Strengths, worth: Array, signal: SignalModel, kept: float
) -> Pairs:
    """Pick the pairs worth evaluating: distance and angles within reach of what is predicted.

    Parameters
    ----------
    worth : (L,)
        Paths below a millionth are left out.
    kept : float
        Share of the belief's covariance that each particle keeps.
    """
    runtime.start()
    from gridslam.kernels.gating import gate as launch

    paths, count = strength.ratio.shape
    own = np.where(np.isnan(heard.own_std), 0.0, np.maximum(heard.own_std, LEAST_STD))
    own = np.where(np.isnan(heard.value), -1.0, own)
    room = max(paths * count, 1)
    start, index = np.zeros(paths + 1, np.int32), np.empty((room, 2), np.int32)
    pair, table = np.empty((room, 9)), np.zeros((room, 11), np.float32)
    given = 0.0 if signal.given_distance_std is None else signal.given_distance_std
    launch(
        predicted.whole,
        worth,
        np.concatenate([np.nan_to_num(heard.value), own], 1),
        np.stack([strength.ratio, strength.amplitude]),
        np.array(
            [
                signal.distance_scale, given, *signal.anchor_aperture[heard.anchor], *signal.agent_aperture,
                signal.max_distance_m, kept, GATE, MARGIN_M, MARGIN_RAD, UNMEASURED, FAINTEST,
            ]
        ),
        start,
        index,
        pair,
        table,
    )  # fmt: skip
    found = int(start[-1])
    return Pairs(index[:found, 0], index[:found, 1], start, pair[:found], table[: max(found, 1)])


def evaluate(
    rays: Rays, recipe: Recipe, pairs: Pairs, heard: Heard
) -> tuple[Cloud, Array, Array, NDArray[np.float32]]:
    """Draw the particles, and take means over them of ratio and possibility, for all paths in one launch.

    Returns
    -------
    (cloud, ratio, possible, blocks)
        cloud: the particles; ratio (L, M): p_d f(z | path) / (mu_fa f_fa(z)), 0 where the path is impossible;
        possible (L,): share of the particles at which the path is possible; blocks (K, P / PATH_BLOCK): sums
        of each pair's weights over blocks of particles.
    """
    runtime.start()
    from gridslam.kernels.paths import evaluate as launch

    count, (rows, particles) = len(rays), recipe.room
    if particles % PATH_BLOCK:
        raise ValueError(f"{particles} particles: whole blocks of {PATH_BLOCK} are needed")
    rays.check(rows // 3 - 1, heard.anchor + 1)
    state = runtime.room((rows, particles))
    out = np.empty((count + len(pairs), particles // PATH_BLOCK), np.float32)
    place = np.array([*heard.place, heard.facing], np.float32)
    launch(recipe.root, recipe.base, recipe.points, state, rays.table, pairs.start, pairs.table, place, out)
    mean = out.sum(1, dtype=np.float64) / particles
    ratio = np.zeros((count, len(heard)))
    scale = np.sqrt((2 * np.pi) ** 3 * pairs.pair[:, 8])
    ratio[pairs.path, pairs.measurement] = pairs.pair[:, 6] * mean[count:] / scale
    return Cloud(state, recipe.kept), ratio, mean[:count], out[count:]


def effective_sample_size(blocks: NDArray[np.float32]) -> Array:
    """Effective number of the particles behind each pair (K,), from sums of weights over blocks of them.

    Blocks are sums of independent weights, so their spread tells that of the weights.
    """
    particles = blocks.shape[1] * PATH_BLOCK
    sums = blocks.astype(np.float64)
    spread = PATH_BLOCK * sums.var(1) / np.maximum(sums.mean(1), 1e-100) ** 2
    return np.asarray(np.maximum(particles / (1 + np.minimum(spread, 1e12)), 1.0))
