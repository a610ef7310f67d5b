"""Likelihood of a snapshot of samples, given the distances of its paths ([LiangDirect], eqs. (1) to (3)).

Every path is a zero-mean Gaussian of covariance w h h^H, its amplitude being integrated out, so the samples
are one zero-mean Gaussian: CN(z; 0, C), C = s2 I + sum_n w_n h(d_n) h(d_n)^H; docs/model.md, (M71) to (M77).
All of it follows from products of the N responses with each other and with the samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.world.radio import SPEED_OF_LIGHT

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Band:
    """The frequencies of a snapshot, and the pulse on them.

    Attributes
    ----------
    wavenumber : (M,) float64, rad/m
        2 pi f / c of the offsets f from the carrier, evenly spaced about 0.
    pulse : (M,) complex128
        Squared magnitudes sum to 1.
    """

    wavenumber: Array
    pulse: Complex

    @classmethod
    def of(cls, offset_hz: ArrayLike, pulse: ArrayLike | None = None) -> Band:
        """A band of frequency offsets (M,), Hz, and a pulse (M,) of any scale (default: flat)."""
        offset = np.asarray(offset_hz, np.float64)
        shape = np.ones(len(offset)) if pulse is None else np.asarray(pulse, np.complex128)
        return cls(2 * np.pi * offset / SPEED_OF_LIGHT, shape / np.linalg.norm(shape) + 0j)

    def __len__(self) -> int:
        return len(self.wavenumber)

    @cached_property
    def folding_m(self) -> float:
        """Distance beyond which a path looks nearer than it is, c over the spacing, m."""
        return float(2 * np.pi * (len(self) - 1) / (self.wavenumber[-1] - self.wavenumber[0]))

    @cached_property
    def resolution_m(self) -> float:
        """c over the bandwidth, m."""
        return float(2 * np.pi / (self.wavenumber[-1] - self.wavenumber[0]))

    @cached_property
    def rms_wavenumber(self) -> float:
        """2 pi beta / c of the rms bandwidth beta, rad/m."""
        power = np.abs(self.pulse) ** 2
        middle = float(power @ self.wavenumber)
        return float(np.sqrt(power @ (self.wavenumber - middle) ** 2))

    def response(self, distance: ArrayLike) -> Complex:
        """h(d) of distances (...,) in m: (..., M), of norm 1 (M49)."""
        phase = np.asarray(distance, np.float64)[..., None] * self.wavenumber
        return np.asarray(self.pulse * np.exp(-1j * phase))

    def slope(self, response: Complex) -> Complex:
        """Derivative of responses (..., M) by their distance, 1/m."""
        return np.asarray(-1j * self.wavenumber * response)

    def correlation(self, gap: ArrayLike) -> Complex:
        """h(d)^H h(d') by the gap d' - d (...,), m: for a flat pulse the real Dirichlet kernel (M72)."""
        phase = np.asarray(gap, np.float64)[..., None] * self.wavenumber
        return np.asarray(np.exp(-1j * phase) @ (np.abs(self.pulse) ** 2))

    def broadened(self, weight: Array, distance: Array, variance: Array) -> Complex:
        """Mean of w h h^H over a normal spread of each distance, (..., M, M) (M73).

        Parameters
        ----------
        weight, distance, variance : (..., N); power, m, m^2
            The N paths of each matrix are summed.
        """
        lag = (self.wavenumber[1] - self.wavenumber[0]) * np.arange(len(self))
        wave = np.exp(-1j * distance[..., None] * lag - 0.5 * variance[..., None] * lag**2)
        column = (weight[..., None] * wave).sum(-2)
        whole = np.concatenate([np.conj(column[..., :0:-1]), column], -1)
        row = np.arange(len(self))
        toeplitz = whole[..., len(self) - 1 + row[:, None] - row]
        return np.asarray(toeplitz * np.outer(self.pulse, np.conj(self.pulse)))


@dataclass(frozen=True, eq=False)
class Superposition:
    """N paths at once: what a snapshot tells of their distances (M74) to (M76).

    Attributes
    ----------
    log_density : float
        log CN(z; 0, C) but for -M log pi.
    amplitude, power : (N,)
        Mean amplitude of each path given z, complex; and mean of its square.
    whole_information : (N, N) complex128, 1/m^2
        2 conj(a_n) a_m h'_n^H C^-1 h'_m, whose real part is `information`.
    gradient : (N,) 1/m
        Of log_density by the distances.
    noise_ratio : float
        Power of what the paths leave over, in ratio to what is expected at this noise level.
    noise_freedom : float
        Samples' worth of noise in it, s2 tr(C^-1).
    """

    log_density: float
    amplitude: Complex
    power: Array
    whole_information: Complex
    gradient: Array
    noise_ratio: float
    noise_freedom: float

    @property
    def information(self) -> Array:
        """Lambda: of the distances with unknown amplitudes, at these amplitudes, (N, N) 1/m^2."""
        return np.asarray(self.whole_information.real)


def superpose(band: Band, samples: Complex, distance: Array, weight: Array, noise: float) -> Superposition:
    """Evaluate N paths.

    Parameters
    ----------
    samples : (M,) complex128
    distance, weight : (N,); m, power
        Weight is the path's mean power, in the scale of `noise`.
    noise : float
        Power of the noise in each sample, s2.

    Notes
    -----
    C^-1 is never formed: with R = diag(sqrt(w)) and A = I + R H^H H R / s2, its products follow from those of
    [H, H', z] with each other. C^-1 projects out what a change of amplitude of any path explains, which is
    why overlapping paths lose what they don't tell and keep what they tell together.
    """
    count = len(distance)
    stack = np.empty((2 * count + 1, len(band)), np.complex128)
    stack[:count] = band.response(distance)
    stack[count:-1] = band.slope(stack[:count])
    stack[-1] = samples
    gram = np.conj(stack) @ stack.T
    root = np.sqrt(weight)
    scaled = gram[:, :count] * root
    inner = np.eye(count) + root[:, None] * scaled[:count] / noise
    lower = np.linalg.cholesky(inner)
    half = np.linalg.solve(lower, np.conj(scaled).T)
    product = (gram - np.conj(half).T @ half / noise) / noise
    plain, steep = slice(0, count), slice(count, -1)
    matched = product[plain, -1]  # h^H C^-1 z
    amplitude = weight * matched
    left = weight - weight**2 * product[plain, plain].diagonal().real
    whole = 2 * np.conj(amplitude)[:, None] * product[steep, steep] * amplitude
    trace = (product[plain, steep].diagonal()).real
    gradient = 2 * (np.conj(amplitude) * product[steep, -1]).real - 2 * weight * trace
    log_det = 2 * np.log(lower.diagonal().real).sum() + len(band) * np.log(noise)
    # the rest is e = s2 C^-1 z, whose mean square is s2^2 tr C^-1; |C^-1 z|^2 by the same products
    rest = samples - amplitude @ stack[:count]
    freedom = len(band) - count + float(np.sum(np.abs(np.linalg.inv(lower)) ** 2))
    ratio = float(np.vdot(rest, rest).real) / (noise * freedom)
    log_density = -log_det - product[-1, -1].real
    return Superposition(
        float(log_density), amplitude, np.abs(amplitude) ** 2 + left, whole, gradient, ratio, freedom,
    )  # fmt: skip


def log_densities(band: Band, samples: Complex, distance: Array, weight: Array, noise: float) -> Array:
    """log CN(z; 0, C) but for -M log pi of many sets of N distances, by N x N factors alone (M74).

    Parameters
    ----------
    distance : (P, N) m
    weight : (N,) or (P, N)
    """
    root = np.sqrt(np.broadcast_to(weight, distance.shape) / noise)
    gap = distance[:, None, :] - distance[:, :, None]
    inner = np.eye(distance.shape[1]) + root[:, :, None] * band.correlation(gap) * root[:, None, :]
    lower = np.linalg.cholesky(inner)
    matched = np.conj(band.response(distance)) @ samples
    half = np.linalg.solve(lower, (root * matched)[..., None])[..., 0]
    log_det = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2).real).sum(-1) + len(band) * np.log(noise)
    power = float(np.vdot(samples, samples).real)
    return np.asarray(-log_det - (power - (np.abs(half) ** 2).sum(-1)) / noise)


def log_ratio(matched_power: Array, self_power: Array, intensity: Array | float) -> Array:
    """Log likelihood ratio of one more path, LR(d, gamma) = CN(z; 0, C + gamma h h^H) / CN(z; 0, C) (M77).

    Parameters
    ----------
    matched_power : (...,)
        |h^H C^-1 z|^2.
    self_power : (...,)
        h^H C^-1 h.
    intensity : (...,)
        gamma.
    """
    more = 1 + intensity * self_power
    return np.asarray(intensity * matched_power / more - np.log(more))


@dataclass(frozen=True, eq=False)
class Sweep:
    """h(d)^H C^-1 z and h(d)^H C^-1 h(d) at every distance, for stacks of C.

    Attributes
    ----------
    spacing_m : float
        Between points; the last one is followed by the first, a folding range on.
    matched_power, self_power : (..., G) float64
    """

    spacing_m: float
    matched_power: Array
    self_power: Array

    def log_ratio(self, intensity: Array | float) -> Array:
        """Log likelihood ratio of one more path at all points, (..., G)."""
        return log_ratio(self.matched_power, self.self_power, intensity)


def sweep(band: Band, samples: Complex, inverse: Complex, points: int = 2048) -> Sweep:
    """Both tables by one Fourier transform each: they are trigonometric polynomials of the distance.

    Parameters
    ----------
    inverse : (..., M, M)
        C^-1.
    points : int
        Of the folding range; at least 2 M.
    """
    size = len(band)
    line = np.conj(band.pulse) * (inverse @ samples)
    matched = np.abs(np.fft.ifft(line, points, axis=-1) * points) ** 2
    core = np.conj(band.pulse)[:, None] * inverse * band.pulse
    lags = np.zeros((*inverse.shape[:-2], size), np.complex128)
    for lag in range(size):  # sums along the diagonals: g(d) = sum_l t_l exp(j l k d)
        lags[..., lag] = np.trace(core, lag, -2, -1)
    lags[..., 0] *= 0.5
    own = 2 * (np.fft.fft(lags, points, axis=-1)).real
    return Sweep(band.folding_m / points, matched, np.maximum(own, 1e-300))
