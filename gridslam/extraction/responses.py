"""Responses of paths in their factors (delay, departure, arrival), their derivatives and inner products.

A path's response is a product of three, so inner products of two paths are products of three small ones,
whatever the number of samples. Arrays are batches: S snapshots of one anchor, L paths in each. docs/model.md,
(M49), (M50).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.waveform import Waveform

Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Band:
    """One anchor's waveform: which factors there are, and how they respond.

    Attributes
    ----------
    waveform : Waveform
    anchor : int
    """

    waveform: Waveform
    anchor: int

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Which of distance (0), AoD (1), AoA (2) are parameters of a path: angles of several elements."""
        _, elements, carried, _ = self.waveform.shape
        return (0, *((1,) if elements > 1 else ()), *((2,) if carried > 1 else ()))

    @cached_property
    def samples(self) -> int:
        """Samples of a snapshot."""
        return int(np.prod(self.waveform.shape[1:]))

    @cached_property
    def elements(self) -> tuple[Array, Array]:
        """Antenna elements of the anchor and of the agent, (A, 2) and (B, 2) m."""
        return self.waveform.anchor_element_m[self.anchor], self.waveform.agent_element_m

    def sees(self, factor: int) -> bool:
        """Whether an angle can be told: elements that lie in one line leave two directions."""
        if factor not in self.free:
            return False
        if factor == 0:
            return True
        q = self.elements[factor - 1]
        spread = np.linalg.svd(q - q.mean(0), compute_uv=False)
        return bool(spread[-1] > 1e-6 * spread[0])

    def factor(self, factor: int, value: Array) -> tuple[Complex, Complex]:
        """Response of a factor to values (...), and its derivative by them, both (..., n)."""
        if factor == 0:
            slope = -2j * np.pi / SPEED_OF_LIGHT * self.waveform.offset_hz
            response = self.waveform.delay_response(value)
            return response, slope * response
        q, turn = self.elements[factor - 1], 2j * np.pi / self.waveform.wavelength_m
        x, y = np.cos(value)[..., None], np.sin(value)[..., None]
        response = np.exp(turn * (x * q[:, 0] + y * q[:, 1])) / np.sqrt(len(q))
        return response, turn * (x * q[:, 1] - y * q[:, 0]) * response

    def extent(self, factor: int) -> float:
        """How fast a factor's response changes: root mean square phase slope, rad per m or rad; see (M53)."""
        return self._slopes[factor]

    @cached_property
    def _slopes(self) -> tuple[float, float, float]:
        angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
        found = []
        for factor, values in ((0, np.zeros(1)), (1, angles), (2, angles)):
            response, slope = self.factor(factor, values)
            own = (response.conj() * slope).sum(-1)
            power = (np.abs(slope) ** 2).sum(-1) - np.abs(own) ** 2
            found.append(float(np.sqrt(np.maximum(power, 0)).mean()))
        return found[0], found[1], found[2]


@dataclass(frozen=True, eq=False)
class Products:
    """Inner products of L paths with each other and with the samples of S snapshots.

    Derivatives are by the free parameters, P in all; index 0 stands for the response itself.

    Attributes
    ----------
    gram : (S, 1 + P, L, 1 + P, L) complex
        ``gram[s, p, l, q, m]``: response (p = 0) or derivative p of path l with that of m.
    matched : (S, 1 + P, L) complex
        The same with the samples.
    """

    gram: Complex
    matched: Complex

    @classmethod
    def of(cls, band: Band, samples: Complex, paths: Array, derivatives: bool = True) -> Products:
        """Products of paths (S, L, 3) with samples (S, A, B, M); P = 0 without derivatives."""
        free = band.free if derivatives else ()
        pairs = [band.factor(factor, paths[..., factor]) for factor in range(3)]
        kinds = [(0, 0, 0), *(tuple(int(f == one) for f in range(3)) for one in free)]
        grams = [
            {
                (p, q): np.einsum("sln,smn->slm", pair[p].conj(), pair[q], optimize=True)
                for p in (0, 1)
                for q in (0, 1)
                if factor in free or p == q == 0
            }
            for factor, pair in enumerate(pairs)
        ]
        count, paths_in = paths.shape[:2]
        gram = np.empty((count, len(kinds), paths_in, len(kinds), paths_in), np.complex128)
        matched = np.empty((count, len(kinds), paths_in), np.complex128)
        for row, left in enumerate(kinds):
            for column, right in enumerate(kinds):
                whole = 1.0
                for factor in range(3):
                    whole = whole * grams[factor][left[factor], right[factor]]
                gram[:, row, :, column] = whole
            delay, leaving, arriving = (pairs[f][left[f]] for f in (0, 1, 2))
            matched[:, row] = project(samples, delay, leaving, arriving)
        return cls(gram, matched)


def project(samples: Complex, delay: Complex, leaving: Complex, arriving: Complex) -> Complex:
    """Inner products (S, L) of factors (S, L, M), (S, L, A), (S, L, B) with samples (S, A, B, M)."""
    if samples.shape[1] == samples.shape[2] == 1:
        found = np.einsum("slm,sm->sl", delay.conj(), samples[:, 0, 0], optimize=True)
        return np.asarray(found * (leaving * arriving).conj()[..., 0])
    part = np.einsum("slm,sabm->slab", delay.conj(), samples, optimize=True)
    return np.asarray(np.einsum("sla,slb,slab->sl", leaving.conj(), arriving.conj(), part, optimize=True))


def compose(band: Band, paths: Array, amplitudes: Complex) -> Complex:
    """Samples (S, A, B, M) that paths (S, L, 3) of amplitudes (S, L) make."""
    delay, leaving, arriving = (band.factor(factor, paths[..., factor])[0] for factor in range(3))
    return np.asarray(np.einsum("sl,slm,sla,slb->sabm", amplitudes, delay, leaving, arriving, optimize=True))
