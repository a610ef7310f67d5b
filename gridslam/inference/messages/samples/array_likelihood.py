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
from scipy.fft import ifft

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.messages.samples.signal_likelihood import pairs
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.waveform import Waveform

Complex = NDArray[np.complex128]
NONE = np.zeros(0, np.complex128)
POINTS = 2
"""At which delays are tried, in ratio to the frequencies; beams in ratio to their width."""
FEW = 64
"""Frequencies up to which a product with a matrix is faster than a Fourier transform (measured)."""


@dataclass(frozen=True, eq=False)
class Beams:
    """Where paths are looked for at first: lengths (D,) m, departures (T,) and arrivals (R,) rad.

    Attributes
    ----------
    out, back : (T, A) and (R, B) complex64
        Conjugate responses of the elements to the angles.
    delay : (M, D) complex64, optional
        Those to the lengths, each turned by a phase; None beyond `FEW` frequencies.
    """

    length: Array
    leaving: Array
    arriving: Array
    out: NDArray[np.complex64]
    back: NDArray[np.complex64]
    delay: NDArray[np.complex64] | None


@dataclass(frozen=True, eq=False)
class Factors:
    """Conjugate responses of N paths as products of three factors; index 1 of the first axis: derivatives.

    Attributes
    ----------
    path : (N, 3)
    delay, leaving, arriving : (2, N, M), (2, N, A), (2, N, B) complex128
    parts : tuple
        The same memory as pairs of numbers.
    gram, half : (4 N + 1, 4 N, 2), (5 N + 1, N, 2)
        Room for their products and for what solves these.
    """

    path: Array
    delay: Complex
    leaving: Complex
    arriving: Complex
    parts: tuple[Array, Array, Array]
    gram: Array
    half: Array

    @classmethod
    def room(cls, count: int, *sizes: int) -> Factors:
        """Room for N paths over so many frequencies, and elements of anchor and agent."""
        made = [np.empty((2, count, size), np.complex128) for size in sizes]
        delay, leaving, arriving = made
        parts = pairs(delay), pairs(leaving), pairs(arriving)
        gram, half = np.empty((4 * count + 1, 4 * count, 2)), np.empty((5 * count + 1, count, 2))
        return cls(np.empty((count, 3)), delay, leaving, arriving, parts, gram, half)

    def delayed(self, samples: Complex) -> Complex:
        """Samples (A, B, M) as the delays make them, (2, N, A, B)."""
        matched = np.matmul(self.delay, samples.reshape(-1, samples.shape[-1]).T)
        return np.asarray(matched.reshape(*matched.shape[:2], *samples.shape[:2]))


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
    def extent_roots(self) -> Array:
        """Of both arrays, roots of sums of squares of elements' places about their middle, rad, (2, 2, 2)."""
        extents = [np.cov(element.T, bias=True) * len(element) for element in (self.anchor, self.agent)]
        values, frames = np.linalg.eigh(np.array(extents))
        return np.asarray((frames * np.sqrt(np.maximum(values, 0.0))[:, None]) @ np.swapaxes(frames, 1, 2))

    @cached_property
    def beams(self) -> Beams:
        """Where paths are looked for at first: two points for each width of a peak."""
        count = POINTS * len(self.wavenumber)
        leaving, arriving = _directions(self.anchor), _directions(self.agent)
        out, back = _steered(self.anchor, leaving), _steered(self.agent, arriving)
        length, delay = self.folding_m * np.arange(count) / count, None
        if len(self.wavenumber) <= FEW:
            delay = self.delayed(np.eye(len(self.wavenumber)))
        return Beams(length, leaving, arriving, out, back, delay)

    def delayed(self, samples: Complex | Array) -> NDArray[np.complex64]:
        """Samples (..., M) times the conjugate responses to the beams' lengths, (..., D), but for a phase.

        The lengths are even over the folding range, so that this is a Fourier transform; each length's phase
        is that of the first frequency.
        """
        numbers = (samples * np.conj(self.pulse)).astype(np.complex64)
        return np.asarray(ifft(numbers, POINTS * len(self.wavenumber), norm="forward"))

    def factors(self, path: Array) -> Factors:
        """Conjugate responses to paths (N, 3) m, rad, rad; the next call for as many reuses the arrays."""
        runtime.start()
        from gridslam.kernels.messages.superposition import respond

        count = len(path)
        if count not in self._rooms:
            self._rooms[count] = Factors.room(count, *map(len, (self.wavenumber, self.anchor, self.agent)))
        made = self._rooms[count]
        made.path[:] = path
        respond(self.wavenumber, pairs(self.pulse), self.anchor, self.agent, made.path, *made.parts)
        return made

    @cached_property
    def _rooms(self) -> dict[int, Factors]:
        """What `factors` writes to, by the number of paths."""
        return {}


