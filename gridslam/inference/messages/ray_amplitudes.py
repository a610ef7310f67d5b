"""Amplitude states of rays: a belief over every path's amplitude (paper 002, section III, eqs. (13), (26)).

Where the paper keeps particles, a histogram is kept, so that a ray that fades and one that is silent are
both told. Nodes stand densely enough for the amplitude's noise at any strength. Owner of their kernels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.messages.likelihood import DetectionTable
from gridslam.inference.messages.likelihood_ratios import PORTION
from gridslam.inference.state.anchor_measurements import Heard
from gridslam.inference.state.rays import P_APPEAR, P_STAY, Rays
from gridslam.world.radio import SignalModel

Array = NDArray[np.float64]
WALK = 0.02
"""Random walk of an amplitude per step, as a share of it (paper 002, section VI-A)."""
SURPRISE = 1e-9
"""Weight of any amplitude at all, should the one that was measured be out of all expectation."""
FINE, RATIO = 11.7, 0.03
"""Nodes ``FINE sinh(RATIO k)``: 0.35 apart where faint, 3 % apart where strong."""
NEAREST_M = 0.2
"""Distance of free space whose amplitude is the last node; anything louder counts as that."""


@dataclass(frozen=True)
class Histogram:
    """Amplitudes of paths over fixed nodes (an `AmplitudeBelief`).

    Attributes
    ----------
    probability : (L, K)
    nodes : (K,)
    """

    probability: Array
    nodes: Array

    spreading = False


class RayAmplitudes:
    """Amplitude beliefs of all rays, kept by anchor and the identities of the surfaces they meet."""

    def __init__(self, signal: SignalModel) -> None:
        self.signal = signal
        count = int(np.ceil(np.arcsinh(float(signal.amplitude(NEAREST_M)) / FINE) / RATIO))
        self.nodes: Array = FINE * np.sinh(RATIO * (np.arange(count) + 1))
        gap = np.gradient(self.nodes)
        rate = 0.5 * np.square(WALK * self.nodes / gap)
        rise, fall = np.append(rate[:-1], 0.0), np.append(0.0, rate[1:])
        walk = np.stack([1 - 2 * rate, rise, fall])
        self._gap = gap / gap.sum()
        self._table = np.stack([self.nodes, self._gap, *(walk / walk.sum(0)), np.zeros(count)])
        self._number = np.array([FINE, RATIO, signal.amplitude_at_1m, P_STAY, P_APPEAR, SURPRISE])
        self._detected: DetectionTable | None = None
        self._kept: dict[tuple[int, int, int], tuple[Array, float]] = {}
        """Belief of every ray, and the length (m) of its path then."""
        self._alive: bytes | None = None

    def predict(self, rays: Rays, identity: NDArray[np.int64], distance: Array) -> Histogram:
        """Beliefs one step ahead, given that the ray exists.

        A ray that was there walks on, eq. (13), about what free space makes of its new length: near an
        anchor an amplitude doubles within a few steps. One that appears now may have any amplitude up to that
        of free space at its `distance` (L,).
        """
        return Histogram(self._walked(rays, identity, distance)[0], self.nodes)

    def correct(
        self, rays: Rays, identity: NDArray[np.int64], belief: Histogram, distance: Array, heard: Heard,
        responsible: Array, table: DetectionTable,
    ) -> None:  # fmt: skip
        """Multiply in what was heard, softly by association, eq. (26).

        Parameters
        ----------
        distance : (L,) m
        responsible : (L, M)
            Probability that the path caused the measurement.
        """
        runtime.start()
        from gridslam.kernels.messages.histograms import SILENT, listen

        if table is not self._detected:
            self._table[SILENT], self._detected = np.maximum(1 - table(self.nodes), SURPRISE), table
        shape = belief.probability.shape
        if responsible.shape != (len(rays), len(heard)) or shape != (len(rays), len(self.nodes)):
            raise ValueError("beliefs don't belong to these rays and measurements")
        after = np.empty(shape)  # whose rows are kept
        room = runtime.scratch("amplitudes heard", (-(-len(heard) // PORTION) * PORTION, shape[1]))
        listen(
            belief.probability, heard.table, np.ascontiguousarray(responsible), self._table, self._number,
            float(self.signal.samples), room, after,
        )  # fmt: skip
        worth = (rays.existence * rays.surfaces > 0.01).tolist()
        for row, (key, length) in enumerate(zip(self._keys(rays, identity), distance.tolist(), strict=True)):
            if worth[row]:
                self._kept[key] = after[row], length

    def start(self, ray: tuple[int, int, int], distance: float, amplitude: float) -> None:
        """First belief of the `ray` (anchor, last, first) that bore a surface, from the measurement alone."""
        self._alive = None  # a surface that dies in the step of its birth leaves rays behind, too
        if np.isfinite(amplitude) and np.isfinite(distance):
            log = self.signal.log_rician(np.minimum(amplitude, self.nodes[-1]), self.nodes)
            density = self._gap * np.exp(log - log.max())
            self._kept[ray] = density / density.sum(), distance

    def mean(self, rays: Rays, identity: NDArray[np.int64], distance: Array) -> Array:
        """Estimated amplitude of every ray, eq. (18), (L,)."""
        return self._walked(rays, identity, distance)[1]

    def _walked(self, rays: Rays, identity: NDArray[np.int64], distance: Array) -> tuple[Array, Array]:
        """Beliefs one step ahead (L, K), and mean amplitudes before that step (L,)."""
        runtime.start()
        from gridslam.kernels.messages.histograms import walk

        count, size = len(rays), len(self.nodes)
        kept = runtime.scratch("amplitudes kept", (count, size))
        length, scratch = runtime.scratch("lengths", (2, count)), runtime.scratch("amplitudes", (size,))
        ahead, mean = np.empty((count, size)), np.empty(count)
        length[0], length[1] = -1.0, distance
        for row, key in enumerate(self._keys(rays, identity)):
            known = self._kept.get(key)
            if known is not None:
                kept[row], length[0, row] = known
        walk(kept, length, rays.existence, self._table, self._number, scratch, ahead, mean)
        return ahead, mean

    def forget(self, alive: NDArray[np.int64]) -> None:
        """Drop the rays of surfaces that are no more."""
        if alive.tobytes() != self._alive:  # else none can have gone
            living, self._alive = {-1, *alive.tolist()}, alive.tobytes()
            self._kept = {key: value for key, value in self._kept.items() if {*key[1:]} <= living}

    @staticmethod
    def _keys(rays: Rays, identity: NDArray[np.int64]) -> list[tuple[int, int, int]]:
        named = np.append(identity, -1)
        return list(
            zip(rays.anchor.tolist(), named[rays.last].tolist(), named[rays.first].tolist(), strict=True)
        )
