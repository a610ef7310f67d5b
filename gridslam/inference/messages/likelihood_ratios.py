"""Likelihood ratios of measurements under paths; owner of that kernel.

[Li2026grid], eqs. (8) to (10); [Li2025adaptive], section IV; docs/model.md, (M22) to (M25).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.particles import Cloud
from gridslam.inference.messages.amplitudes import AmplitudeBelief, detection_table
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels import PATH_BLOCK
from gridslam.kernels.primitives import blocks, tables
from gridslam.kernels.primitives.blocks import Gating
from gridslam.world.filter_model import FilterModel
from gridslam.world.radio import RadioModel

PORTION = 16
"""Room for measurements comes in portions."""
NO_MESSAGE = 1e-30
"""Sum of a path's messages that its shares are taken of at least."""


@dataclass(frozen=True)
class Pairs:
    """Pairs of a path and a measurement that may belong together, sorted by path.

    Attributes
    ----------
    count : int
        K.
    start : (L + 1,) int32
        Where the pairs of each path begin.
    index : (K or more, 2) int32
        Path and measurement.
    pair : (K or more, 8)
        Measured distance, AoD, AoA; their variances (m^2, rad^2), `UNMEASURED` for none; density, which is
        what isn't geometry (amplitude over clutter, and the constants of factors left out); determinant of a
        particle's covariance.
    """

    count: int
    start: NDArray[np.int32]
    index: NDArray[np.int32]
    pair: Array

    def __len__(self) -> int:
        return self.count

    def block(self, sums: runtime.Resident) -> blocks.Pairs:
        """As kernels take them, with sums over blocks of particles."""
        return blocks.Pairs(self.start, self.index, self.pair, sums)


@dataclass(frozen=True)
class LikelihoodRatios:
    """Likelihood ratios of measurements under paths of one anchor, or of all, and the messages from them.

    Attributes
    ----------
    pairs : Pairs
    blocks : (L + K or more, P / PATH_BLOCK) float32
        Over blocks of particles: number at which the path is possible, if V > 0; sum of each pair's weights.
        On the device.
    odds : (12, L)
        By path, rows as in `gridslam.kernels.primitives.tables`; the updates fill the last four, in a copy.
    message : (5, L, M)
        By path and measurement, rows as in `tables`; the association fills `CLAIM` and `NU`, the correction
        `RESPONSIBLE`, in a copy.
    measured : (5, M)
        By measurement, rows as in `tables`; births and updates fill the last three, in copies.
    """

    pairs: Pairs
    blocks: runtime.Resident
    odds: Array
    message: Array
    measured: Array

    @property
    def missed(self) -> Array:
        """Message of every path into the association for "caused none", (L,)."""
        return self.odds[tables.MISSED]

    @property
    def beta(self) -> Array:
        """Message of every path into the association for "caused measurement m", (L, M)."""
        return self.message[tables.BETA]

    @property
    def new(self) -> Array:
        """Message of every measurement into the association for "caused by no legacy path", (M,)."""
        return self.measured[tables.NEW]

    @property
    def explained(self) -> Array:
        """Ratio to clutter of what known paths explain of every measurement, (M,).

        Sum of `beta`, each times its share of all that its path may have caused; docs/model.md, below (M32).
        """
        return self.measured[tables.EXPLAINED]

    @property
    def clutter(self) -> float:
        """Expected amount of quiet clutter: measurements that known paths didn't cause, (M46)."""
        return float((self.measured[tables.QUIET] / (1 + self.explained)).sum())

    @property
    def responsible(self) -> Array:
        """Probability that the path caused the measurement, (L, M)."""
        return self.message[tables.RESPONSIBLE]

    def times(self, factor: Array) -> LikelihoodRatios:
        """The ratios with a further factor (L, M) of the likelihoods."""
        pair, message, measured = self.pairs.pair.copy(), self.message.copy(), self.measured.copy()
        row, m = self.pairs.index[: len(self.pairs)].T
        pair[: len(self.pairs), tables.DENSITY] *= factor[row, m]
        message[tables.RATIO] *= factor
        message[tables.BETA] *= factor
        beta = message[tables.BETA]
        among = np.maximum(beta.sum(1, keepdims=True), NO_MESSAGE)
        measured[tables.EXPLAINED] = (beta**2 / among).sum(0)  # as in the kernel's `enter`
        return replace(self, pairs=replace(self.pairs, pair=pair), message=message, measured=measured)

    def against(self, clutter: float) -> LikelihoodRatios:
        """The ratios against a clutter level `clutter` times as high."""
        pair, message, measured = self.pairs.pair.copy(), self.message.copy(), self.measured.copy()
        pair[: len(self.pairs), tables.DENSITY] /= clutter
        message[tables.RATIO] /= clutter
        message[tables.BETA] /= clutter
        measured[tables.EXPLAINED] /= clutter
        return replace(self, pairs=replace(self.pairs, pair=pair), message=message, measured=measured)


