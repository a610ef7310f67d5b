"""Owner of the kernels on the paths of all anchors that are heard at a step; docs/model.md, (M126)-(M131)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.messages.features.path_products import Products, band_of, halves_of
from gridslam.inference.state.features.features import ENTRIES, MOVING
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.world.signal_model import SignalModel
from gridslam.world.waveform import Waveform

Complex = NDArray[np.complex128]
Indices = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Slopes:
    """What samples say of the numbers of paths.

    Attributes
    ----------
    score : (p,)
    curvature : (p, p)
        Of each anchor's paths alone.
    log_density : float
        Of the samples of all anchors.
    """

    score: Array
    curvature: Array
    log_density: float


class HeardPaths:
    """Lengths and angles of A anchors' paths, p in all, and products of their responses.

    Arrays are written anew by each call: whoever keeps one copies it.

    Parameters
    ----------
    belief : JointBelief
        As predicted, of n entries.
    samples : (J, N, M)
    audible : (J,) bool
    heading_rad : float
    own : (2,)
        Variances of lengths and angles of features' paths about what their places say.

    Attributes
    ----------
    anchors : list of int
        Which are heard.
    shift, own : (p,)
        Epsilon of (M281), and its variances.
    numbers, off : (p,)
        Of each anchor all lengths (m), then all angles (rad), and how far they are from the prior's.
    towards, spread : (p, n + 1), (p, p)
        Covariances of the numbers with the joint state and the heading's error, and with each other.
    """

    def __init__(
        self, belief: JointBelief, samples: Complex, audible: NDArray[np.bool_], heading_rad: float,
        model: SignalModel, own: tuple[float, float],
    ) -> None:  # fmt: skip
        runtime.start()
        bank, wave = belief.features, model.waveform
        self.anchors = [int(j) for j in np.flatnonzero(audible)]
        rows = [np.flatnonzero(bank.anchor == j) for j in self.anchors]
        self._wave, self._heading, count = wave, float(heading_rad), [1 + len(some) for some in rows]
        self._first = np.cumsum([0, *(2 * one for one in count)], dtype=np.int32)
        size, most, total = len(belief.mean) + 1, max(count), int(self._first[-1])
        self._entry = np.full(total // 2, -1, np.int32)
        self._origin, self._paths = np.empty((total // 2, 2)), np.zeros((4, total))
        self.numbers, self.off, self.shift, self.own = self._paths
        for j, some, start in zip(self.anchors, rows, self._first, strict=False):
            los, after = start // 2, start // 2 + 1 + len(some)
            self._entry[los + 1 : after] = MOVING + ENTRIES * some
            self._origin[los], self._origin[los + 1 : after] = model.anchors[j, :2], bank.origin_m[some]
            self.own[start + 1 : after + los], self.own[after + los + 1 : 2 * after] = own
        self.towards, self.spread = np.empty((total, size)), np.empty((total, total))
        self._slopes, heard = np.empty((total, 6)), samples[self.anchors]
        self._halves = halves_of(heard, wave)
        energy = [np.vdot(one, one).real for one in heard]
        self._facts = np.stack([belief.noise[self.anchors], energy, np.full(len(count), heard[0].size)], 1)
        self._gram, self._matched = (np.empty((len(count), 3 * most, n)) for n in (3 * most, 2))
        self._score, self._curvature = np.empty(total), np.zeros((total, total))
        self._density = np.empty(len(count))
        self._scratch = _scratch_of_products(most, wave), _scratch_of_slopes(most, total // 2)

    def place(self, state: Array, prior: Array) -> None:
        """Paths at a state.

        Parameters
        ----------
        state : (2, n + 1)
            Where slopes are taken, and the prior's mean.
        prior : (n + 1, n + 1)
            Covariance.
        """
        from gridslam.kernels.messages.path_places import place_paths

        place_paths(
            state, prior, self._origin, self._entry, self._first, self._heading, self._paths, self._slopes,
            self.towards, self.spread,
        )  # fmt: skip

    def multiply(self) -> list[Products]:
        """Products of the responses of each anchor's paths, their slopes by length and those by angle."""
        from gridslam.kernels.messages.path_products import multiply_paths

        band = band_of(self._wave)
        multiply_paths(
            self.numbers, self._first, band.table, band.element, self._halves, *self._scratch[0], self._gram,
            self._matched,
        )  # fmt: skip
        found = []
        for a, (_, energy, size) in enumerate(self._facts):
            rows = 3 * (self._first[a + 1] - self._first[a]) // 2
            matched = self._matched[a, :rows].view(np.complex128)[:, 0]
            found.append(Products(self._gram[a, :rows, :rows], matched, float(energy), int(size)))
        return found

    def slopes(self, power: Array) -> Slopes:
        """Of the likelihood, with so much power (p / 2,) in each path; after `multiply`."""
        from gridslam.kernels.messages.path_slopes import slope_paths

        slope_paths(
            self._gram, self._matched, self._first, power, self._facts, *self._scratch[1], self._score,
            self._curvature, self._density,
        )  # fmt: skip
        return Slopes(self._score, self._curvature, float(self._density.sum()))


def _scratch_of_products(most: int, wave: Waveform) -> tuple[Array, Array]:
    """Of `multiply_paths`, for so many paths of an anchor at most."""
    band = band_of(wave)
    return np.empty((most, 2, band.table.shape[1])), np.empty((most, 3, len(band.element)))


def _scratch_of_slopes(most: int, paths: int) -> tuple[Array, ...]:
    """Of `slope_paths`, for so many paths of an anchor at most, and of all anchors."""
    return np.empty((most, most)), np.empty((3 * most + 2, most)), np.empty((paths, 2))
