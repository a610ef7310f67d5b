"""Likelihood of a snapshot of antenna arrays, given length, departure and arrival of its paths.

As `signal_likelihood`, for responses that are products of three factors (delay, departure, arrival), so that
products of paths with each other are those of small factors, whatever the number of samples; docs/model.md,
(M150).
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
KINDS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
"""Which factor is replaced by its derivative: none, or that of one parameter."""
POINTS = 2
"""At which delays are tried, in ratio to the frequencies; beams in ratio to their width."""


@dataclass(frozen=True, eq=False)
class Beams:
    """Where paths are looked for at first: lengths (D,) m, departures (T,) and arrivals (R,) rad.

    Attributes
    ----------
    out, back : (T, A) and (R, B)
        Conjugate responses of the elements to the angles.
    """

    length: Array
    leaving: Array
    arriving: Array
    out: Complex
    back: Complex


@dataclass(frozen=True, eq=False)
class ArrayBand:
    """Frequencies, pulse and antenna elements of one anchor's snapshots.

    Attributes
    ----------
    wavenumber : (M,) rad/m
        2 pi f / c of the offsets from the carrier.
    pulse : (M,) complex128
        Squared magnitudes sum to 1.
    anchor, agent : (A, 2) and (B, 2)
        Where the elements are, rad: 2 pi over the wavelength times m.
    """

    wavenumber: Array
    pulse: Complex
    anchor: Array
    agent: Array

    @classmethod
    def of(cls, waveform: Waveform, anchor: int) -> ArrayBand:
        """That of one of a recording's anchors."""
        scale = 2 * np.pi / waveform.wavelength_m
        return cls(
            2 * np.pi * waveform.offset_hz / SPEED_OF_LIGHT, waveform.pulse,
            scale * waveform.anchor_element_m[anchor], scale * waveform.agent_element_m,
        )  # fmt: skip

    @property
    def samples(self) -> int:
        """Samples of a snapshot, A B M."""
        return len(self.wavenumber) * len(self.anchor) * len(self.agent)

    @cached_property
    def resolution_m(self) -> float:
        """c over the bandwidth, m."""
        return float(2 * np.pi / (self.wavenumber[-1] - self.wavenumber[0]))

    @cached_property
    def folding_m(self) -> float:
        """Length beyond which a path looks nearer than it is, m."""
        return self.resolution_m * (len(self.wavenumber) - 1)

    @cached_property
    def steepness(self) -> Array:
        """Root mean square phase slope by length, departure and arrival, (3,): rad/m, rad, rad.

        Of the angles, the mean over all directions; 0 where there is one element. `Lambda` of (M53) is its
        square.
        """
        power = np.abs(self.pulse) ** 2
        delay = np.sqrt(power @ (self.wavenumber - power @ self.wavenumber) ** 2)
        angles = np.linspace(-np.pi, np.pi, 180, endpoint=False)
        spread = [delay]
        for element in (self.anchor, self.agent):
            across = -np.sin(angles)[:, None] * element[:, 0] + np.cos(angles)[:, None] * element[:, 1]
            spread.append(across.std(1).mean())
        return np.array(spread)

    @cached_property
    def beams(self) -> Beams:
        """Where paths are looked for at first: two points for each width of a peak."""
        count = POINTS * len(self.wavenumber)
        leaving, arriving = _directions(self.anchor), _directions(self.agent)
        out, back = (
            np.conj(_steered(element, angle)[0])
            for element, angle in ((self.anchor, leaving), (self.agent, arriving))
        )
        return Beams(self.folding_m * np.arange(count) / count, leaving, arriving, out, back)

    def factors(self, path: Array) -> tuple[Complex, Complex, Complex]:
        """Responses and derivatives, (2, N, M), (2, N, A), (2, N, B), to paths (N, 3): m, rad, rad."""
        delay = self.pulse * np.exp(-1j * path[:, :1] * self.wavenumber)
        return (
            np.stack([delay, -1j * self.wavenumber * delay]),
            _steered(self.anchor, path[:, 1]), _steered(self.agent, path[:, 2]),
        )  # fmt: skip


