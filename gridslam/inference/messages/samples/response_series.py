"""Densities of a snapshot at many particles of several paths, by series over distance (M381).

Products of responses with each other, with the samples, and with what else is in the samples are functions of
one distance or of one difference, and band-limited: over the stretch that particles cover, a polynomial of
some 10 to 20 terms says each. So a particle of N paths costs N^2 of these and an N x N root, however many the
frequencies, and nothing is looked up.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.messages.samples.signal_likelihood import Band, Complex

EXACT = 1e-7
"""By which a series is off, of a response's norm."""
WIDEST = 10.0
"""Turn of phase (rad) over half a stretch, beyond which it is cut: powers of a wider one cancel in too many
digits."""
NEGLIGIBLE = 0.03
"""Power over the noise's, of a direction of samples, below which it is left out: each changes the log of a
density by about this, where the density is that of the samples; likely particles' by 0.003 in all."""
CHUNKS = 16
"""Into which particles are cut for threads, which share no scratch."""
TRUE = np.ones(1)
FAINTEST = 1e-9
"""Power over the noise's that a path has at least: as good as none."""


@dataclass(frozen=True, eq=False)
class ResponseSeries:
    """Responses, whitened by the noise and whatever else is in the samples.

    Attributes
    ----------
    wavenumber : (M,) float64, rad/m
        0 in their middle.
    size : (M,) float64
        Magnitudes of the pulse.
    real : bool
        Whether products of responses are real.
    seen : (M,) complex128
        The samples less what is explained by others, over the noise's deviation.
    others : (D, M) complex128
        Directions in which there is more than noise, times the root of the share of that in their power.
    """

    wavenumber: Array
    size: Array
    real: bool
    seen: Complex
    others: Complex

    @classmethod
    def of(cls, band: Band, samples: Complex, extra: Complex, noise: float) -> ResponseSeries:
        """What is needed of one snapshot.

        Parameters
        ----------
        samples : (M,) complex128
        extra : (M, M) complex128
            Covariance of the samples beside white noise and the particles' paths.
        noise : float
            Power of the noise in each sample.
        """
        # a common phase of each frequency, or of each path, changes no density
        size, turn = np.abs(band.pulse), np.exp(-1j * np.angle(band.pulse))
        samples, extra = turn * samples, turn[:, None] * extra * np.conj(turn)
        real = np.allclose(size, size[::-1], rtol=1e-12, atol=0)
        power, direction = np.zeros(0), extra[:, :0]
        if extra.trace().real > NEGLIGIBLE * noise:  # else no direction has as much
            power, direction = _directions(extra, real)
        strong = power > NEGLIGIBLE * noise
        share, direction = power[strong] / (power[strong] + noise), direction[:, strong]
        seen = samples - direction @ (share * (np.conj(direction).T @ samples))
        return cls(
            band.wavenumber - band.wavenumber.mean(), size, real,
            np.asarray(seen / np.sqrt(noise)), np.sqrt(share)[:, None] * direction.T,
        )  # fmt: skip

    def log_densities(self, distance: Array, power: Array) -> Array:
        """log CN(z; 0, C) at every particle (P,), less that without its paths.

        Parameters
        ----------
        distance, power : (N, P); m, over the noise's
        """
        count, particles = distance.shape
        if not count or not particles:
            return np.zeros(particles)
        low, high = distance.min(1), distance.max(1)
        widest, turn = int((high - low).argmax()), float(np.abs(self.wavenumber).max())
        reach = 0.5 * float(high[widest] - low[widest])
        if turn * reach > WIDEST:
            found, near = np.empty(particles), distance[widest] < low[widest] + reach
            for part in (near, ~near):
                found[part] = self.log_densities(distance[:, part], power[:, part])
            return found
        middle = 0.5 * (low + high)
        reach = max(reach, 1e-9)  # of one particle: any will do
        if self.real and count % 2:  # rows go in pairs: one more path of no power
            middle = np.append(middle, 0.0)
        products, rows = self._series(middle, reach, turn * reach)
        size, samples = len(middle), 2 // products.shape[2]
        offset, level = _blocks(size + samples, particles), _blocks(size, particles, FAINTEST)
        np.subtract(distance, middle[:count, None], out=offset[:count, :particles])
        offset /= reach
        np.maximum(power, FAINTEST, out=level[:count, :particles])
        return _weighed(offset, level, products, rows)[:particles]

    def _series(self, middle: Array, reach: float, turn: float) -> tuple[Array, Array]:
        """Products with each other and the samples, and with all directions, as `weigh_particles` takes them.

        Parameters
        ----------
        middle : (N,) m
        reach : float
            Half of the stretch about it, m.
        turn : float
            The phase that a response turns over it, at most, rad.
        """
        wave = np.exp(1j * np.outer(middle, self.wavenumber))
        node, powers = _fit(_terms(turn))
        beat = np.exp(1j * reach * np.outer(node, self.wavenumber))
        along = (wave[:, None] * (self.size * self.others)) @ beat.T @ powers
        node, powers = _fit(_terms(2 * turn))
        powers = powers * 0.5 ** np.arange(len(node) - 1, -1, -1)  # differences reach twice as far
        beat = np.exp(2j * reach * np.outer(node, self.wavenumber))
        pair = (wave[:, None] * np.conj(wave) * self.size**2) @ np.conj(beat).T @ powers
        seen = (wave * self.size * self.seen) @ beat.T @ powers
        if self.real:
            products = np.concatenate([pair.real, seen.real[None], seen.imag[None]])[:, :, None]
            return products, along.real
        whole = np.concatenate([pair, np.conj(seen)[None]])
        rows = np.stack(
            [np.concatenate([along.real, -along.imag], 1), np.concatenate([along.imag, along.real], 1)], 1
        )
        return np.stack([whole.real, whole.imag], 2), rows.reshape(2 * len(middle), -1, rows.shape[-1])


