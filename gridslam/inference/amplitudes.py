"""Amplitude states of rays: a belief over every path's amplitude (paper 002, section III, eqs. (13), (26)).

Where the paper keeps particles, a histogram is kept, so that a ray that fades and one that is silent are
both told. Nodes stand densely enough for the amplitude's noise at any strength.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.heard import Heard
from gridslam.inference.likelihood import DetectionTable
from gridslam.inference.rays import P_APPEAR, P_STAY, Rays
from gridslam.signal import SignalModel

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
        walk = np.diag(1 - 2 * rate) + np.diag(rate[:-1], 1) + np.diag(rate[1:], -1)
        self._walk = walk / walk.sum(1, keepdims=True)
        self._gap = gap / gap.sum()
        self._kept: dict[tuple[int, int, int], tuple[Array, float]] = {}
        """Belief of every ray, and the length (m) of its path then."""

    def predict(self, rays: Rays, identity: NDArray[np.int64], distance: Array) -> Histogram:
        """Beliefs one step ahead, given that the ray exists.

        A ray that was there walks on, eq. (13), about what free space makes of its new length: near an
        anchor an amplitude doubles within a few steps. One that appears now may have any amplitude up to that
        of free space at its `distance` (L,).
        """
        reach = np.minimum(self.signal.amplitude(distance), self.nodes[-1])[:, None]
        fresh = self._gap * (self.nodes <= np.maximum(reach, 2 * self.nodes[0]))
        fresh = fresh / fresh.sum(1, keepdims=True)
        rows, kept = self._recall(rays, identity, distance)
        stayed = fresh.copy()
        stayed[rows] = kept @ self._walk
        before = np.clip((rays.existence - P_APPEAR) / (P_STAY - P_APPEAR), 0.0, 1.0)
        share = (P_APPEAR * (1 - before) / np.maximum(rays.existence, 1e-12))[:, None]
        return Histogram((1 - share) * stayed + share * fresh, self.nodes)

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
        prior = belief.probability + SURPRISE * self._gap
        silent = prior * np.maximum(1 - table(self.nodes), SURPRISE)
        missed = np.maximum(1 - responsible.sum(1, keepdims=True), 0.0)
        after = missed * silent / silent.sum(1, keepdims=True)
        loud = ~np.isnan(heard.amplitude)
        density = np.zeros((len(heard), len(self.nodes)))
        audible = np.minimum(heard.amplitude[loud, None], self.nodes[-1])
        density[loud] = self.signal.log_rician(audible, self.nodes)
        density = np.exp(density - density.max(1, keepdims=True))
        for m in np.flatnonzero(responsible.sum(0) > 1e-3):
            said = prior * density[m]
            after += responsible[:, m, None] * said / said.sum(1, keepdims=True)
        after /= np.maximum(after.sum(1, keepdims=True), 1e-12)
        for row, key in enumerate(self._keys(rays, identity)):
            if rays.existence[row] * rays.surfaces[row] > 0.01:
                self._kept[key] = after[row], float(distance[row])

    def start(self, ray: tuple[int, int, int], distance: float, amplitude: float) -> None:
        """First belief of the `ray` (anchor, last, first) that bore a surface, from the measurement alone."""
        if np.isfinite(amplitude) and np.isfinite(distance):
            log = self.signal.log_rician(np.minimum(amplitude, self.nodes[-1]), self.nodes)
            density = self._gap * np.exp(log - log.max())
            self._kept[ray] = density / density.sum(), distance

    def mean(self, rays: Rays, identity: NDArray[np.int64], distance: Array) -> Array:
        """Estimated amplitude of every ray, eq. (18), (L,)."""
        amplitude = 0.5 * self.signal.amplitude(distance)
        rows, kept = self._recall(rays, identity, distance)
        amplitude[rows] = kept @ self.nodes
        return np.asarray(amplitude)

    def _recall(
        self, rays: Rays, identity: NDArray[np.int64], distance: Array
    ) -> tuple[NDArray[np.intp], Array]:
        """Rays that a belief is kept of, and the beliefs at the lengths that their paths have now."""
        keys = self._keys(rays, identity)
        rows = np.array([row for row, key in enumerate(keys) if key in self._kept], dtype=np.intp)
        if not len(rows):
            return rows, np.zeros((0, len(self.nodes)))
        beliefs, then = zip(*(self._kept[keys[row]] for row in rows), strict=True)
        return rows, self._rescaled(np.stack(beliefs), np.array(then) / np.maximum(distance[rows], 1e-3))

    def _rescaled(self, belief: Array, factor: Array) -> Array:
        """Beliefs (n, K) about amplitudes that are now `factor` (n,) times what they were."""
        count = len(self.nodes)
        place = np.arcsinh(np.outer(factor, self.nodes / FINE)) / RATIO - 1
        place = np.clip(place, 0.0, count - 1.0)
        below = np.minimum(place.astype(np.intp), count - 2)
        above = belief * (place - below)
        cell = below + count * np.arange(len(belief))[:, None]
        total = np.bincount(cell.ravel(), (belief - above).ravel(), belief.size)
        total += np.bincount(cell.ravel() + 1, above.ravel(), belief.size)
        return np.asarray(total, np.float64).reshape(belief.shape)

    def forget(self, alive: Iterable[int]) -> None:
        """Drop the rays of surfaces that are no more."""
        living = {-1, *(int(i) for i in alive)}
        self._kept = {key: value for key, value in self._kept.items() if {*key[1:]} <= living}

    @staticmethod
    def _keys(rays: Rays, identity: NDArray[np.int64]) -> list[tuple[int, int, int]]:
        named = np.append(identity, -1)
        return list(
            zip(rays.anchor.tolist(), named[rays.last].tolist(), named[rays.first].tolist(), strict=True)
        )