def _directions(element: Array) -> Array:
    """Directions that are tried, (n,) rad: 0 alone for one element."""
    if len(element) == 1:
        return np.zeros(1)
    reach = float(np.linalg.norm(element - element.mean(0), axis=1).max())
    count = int(np.clip(np.ceil(2 * POINTS * reach), 12, 720))
    return np.linspace(-np.pi, np.pi, count, endpoint=False)


def _steered(element: Array, angle: Array) -> NDArray[np.complex64]:
    """Conjugate responses of elements (n, 2) rad to directions (N,), (N, n); (M50)."""
    phase = np.stack([np.cos(angle), np.sin(angle)], 1) @ element.T
    return (np.exp(-1j * phase) / np.sqrt(len(element))).astype(np.complex64)


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
    information : (3 N, 3 N)
        Lambda: of the parameters with unknown amplitudes, at these amplitudes.
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
    information: Array
    gradient: Array
    rest_power: float
    unexplained: float
    noise: float

    def without(self, weight: Array) -> tuple[Array, Array]:
        """|y|^2 and g (N,) of every path of weight (N,) as if it were one more on top of all others.

        In units in which the noise has power 1.
        """
        left = np.maximum(1 - weight * self.own, 1e-12)
        return self.noise * np.abs(self.matched / left) ** 2, self.noise * self.own / left


def superpose_arrays(
    band: ArrayBand, samples: Complex, path: Array, weight: Array, noise: float, amplitude: Complex = NONE
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
    amplitude : (N,) or (0,)
        Those at which the information is, if known.

    Notes
    -----
    C^-1 is never formed, see `signal_likelihood.superpose`.
    """
    found, information, sums = _superposed(band, samples, path, weight, noise, amplitude, len(path))
    log_density, rest, left = sums.tolist()
    numbers = found[:, :4].copy().view(np.complex128)
    return ArraySuperposition(
        log_density, numbers[:, 0], numbers[:, 1], np.maximum(found[:, 4], 1e-300),
        information.reshape(3 * len(path), 3 * len(path)), found[:, 5:], rest, left, noise,
    )  # fmt: skip


def _superposed(
    band: ArrayBand,
    samples: Complex,
    path: Array,
    weight: Array,
    noise: float,
    amplitude: Complex,
    asked: int,
) -> tuple[Array, Array, Array]:
    """What the kernel tells of N paths, with the information about all or (`asked` is 0) none."""
    from gridslam.kernels.messages.superposition import superpose

    count, made = len(path), band.factors(path)
    found, information, sums = np.empty((count, 8)), np.empty((asked, 3, asked, 3)), np.empty(3)
    delays = made.delay.reshape(2 * count, made.delay.shape[2])
    superpose(
        pairs(np.matmul(delays, np.conj(delays).T).reshape(2, count, 2, count)), *made.parts[1:],
        pairs(made.delayed(samples)), weight,
        np.array([noise, float(np.vdot(samples, samples).real), band.samples]), pairs(amplitude), made.gram,
        made.half, found, information, sums,
    )  # fmt: skip
    return found, information, sums


def one_more(
    band: ArrayBand, samples: Complex, new: Array, path: Array, weight: Array, noise: float
) -> tuple[Complex, Array]:
    """s^H C^-1 z and s^H C^-1 s of paths (K, 3) on top of N others (N, 3), each (K,)."""
    weights = np.concatenate([weight, np.zeros(len(new))])
    found, _, _ = _superposed(band, samples, np.concatenate([path, new]), weights, noise, NONE, 0)
    found = found[len(path) :]
    return found[:, 2] + 1j * found[:, 3], np.maximum(found[:, 4], 1e-300)


def climbed(band: ArrayBand, rest: Complex, peak: Array, steps: int) -> Array:
    """The top of a peak (3,) of |s^H z|, so many Newton steps away; of samples (A, B, M)."""
    runtime.start()
    from gridslam.kernels.messages.superposition import climb

    top = np.array(peak)
    climb(
        band.wavenumber, pairs(band.pulse), band.anchor, band.agent, band.steepness, pairs(rest), steps, top
    )
    return top


def composed(band: ArrayBand, path: Array, amplitude: Complex) -> Complex:
    """The samples of paths (N, 3) of amplitudes (N,), (A, B, M)."""
    made = band.factors(path)
    scaled = (np.conj(amplitude)[:, None] * made.leaving[0])[:, :, None] * made.arriving[0][:, None]
    return np.asarray(np.conj(np.tensordot(scaled, made.delay[0], (0, 0))))