def _directions(element: Array) -> Array:
    """Directions that are tried, (n,) rad: 0 alone for one element."""
    if len(element) == 1:
        return np.zeros(1)
    reach = float(np.linalg.norm(element - element.mean(0), axis=1).max())
    count = int(np.clip(np.ceil(2 * POINTS * reach), 12, 720))
    return np.linspace(-np.pi, np.pi, count, endpoint=False)


def _steered(element: Array, angle: Array) -> Complex:
    """Response of elements (n, 2) rad to directions (N,), and its derivative, (2, N, n); (M50)."""
    x, y = np.cos(angle)[:, None], np.sin(angle)[:, None]
    response = np.exp(1j * (x * element[:, 0] + y * element[:, 1])) / np.sqrt(len(element))
    return np.stack([response, 1j * (x * element[:, 1] - y * element[:, 0]) * response])


@dataclass(frozen=True, eq=False)
class ArraySuperposition:
    """N paths at once: what a snapshot tells of their parameters (M150).

    Attributes
    ----------
    log_density : float
        log CN(z; 0, C) but for -samples log pi.
    amplitude : (N,) complex128
        Mean of each path given z.
    matched : (N,) complex128
        s^H C^-1 z.
    own : (N,)
        s^H C^-1 s.
    whole_information : (N, 3, N, 3) complex128
        2 conj(a_n) a_m s'_n^H C^-1 s'_m, whose real part is `information`.
    gradient : (N, 3)
        Of log_density by the parameters.
    rest_power : float
        Of what the paths leave over, |z - S a|^2.
    unexplained : float
        Samples' worth of noise in that, s2 tr(C^-1).
    noise : float
        s2.
    """

    log_density: float
    amplitude: Complex
    matched: Complex
    own: Array
    whole_information: Complex
    gradient: Array
    rest_power: float
    unexplained: float
    noise: float

    @property
    def information(self) -> Array:
        """Lambda: of the parameters with unknown amplitudes, at these amplitudes, (3 N, 3 N)."""
        size = 3 * len(self.amplitude)
        return np.asarray(self.whole_information.real.reshape(size, size))

    def without(self, weight: Array) -> tuple[Array, Array]:
        """|y|^2 and g (N,) of every path of weight (N,) as if it were one more on top of all others.

        In units in which the noise has power 1.
        """
        left = np.maximum(1 - weight * self.own, 1e-12)
        return self.noise * np.abs(self.matched / left) ** 2, self.noise * self.own / left


def superpose_arrays(
    band: ArrayBand, samples: Complex, path: Array, weight: Array, noise: float
) -> ArraySuperposition:
    """Evaluate N paths; C = s2 I + sum_n w_n s_n s_n^H.

    Parameters
    ----------
    samples : (A, B, M) complex128
    path : (N, 3) m, rad, rad
    weight : (N,)
        Mean power of each path, in the scale of `noise`.
    noise : float
        Power of the noise in each sample, s2.

    Notes
    -----
    C^-1 is never formed, see `signal_likelihood.superpose`; products are those of `KINDS` of the paths.
    """
    count = len(path)
    gram, matched = products(band, samples, path)
    power = float(np.vdot(samples, samples).real)
    plain = gram[0, :, 0]
    root = np.sqrt(weight)
    lower = np.linalg.cholesky(np.eye(count) + root[:, None] * plain * root / noise).astype(np.complex128)
    # rows: the plain responses, their derivatives, the samples
    columns = np.concatenate([gram[:, :, 0].reshape(4 * count, count), np.conj(matched[0])[None]]) * root
    half = np.linalg.solve(lower, np.conj(columns).T)
    steep = slice(count, 4 * count)
    whole = (
        gram[1:, :, 1:].reshape(3 * count, 3 * count) - np.conj(half[:, steep]).T @ half[:, steep] / noise
    ) / noise
    told = (matched.reshape(-1) - np.conj(half[:, :-1]).T @ half[:, -1] / noise) / noise
    own = (1 - (np.abs(half[:, :count]) ** 2).sum(0) / noise) / noise
    across = gram[0, :, 1:].diagonal(axis1=0, axis2=2).T  # s_n^H s'_n, (N, 3)
    turned = half[:, steep].reshape(count, 3, count).transpose(2, 0, 1)
    across = (across - np.einsum("kn,nkp->np", np.conj(half[:, :count]), turned) / noise) / noise
    amplitude = weight * told[:count]
    gradient = 2 * np.real(np.conj(amplitude)[:, None] * told[count:].reshape(3, count).T)
    gradient -= 2 * weight[:, None] * across.real
    scale = np.conj(amplitude)[:, None] * amplitude
    whole = 2 * np.einsum("pnqm,nm->npmq", whole.reshape(3, count, 3, count), scale)
    explained = float((np.abs(half[:, -1]) ** 2).sum()) / noise
    log_det = 2 * np.log(lower.diagonal().real).sum() + band.samples * np.log(noise)
    rest = power - 2 * float(np.vdot(amplitude, matched[0]).real)
    rest += float(np.vdot(amplitude, plain @ amplitude).real)
    unexplained = band.samples - count + float(np.sum(np.abs(np.linalg.inv(lower)) ** 2))
    return ArraySuperposition(
        float(-log_det - (power - explained) / noise), amplitude, told[:count], np.maximum(own, 1e-300),
        whole, gradient, rest, unexplained, noise,
    )  # fmt: skip


