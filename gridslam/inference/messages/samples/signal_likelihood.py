"""Likelihood of a snapshot of samples, given the distances of its paths ([LiangDirect], eqs. (1) to (3)).

Every path is a zero-mean Gaussian of covariance w h h^H, its amplitude being integrated out, so the samples
are one zero-mean Gaussian: CN(z; 0, C), C = s2 I + sum_n w_n h(d_n) h(d_n)^H; docs/model.md, (M71) to (M77).
All of it follows from products of the N responses with each other and with the samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.lapack import zpotrf, ztrtrs

from gridslam.arrays import Array, squared
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.waveform import Waveform

Complex = NDArray[np.complex128]
SPREAD = np.array([-1.0, 0.0, 1.0])
SHARE = np.array([1.0, 4.0, 1.0]) / 6
"""Three points, in sqrt(3) deviations, and shares: the moments of a normal spread up to the fifth."""
LEAST_WEIGHT = 1e-9
"""Power of a path in ratio to the noise, below which it counts as this."""


def pairs(numbers: Complex) -> Array:
    """Complex numbers as real and imaginary parts, the last axis, in the same memory."""
    return numbers.view(np.float64).reshape(*numbers.shape, 2)


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
        return cls(2 * np.pi * offset / SPEED_OF_LIGHT, (shape / np.linalg.norm(shape)).astype(np.complex128))

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
        wave = np.empty(phase.shape, np.complex128)
        np.cos(phase, out=wave.real)
        np.negative(np.sin(phase), out=wave.imag)
        wave *= self.pulse
        return wave

    def slope(self, response: Complex) -> Complex:
        """Derivative of responses (..., M) by their distance, 1/m."""
        return np.asarray(-1j * self.wavenumber * response)

    def correlation(self, gap: ArrayLike) -> Complex:
        """h(d)^H h(d') by the gap d' - d (...,), m: for a flat pulse the real Dirichlet kernel (M72)."""
        phase = np.asarray(gap, np.float64)[..., None] * self.wavenumber
        return np.asarray(np.exp(-1j * phase) @ (np.abs(self.pulse) ** 2))


@lru_cache(maxsize=8)
def band_of(waveform: Waveform) -> Band:
    """The band of a recording: the same at each of its steps, with whatever follows from it."""
    return Band.of(waveform.offset_hz, waveform.pulse)


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
    samples : int
        M.
    rest_power : float
        Of what the paths leave over, |z - H a|^2.
    lower : (N, N)
        L of A.
    """

    log_density: float
    amplitude: Complex
    power: Array
    whole_information: Complex
    gradient: Array
    samples: int
    rest_power: float
    lower: Complex

    @cached_property
    def unexplained(self) -> float:
        """Samples' worth of noise in what the paths leave over, s2 tr(C^-1)."""
        return self.samples - len(self.lower) + float(np.sum(np.abs(np.linalg.inv(self.lower)) ** 2))

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
    lower, _ = zpotrf(inner, lower=1)
    half, _ = ztrtrs(lower, np.conj(scaled).T, lower=1)
    product = (gram - np.conj(half).T @ half / noise) / noise
    plain, steep = slice(0, count), slice(count, -1)
    matched = product[plain, -1]  # h^H C^-1 z
    amplitude = weight * matched
    left = weight - weight**2 * product[plain, plain].diagonal().real
    whole = 2 * np.conj(amplitude)[:, None] * product[steep, steep] * amplitude
    trace = (product[plain, steep].diagonal()).real
    gradient = 2 * (np.conj(amplitude) * product[steep, -1]).real - 2 * weight * trace
    log_det = 2 * np.log(lower.diagonal().real).sum() + len(band) * np.log(noise)
    rest = samples - amplitude @ stack[:count]
    log_density = -log_det - product[-1, -1].real
    return Superposition(
        float(log_density), amplitude, np.abs(amplitude) ** 2 + left, whole, gradient, len(band),
        float(np.vdot(rest, rest).real), lower,
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
    """h(d)^H C^-1 z and h(d)^H C^-1 h(d) at every distance of a folding range.

    Attributes
    ----------
    spacing_m : float
        Between points; the last one is followed by the first, a folding range on.
    matched : (..., G) complex128
    self_power : (..., G) float64
    """

    spacing_m: float
    matched: Complex
    self_power: Array

    def log_ratio(self, intensity: Array | float) -> Array:
        """Log likelihood ratio of one more path at all points, (..., G)."""
        return log_ratio(squared(self.matched), self.self_power, intensity)


@dataclass(frozen=True, eq=False)
class Inverse:
    """C^-1 of N paths, each broadened over a spread of its distance.

    Attributes
    ----------
    band : Band
    samples : (M,) complex128
    matrix : (M, M) complex128
        C^-1.
    nodes : (N, 3, M) complex128
        Responses at three distances of each path, which stand for its spread.
    weight : (N, 3)
        Power of each.
    """

    band: Band
    samples: Complex
    matrix: Complex
    nodes: Complex
    weight: Array

    @classmethod
    def of(
        cls, band: Band, samples: Complex, weight: Array, distance: Array, variance: Array, noise: float
    ) -> Inverse:
        """Broaden N paths by three points with the moments of a normal spread up to the fifth (M73).

        Parameters
        ----------
        weight, distance, variance : (N,); power, m, m^2
        """
        points = distance[:, None] + np.sqrt(3 * variance)[:, None] * SPREAD
        nodes = band.response(points)
        power = np.maximum(weight, LEAST_WEIGHT * noise)[:, None] * SHARE
        # by the fewer products of the nodes with each other, (s2 I + F F^H)^-1 = (I - B^H B) / s2
        flat = np.sqrt(power / noise).reshape(-1, 1) * nodes.reshape(-1, len(band))
        back = np.conj(flat)
        matrix = np.zeros((len(band), len(band)), np.complex128)
        if len(flat):  # LAPACK complains of none
            inner = back @ flat.T
            inner.reshape(-1)[:: len(flat) + 1] += 1
            lower, _ = zpotrf(inner, lower=1)
            half, _ = ztrtrs(lower, back, lower=1)
            np.matmul(np.conj(half).T, half, out=matrix)
            matrix *= -1 / noise
        matrix.reshape(-1)[:: len(band) + 1] += 1 / noise
        return cls(band, samples, matrix, nodes, power)

    @cached_property
    def factors(self) -> Complex:
        """V (N, 3, M): C^-1 without path n is C^-1 + sum_i V_ni V_ni^H."""
        pressed = self.nodes @ self.matrix.T
        inner = np.conj(self.nodes) @ np.swapaxes(pressed, -1, -2)
        core = -inner
        core[:, range(3), range(3)] += 1 / self.weight
        lower = np.linalg.cholesky(core)
        return np.asarray(np.linalg.inv(np.conj(lower)) @ pressed)

    def sweep(self, points: int) -> Sweep:
        """Tables on top of all paths, (G,): trigonometric polynomials, so a Fourier transform gives each.

        G is `points`, or twice the number of frequencies if that is more: fewer wouldn't tell them.
        """
        size = len(self.band)
        points = max(points, 2 * size)
        matched = self._transform(self.matrix @ self.samples, points)
        core = np.conj(self.band.pulse)[:, None] * self.matrix * self.band.pulse
        # sums along the diagonals, g(d) = sum_l t_l exp(j l k d): in rows one entry longer they are columns
        padded = np.zeros(size * (2 * size + 1), np.complex128)
        padded[: 2 * size * size].reshape(size, 2 * size)[:, :size] = core
        lags = padded.reshape(size, -1).sum(0)[:size]
        own = np.fft.hfft(lags, points)
        return Sweep(self.band.folding_m / points, matched, np.maximum(own, 1e-300))

    def taken_by(self, rows: NDArray[np.intp]) -> Complex:
        """What some paths take from the tables (R, 3, M + 1): vectors whose transforms are added if a path is
        left out, and behind each its product with the samples; see `sweeps_without`."""
        factors = self.factors[rows]
        found = np.empty((len(rows), 3, len(self.band) + 1), np.complex128)
        np.multiply(np.conj(self.band.pulse), factors, out=found[..., :-1])
        found[..., -1] = np.conj(factors) @ self.samples
        return found

    def sweeps_without(self, whole: Sweep, rows: NDArray[np.intp]) -> Sweep:
        """Tables (len(rows), G) of some paths as if each were one more on top of all others."""
        factors = self.factors[rows]
        waves = self._transform(factors, whole.matched.shape[-1])
        matched = np.conj(factors) @ self.samples
        return Sweep(
            whole.spacing_m, whole.matched + (waves * matched[..., None]).sum(1),
            whole.self_power + squared(waves).sum(1),
        )  # fmt: skip

    def without(self, distance: Array) -> tuple[Array, Array]:
        """|y|^2 and g (N,) of every path at a distance (N,), on top of all others."""
        response = self.band.response(distance)
        back = np.conj(response)
        waves = (back[:, None] * self.factors).sum(-1)
        removed = np.conj(self.factors) @ self.samples
        matched = back @ (self.matrix @ self.samples) + (waves * removed).sum(1)
        own = ((back @ self.matrix) * response).sum(-1).real + squared(waves).sum(1)
        return squared(matched), np.maximum(own, 1e-300)

    def _transform(self, vector: Complex, points: int) -> Complex:
        """h(d)^H v at all points, but for a common phase of each: (..., M) to (..., G)."""
        return np.asarray(np.fft.ifft(np.conj(self.band.pulse) * vector, points, axis=-1, norm="forward"))