def _buffers(paths: int, count: int, nodes: int, particles: int) -> tuple[Gating, blocks.Pairs]:
    """Reusable buffers of an evaluation of so many paths, measurements, nodes and particles."""
    most = max(paths * count, 1)
    scratch = np.empty((2, count, nodes)), np.empty((2, paths, count)), np.empty((most, 11), np.float32)
    start, index, pair = np.empty(paths + 1, np.int32), np.empty((most, 2), np.int32), np.empty((most, 8))
    sums = runtime.room((paths + most, particles // PATH_BLOCK))
    return Gating(*scratch), blocks.Pairs(start, index, pair, sums)


def _states(rows: int, particles: int) -> runtime.Resident:
    """Room for the particles' states."""
    return runtime.room((rows, particles))


@timed("evaluation")
def evaluate(
    scan: AnchorScan,
    paths: PredictedPaths,
    validity: Array,
    amplitudes: AmplitudeBelief,
    radio: RadioModel,
    model: FilterModel,
    *,
    work: Workspace,
) -> tuple[Cloud, LikelihoodRatios]:
    """Pick pairs by distance and angles, draw the particles, and evaluate pairs and paths at them.

    [Li2026grid], eqs. (8) to (10), and what follows from them, (17) to (42); docs/model.md: particles (M22),
    ratios (M23), messages into the association (M24), (M25). The pairs and the sums over
    blocks of particles last until the same anchor's next evaluation, particles until the next of any.

    Parameters
    ----------
    validity : (L,)
        V: probability that the path is open.
    radio : RadioModel
        As the radio seems to be.
    """
    rays, recipe, table = paths.rays, paths.recipe, detection_table(model.radio)
    count, (rows, particles), nodes = len(scan), recipe.room, amplitudes.nodes
    if particles % PATH_BLOCK:
        raise ValueError(f"{particles} particles: whole blocks of {PATH_BLOCK} are needed")
    rays.check(recipe.layout.surfaces, len(model.anchors))
    broad = -(-count // PORTION) * PORTION  # shapes that last
    scratch, found = work.buffers(_buffers, scan.anchor, len(rays), broad, len(nodes), particles)
    ratios = blocks.Ratios(
        np.empty((tables.ODDS, len(rays))),
        np.empty((5, len(rays), count)),
        np.empty((tables.MEASURED_ROWS, count)),
    )
    launch, odds = _evaluating(), ratios.odds
    state = work.buffers(_states, 0, rows, particles)
    odds[tables.EXISTENCE], odds[tables.SURFACES], odds[tables.OPEN] = rays.existence, rays.surfaces, validity
    launch(
        1.0 if amplitudes.spreading else 0.0, table.step, recipe.layout.head, recipe.bandwidth,
        blocks.Amplitudes(amplitudes.probability, nodes, table.chance),
        blocks.PathRows(rays.table, paths.prediction.whole), scan.table,
        blocks.Anchors(model.places, radio.numbers),
        blocks.Drawing(recipe.root, recipe.base, recipe.points, state), scratch, found, ratios,
    )  # fmt: skip
    pairs = Pairs(int(found.start[-1]), found.start, found.index, found.pair)
    return Cloud(state, recipe.bandwidth, recipe.layout.unknowns), LikelihoodRatios(
        pairs, found.blocks, *ratios
    )


@runtime.once_started
def _evaluating() -> Any:
    """The kernel that evaluates pairs and paths."""
    from gridslam.kernels.messages.evaluation import evaluate

    return evaluate