def products(
    band: ArrayBand, samples: Complex, path: Array, kinds: NDArray[np.intp] = KINDS
) -> tuple[Complex, Complex]:
    """Products of the responses and derivatives of N paths with each other and with the samples.

    Parameters
    ----------
    kinds : (K, 3) intp
        Those of `KINDS` that are asked for.

    Returns
    -------
    (gram, matched)
        (K, N, K, N), by kind and path of either; (K, N).
    """
    factors, count = band.factors(path), len(path)
    gram: Complex | float = 1.0
    for factor, kind in zip(factors, kinds.T, strict=True):
        flat = factor.reshape(2 * count, factor.shape[2])
        small = (np.conj(flat) @ flat.T).reshape(2, count, 2, count)
        gram = gram * small[kind][:, :, kind]
    delay, leaving, arriving = (np.conj(factor) for factor in factors)
    part = delay.reshape(2 * count, delay.shape[2]) @ samples.reshape(-1, samples.shape[2]).T
    part = part.reshape(2, count, *samples.shape[:2]) @ arriving.transpose(1, 2, 0)  # [2, N, A, 2]
    part = leaving.transpose(1, 0, 2) @ part  # [2, N, 2, 2]: which factor of delay, departure, arrival
    return np.asarray(gram), part[kinds[:, 0], :, kinds[:, 1], kinds[:, 2]]


def one_more(
    band: ArrayBand, samples: Complex, new: Array, path: Array, weight: Array, noise: float
) -> tuple[Complex, Array]:
    """s^H C^-1 z and s^H C^-1 s of paths (K, 3) on top of N others (N, 3), each (K,)."""
    count = len(path)
    gram, matched = products(band, samples, np.concatenate([path, new]), KINDS[:1])
    plain, root = gram[0, :, 0], np.sqrt(weight)
    lower = np.linalg.cholesky(np.eye(count) + root[:, None] * plain[:count, :count] * root / noise)
    half = np.linalg.solve(
        lower, root[:, None] * np.column_stack([plain[:count, count:], matched[0, :count]])
    )
    cross, told = half[:, :-1], half[:, -1]
    left = (matched[0, count:] - np.conj(cross).T @ told / noise) / noise
    own = (1 - (np.abs(cross) ** 2).sum(0) / noise) / noise
    return left, np.maximum(own, 1e-300)


def unexplained(band: ArrayBand, samples: Complex, path: Array, power: Array, noise: float) -> Complex:
    """What of the samples (A, B, M) paths (N, 3) of mean powers (N,) leave if all of them are there."""
    gram, matched = products(band, samples, path, KINDS[:1])
    inverse = gram[0, :, 0] + np.diag(noise / np.maximum(power, 1e-9 * noise))
    amplitude = np.asarray(np.linalg.solve(inverse, matched[0]), np.complex128)
    return np.asarray(samples - composed(band, path, amplitude), np.complex128)


def composed(band: ArrayBand, path: Array, amplitude: Complex) -> Complex:
    """The samples of paths (N, 3) of amplitudes (N,), (A, B, M)."""
    delay, leaving, arriving = (factor[0] for factor in band.factors(path))
    scaled = (amplitude[:, None] * leaving)[:, :, None] * arriving[:, None]
    return np.asarray(np.tensordot(scaled, delay, (0, 0)))
