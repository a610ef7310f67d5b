"""Likelihood ratios of measurements under paths (paper 002, section IV); owner of these kernels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.heard import Heard
from gridslam.inference.likelihood import AmplitudeBelief, DetectionTable
from gridslam.inference.particles import Cloud, Recipe
from gridslam.inference.prediction import Prediction
from gridslam.inference.rays import Rays
from gridslam.kernels import PATH_BLOCK

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pairs:
    """Pairs of a path and a measurement that may belong together, sorted by path.

    Attributes
    ----------
    index : (K, 2) int32
        Path and measurement.
    start : (L + 1,) int32
        Where the pairs of each path begin.
    pair : (K, 8)
        Measured distance, AoD, AoA; their variances (m^2, rad^2), `UNMEASURED` for none; density, which is
        what isn't geometry (amplitude over clutter, and the constants of factors left out); determinant of a
        particle's covariance.
    table : (K or 1, 11) float32
        What the evaluation kernel takes.
    """

    index: NDArray[np.int32]
    start: NDArray[np.int32]
    pair: Array
    table: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.index)

    @property
    def path(self) -> NDArray[np.int32]:
        """Path of every pair, (K,)."""
        return self.index[:, 0]

    @property
    def measurement(self) -> NDArray[np.int32]:
        """Measurement of every pair, (K,)."""
        return self.index[:, 1]

    def against(self, clutter: float) -> Pairs:
        """The same against a clutter level `clutter` times as high."""
        scaled = self.pair.copy()
        scaled[:, 6] /= clutter
        return replace(self, pair=scaled)


@dataclass(frozen=True)
class Evaluation:
    """What the measurements say of every path.

    Attributes
    ----------
    prior : (4, L)
        Existence of the ray, that of its surfaces, V and detection probability, before.
    blocks : (L + K, P / PATH_BLOCK) float32
        Over blocks of particles: at how many the path is possible; sums of each pair's weights; where the
        device has them.
    ratio : (L, M)
        p_d f(z | path) / (mu_fa f_fa(z)), given that the path is possible.
    beta : (L, M)
        Message of every path into the association for "caused measurement m".
    odds : (4, L)
        V where the path is possible; chance that it is there, if its surfaces are; chance that it is there;
        its message for "caused none".
    explained : (M,)
        Sum of `beta`.
    """

    prior: Array
    blocks: runtime.Resident
    ratio: Array
    beta: Array
    odds: Array
    explained: Array

    @property
    def chance(self) -> Array:
        """Chance that the path is there, if its surfaces are, (L,)."""
        return self.odds[1]

    @property
    def missed(self) -> Array:
        """Message of every path into the association for "caused none", (L,)."""
        return self.odds[3]


def gate(
    predicted: Prediction, heard: Heard, amplitudes: AmplitudeBelief, worth: Array, table: DetectionTable,
    radio: Array, kept: float,
) -> tuple[Pairs, Array]:  # fmt: skip
    """Pick the pairs worth evaluating: distance and angles within reach of what is predicted.

    Parameters
    ----------
    worth : (L,)
        Paths below a millionth are left out.
    radio : (11,)
        `SignalModel.radio` of the anchor.
    kept : float
        Share of the belief's covariance that each particle keeps.

    Returns
    -------
    (pairs, detected)
        detected (L,): detection probability of every path.
    """
    runtime.start()
    from gridslam.kernels.gating import gate as launch

    paths, count, nodes = len(worth), len(heard), amplitudes.nodes
    room = max(paths * count, 1)
    start, index = np.empty(paths + 1, np.int32), np.empty((room, 2), np.int32)
    pair, evaluated = np.empty((room, 8)), np.zeros((room, 11), np.float32)
    detected = np.empty(paths)
    launch(
        amplitudes.probability, nodes, float(amplitudes.spreading), predicted.whole, worth, heard.table,
        table.chance, table.step, radio, kept, runtime.scratch("density", (2, count, len(nodes))), detected,
        runtime.scratch("strength", (2, paths, count)), start, index, pair, evaluated,
    )  # fmt: skip
    found = int(start[-1])
    return Pairs(index[:found], start, pair[:found], evaluated[: max(found, 1)]), detected


def evaluate(
    rays: Rays, recipe: Recipe, pairs: Pairs, heard: Heard, prior: Array
) -> tuple[Cloud, Evaluation]:
    """Draw the particles, and evaluate all pairs and paths at them in one launch.

    Parameters
    ----------
    prior : (4, L)
        See `Evaluation`.
    """
    runtime.start()
    from gridslam.kernels.association import enter
    from gridslam.kernels.paths import evaluate as launch

    count, (rows, particles) = len(rays), recipe.room
    if particles % PATH_BLOCK:
        raise ValueError(f"{particles} particles: whole blocks of {PATH_BLOCK} are needed")
    rays.check(rows // 3 - 1)
    state = runtime.room((rows, particles))
    room = (count + len(pairs), particles // PATH_BLOCK)
    blocks = runtime.room(room) if count else np.empty(room, np.float32)  # a GPU has none without rows
    place = heard.spot.astype(np.float32)
    launch(
        recipe.root, recipe.base, recipe.points, state, rays.table, pairs.start, pairs.table, place, blocks
    )
    ratio, beta = np.empty((2, count, len(heard)))
    odds, explained = np.empty((4, count)), np.empty(len(heard))
    enter(blocks, pairs.index, pairs.pair, prior, ratio, beta, odds, explained)
    return Cloud(state, recipe.kept), Evaluation(prior, blocks, ratio, beta, odds, explained)
