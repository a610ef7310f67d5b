"""Densities of a snapshot at many particles of several paths, by tables over distance (M381).

Products of responses with each other, with the samples, and with what else is in the samples are functions of
one distance or of one difference, and band-limited: Fourier transforms give them on a grid, and a cubic in
each of its cells between. So a particle of N paths costs N^2 look-ups and an N x N root, however many the
frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.messages.samples.signal_likelihood import Band, Complex

FINE = 32
"""Cells of the tables per frequency, at least: cubics are off by 3e-7 of a response's norm at most."""
NEGLIGIBLE = 1e-3
"""Power over the noise's, of a direction of samples, below which it is left out: each changes the log of a
density by about this, where the density is that of the samples."""
CHUNKS = 16
"""Into which particles are cut for threads, which share no scratch."""


@dataclass(frozen=True, eq=False)
class ResponseTables:
    """Products of responses, whitened by the noise and whatever else is in the samples.

    Attributes
    ----------
    folding_m : float
        After which distances begin again.
    gram : (2 S, 1 or 2, 4)
        h(d)^H h(d') by d' - d, which begins a folding range below 0: coefficients of cubics, of the real part
        and, where there is any, of the imaginary part.
    rows : (S, 1 or 2, E, 4)
        The same of products by distance, see `weigh_particles`.
    """

    folding_m: float
    gram: Array
    rows: Array

    @classmethod
    def of(cls, band: Band, samples: Complex, extra: Complex, noise: float) -> ResponseTables:
        """Tables for one snapshot.

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
        power, direction = _directions(extra, real)
        kept = power > NEGLIGIBLE * noise
        share, direction = power[kept] / (power[kept] + noise), direction[:, kept]
        seen = samples - direction @ (share * (np.conj(direction).T @ samples))
        table = _Table.of(band, size)
        matched = table.products(size * seen / np.sqrt(noise))[None]
        others = table.products(size * np.sqrt(share)[:, None] * direction.T)
        apart = table.differences(size**2)
        if real:
            rows = np.concatenate([matched.real, matched.imag, others.real])[None]
            gram = apart.real[None]
        else:
            upper = np.concatenate([matched.real, others.real, -others.imag])
            rows = np.stack([upper, np.concatenate([matched.imag, others.imag, others.real])])
            gram = np.stack([apart.real, apart.imag])
        return cls(
            band.folding_m,
            np.ascontiguousarray(np.swapaxes(gram, 0, 1)),
            np.ascontiguousarray(rows.transpose(2, 0, 1, 3)),
        )

    def log_densities(self, distance: Array, power: Array) -> Array:
        """log CN(z; 0, C) at every particle (P,), less that without its paths.

        Parameters
        ----------
        distance, power : (N, P); m, over the noise's
        """
        runtime.start()
        from gridslam.kernels.messages.particle_densities import LANES, weigh_particles

        count, particles = distance.shape
        cells, parts, entries, _ = self.rows.shape
        blocks = -(-particles // LANES)
        at = np.mod(distance / self.folding_m, 1.0) * cells
        at = np.minimum(at, np.nextafter(cells, 0))
        size, directions = count * parts, entries - (3 - parts)
        found = np.empty(blocks * LANES)
        weigh_particles(
            np.array([count, directions, parts, cells, CHUNKS, blocks], np.int32),
            _side_by_side(at, LANES), _side_by_side(np.sqrt(power), LANES), self.gram.reshape(-1),
            self.rows.reshape(-1), np.empty(CHUNKS * (size + 2) * (size + directions) * LANES), found,
        )  # fmt: skip
        return found[:particles]


@dataclass(frozen=True, eq=False)
class _Table:
    """A grid of distances over a folding range, and the wavenumbers, 0 in their middle."""

    spacing_m: float
    wavenumber: Array
    cells: int

    @classmethod
    def of(cls, band: Band, size: Array) -> _Table:
        cells = 1 << int(np.ceil(np.log2(FINE * len(size))))
        return cls(band.folding_m / cells, band.wavenumber - band.wavenumber.mean(), cells)

    def products(self, vector: Complex) -> Complex:
        """Cubics (..., S, 4) of sum_m exp(j k_m d) v_m; vectors (..., M)."""
        slope = 1j * self.wavenumber * vector
        return _cubics(self._transformed(vector), self.spacing_m * self._transformed(slope))

    def differences(self, vector: Array) -> Complex:
        """Cubics (2 S, 4) of sum_m exp(-j k_m d) v_m from a folding range less than 0 on."""
        value = self._transformed(vector.astype(np.complex128))
        slope = self.spacing_m * self._transformed(np.asarray(1j * self.wavenumber * vector, np.complex128))
        both = np.concatenate([value[:0:-1], np.conj(value)])
        return _cubics(both, np.concatenate([-slope[:0:-1], np.conj(slope)]))

    def _transformed(self, vector: Complex) -> Complex:
        found = np.fft.ifft(vector, self.cells, axis=-1, norm="forward")
        turn = np.exp(1j * self.wavenumber[0] * self.spacing_m * np.arange(self.cells + 1))
        return np.asarray(np.concatenate([found, found[..., :1]], -1) * turn)


def _cubics(value: Complex, slope: Complex) -> Complex:
    """Coefficients (..., S, 4) of cubics between S + 1 points, by values and slopes there."""
    low, high, rise, later = value[..., :-1], value[..., 1:], slope[..., :-1], slope[..., 1:]
    step = high - low
    return np.stack([low, rise, 3 * step - 2 * rise - later, rise + later - 2 * step], -1)


def _directions(covariance: Complex, real: bool) -> tuple[Array, Complex]:
    """Powers (M,) and directions (M, M) of a covariance, such that products with responses are real if asked.

    Of samples whose magnitudes are the same on both sides of the middle, responses are their own mirror
    images, conjugate: sums and differences of both sides are real.
    """
    if not real:
        power, direction = np.linalg.eigh(covariance)
        return power, direction
    size = len(covariance)
    half, low = size // 2, np.arange(size // 2)
    fold, share = np.zeros((size, size), np.complex128), np.sqrt(0.5)
    fold[low, low], fold[low, size - 1 - low] = share, share
    fold[half + low, low], fold[half + low, size - 1 - low] = -1j * share, 1j * share
    if size % 2:
        fold[size - 1, half] = 1.0
    power, direction = np.linalg.eigh((fold @ covariance @ np.conj(fold).T).real)
    return power, np.asarray(np.conj(fold).T @ direction, np.complex128)


def _side_by_side(values: Array, lanes: int) -> NDArray[np.float64]:
    """Rows (N, P) as blocks of particles [B, N, lanes], flat; the last particle fills up its block."""
    count, particles = values.shape
    whole = np.pad(values, ((0, 0), (0, -particles % lanes)), "edge")
    blocks = whole.reshape(count, whole.shape[1] // lanes, lanes).transpose(1, 0, 2)
    return np.ascontiguousarray(blocks, np.float64).reshape(-1)