def _blocks(rows: int, particles: int, value: float = 0.0) -> Array:
    """Rows of one value for particles in whole blocks."""
    from gridslam.kernels.messages.particle_densities import LANES

    return np.full((rows, -(-particles // LANES) * LANES), value)


def _weighed(offset: Array, power: Array, products: Array, rows: Array) -> Array:
    """Log densities (P,), see `weigh_particles`; `offset` is that of paths, then of samples."""
    runtime.start()
    from gridslam.kernels.messages.particle_densities import LANES, PIVOTS, weigh_particles

    parts, blocks = products.shape[2], offset.shape[1] // LANES
    size, directions = len(rows), rows.shape[1]
    explained = np.empty((blocks, LANES))
    pivots = np.empty((-(-size // PIVOTS), blocks, LANES))
    terms = rows.shape[-1], products.shape[-1]
    weigh_particles(
        np.array([size // parts, directions, parts, *terms, CHUNKS, blocks], np.int32), TRUE,
        offset.reshape(-1, LANES), power.reshape(-1, LANES), products.reshape(-1),
        np.append(rows.reshape(-1), 0.0), np.empty((CHUNKS * (size + 2) * (size + directions), LANES)),
        explained, pivots.reshape(-1, LANES),
    )  # fmt: skip
    return np.asarray((explained + np.log(pivots).sum(0)).reshape(-1) / parts)


def _terms(turn: float) -> int:
    """Terms of a series of exp(j turn x) over -1 to 1: those left out are Bessel functions of the turn."""
    terms, left = 1, turn
    while left > EXACT or terms < 0.5 * turn:
        terms += 1
        left *= 0.5 * turn / terms
    return terms


@lru_cache(maxsize=64)
def _fit(terms: int) -> tuple[Array, Array]:
    """Points (K,) between -1 and 1, and what makes coefficients of values there (K, K), the highest first.

    By Chebyshev polynomials, whose own coefficients are whole numbers.
    """
    angle = np.pi * (np.arange(terms) + 0.5) / terms
    smooth = 2 / terms * np.cos(np.outer(angle, np.arange(terms)))
    smooth[:, 0] *= 0.5
    powers = np.zeros((terms, terms))
    powers[0, 0] = 1.0
    for n in range(1, terms):
        powers[n, 1:] = (2.0 if n > 1 else 1.0) * powers[n - 1, :-1]
        if n > 1:
            powers[n] -= powers[n - 2]
    return np.cos(angle), np.asarray((smooth @ powers)[:, ::-1])


def _directions(covariance: Complex, real: bool) -> tuple[Array, Complex]:
    """Powers (M,) and directions (M, M) of a covariance, such that products with responses are real if asked.

    Of samples whose magnitudes are the same on both sides of the middle, responses are their own mirror
    images, conjugate: sums and differences of both sides are real.
    """
    if not real:
        power, direction = np.linalg.eigh(covariance)
        return power, direction
    fold = _fold(len(covariance))
    power, direction = np.linalg.eigh((fold @ covariance @ np.conj(fold).T).real)
    return power, np.asarray(np.conj(fold).T @ direction, np.complex128)


@lru_cache(maxsize=8)
def _fold(size: int) -> Complex:
    """Sums and differences (M, M) of both sides of the middle, of length 1."""
    half, low = size // 2, np.arange(size // 2)
    fold, share = np.zeros((size, size), np.complex128), np.sqrt(0.5)
    fold[low, low], fold[low, size - 1 - low] = share, share
    fold[half + low, low], fold[half + low, size - 1 - low] = -1j * share, 1j * share
    if size % 2:
        fold[size - 1, half] = 1.0
    return fold
