"""Products of the responses of an anchor's paths, with each other and with samples; docs/model.md, (M126).

The array is symmetric about its centre and the pulse's power even about the carrier, so that products of
responses are real, and those of the spectra follow from the frequencies above the carrier alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from gridslam.arrays import Array
from gridslam.inference.state.features.features import ENTRIES, MOVING
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.signal_model import SignalModel
from gridslam.world.waveform import Waveform

Complex = NDArray[np.complex128]
LEAST_M = 0.1
"""Shorter paths are taken to be as long as this."""


@dataclass(frozen=True, eq=False)
class Paths:
    """The line of sight (first) and the features of one anchor, C of them, at a joint state.

    Attributes
    ----------
    numbers : (2 C,) float64
        All lengths (m), then all angles of arrival in the agent's frame (rad).
    far : (C,) float64
        From the agent to the anchor or the feature's place, m.
    jacobian : (2 C, 4 + 3 F + 1) float64
        Slopes of the numbers by the joint state and by an error of the heading.
    rows : (C - 1,) int64
        The features.
    """

    numbers: Array
    far: Array
    jacobian: Array
    rows: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Received:
    """Samples of one anchor at one step, as products need them.

    Attributes
    ----------
    halves : (2 H, 4 N) float64
        What cosines and sines at the frequencies above the carrier meet: samples, then their slopes by
        length, each by antenna, real and imaginary parts side by side.
    energy : float
        ``z^H z``.
    size : int
        How many samples there are.
    """

    halves: Array
    energy: float
    size: int


@dataclass(frozen=True, eq=False)
class Products:
    """Products of responses T (N M, n) with each other, and with the samples z.

    Attributes
    ----------
    gram : (n, n) float64
        ``T^H T``.
    matched : (n,) complex128
        ``T^H z``.
    energy : float
        ``z^H z``.
    size : int
        How many samples there are.
    """

    gram: Array
    matched: Complex
    energy: float
    size: int

    def of(self, rows: slice) -> Products:
        """Some of the responses alone."""
        return replace(self, gram=self.gram[rows, rows], matched=self.matched[rows])


@dataclass(frozen=True, eq=False)
class Whitened:
    """The same in units of what is expected of the samples, C being their covariance.

    Attributes
    ----------
    gram : (n, n) float64
        ``T^H C^-1 T``.
    matched : (n,) complex128
        ``T^H C^-1 z``.
    log_density : float
        Of the samples.
    """

    gram: Array
    matched: Complex
    log_density: float


@dataclass(frozen=True, eq=False)
class Band:
    """Of a waveform, by frequencies above the carrier (H of them).

    Attributes
    ----------
    rate : (H,) float64
        2 pi / c times the frequency, rad/m.
    weight : (H,) float64
        The pulse's power there and as far below the carrier.
    element : (N, 2) float64
        The agent's antennas, times 2 pi / wavelength.
    """

    rate: Array
    weight: Array
    element: Array


@lru_cache(8)
def band_of(wave: Waveform) -> Band:
    """The upper half of a waveform's band."""
    rate = 2 * np.pi / SPEED_OF_LIGHT * wave.offset_hz
    power = np.abs(wave.pulse) ** 2
    upper, middle = len(rate) // 2, len(rate) % 2
    both = power[upper:] + power[: len(rate) - upper][::-1]
    if middle:
        both[0] /= 2
    return Band(rate[upper:], both, 2 * np.pi / wave.wavelength_m * wave.agent_element_m)


def received(samples: Complex, wave: Waveform) -> Received:
    """What is made once of the samples (N, M) of an anchor."""
    rate, upper = band_of(wave).rate, len(wave.offset_hz) // 2
    turned = wave.pulse.conj()[:, None] * samples.T
    above, below = turned[upper:], turned[: len(turned) - upper][::-1]
    if len(turned) % 2:
        below = below.copy()
        below[0] = 0.0
    sums, gaps = above + below, 1j * (above - below)
    slope = rate[:, None]
    # d/dx of (sum cos + gap sin)(rate x)
    value, sloped = np.concatenate([sums, gaps]), np.concatenate([slope * gaps, -slope * sums])
    both = np.concatenate([value, sloped], 1)
    halves = np.ascontiguousarray(both).view(np.float64)
    return Received(halves, float(np.vdot(samples, samples).real), samples.size)


def paths_at(mean: Array, belief: JointBelief, anchor: int, heading_rad: float, model: SignalModel) -> Paths:
    """Lengths and angles at a joint state, and their slopes."""
    bank = belief.features
    rows = np.flatnonzero(bank.anchor == anchor)
    own = MOVING + ENTRIES * rows[:, None] + np.arange(ENTRIES)
    total, bearing, extra = mean[own].T
    ahead, beside = np.cos(bearing), np.sin(bearing)
    count, size = 1 + len(rows), len(mean)
    way, out = np.empty((2, count)), total - extra
    way[:, 0] = model.anchors[anchor, :2]
    way[0, 1:] = bank.origin_m[rows, 0] + out * ahead
    way[1, 1:] = bank.origin_m[rows, 1] + out * beside
    way -= mean[:2, None]
    far = np.maximum(np.hypot(way[0], way[1]), LEAST_M)
    numbers = np.empty(2 * count)
    numbers[:count] = far
    numbers[1:count] += extra
    np.maximum(numbers[:count], LEAST_M, out=numbers[:count])
    numbers[count:] = np.arctan2(way[1], way[0]) - heading_rad
    x, y = way / far
    jacobian = np.zeros((2, count, size + 1))
    jacobian[0, :, 0], jacobian[0, :, 1] = -x, -y
    jacobian[1, :, 0], jacobian[1, :, 1] = y / far, -x / far
    jacobian[1, :, -1] = -1.0
    each, x, y, far_out = np.arange(1, count), x[1:], y[1:], far[1:]
    along, across = x * ahead + y * beside, x * beside - y * ahead
    jacobian[0, each, own[:, 0]], jacobian[1, each, own[:, 0]] = along, across / far_out
    jacobian[0, each, own[:, 1]], jacobian[1, each, own[:, 1]] = -out * across, out * along / far_out
    jacobian[0, each, own[:, 2]], jacobian[1, each, own[:, 2]] = 1 - along, -across / far_out
    return Paths(numbers, far, jacobian.reshape(2 * count, size + 1), rows)


def products(numbers: Array, got: Received, wave: Waveform) -> Products:
    """Of responses, their slopes by length and those by angle, (3 C,), of paths with these numbers (2 C,)."""
    band, count = band_of(wave), len(numbers) // 2
    length, angle = numbers[:count], numbers[count:]
    fall = 1 / length
    phase = length[:, None] * band.rate
    half = phase.shape[1]
    spectrum = np.empty((count, 2 * half))
    cosine, sine = np.cos(phase, out=spectrum[:, :half]), np.sin(phase, out=spectrum[:, half:])
    bent = np.empty((3, count, 2 * half))  # the spectra, their slopes and curvatures
    wide = band.weight * band.rate
    np.multiply(cosine, band.weight, out=bent[0, :, :half])
    np.multiply(sine, band.weight, out=bent[0, :, half:])
    np.multiply(sine, -wide, out=bent[1, :, :half])
    np.multiply(cosine, wide, out=bent[1, :, half:])
    wide = wide * band.rate
    np.multiply(cosine, wide, out=bent[2, :, :half])
    np.multiply(sine, wide, out=bent[2, :, half:])
    over = np.outer(fall, fall)
    plain, sloped, curved = (bent.reshape(-1, 2 * half) @ spectrum.T).reshape(3, count, count) * over
    first = sloped - plain * fall[:, None]  # slope by the first path's length
    both = curved + sloped * (fall[:, None] - fall) + plain * over
    ahead, beside = np.cos(angle), np.sin(angle)
    turn, lean = band.element @ np.stack([ahead, beside]), band.element @ np.stack([-beside, ahead])
    c, s = np.cos(turn), np.sin(turn)
    antennas = np.concatenate([np.concatenate([c, s]), np.concatenate([-lean * s, lean * c])], 1)
    arrays = antennas.T @ antennas
    one, two, three = slice(0, count), slice(count, 2 * count), slice(2 * count, None)
    straight, turned = arrays[:count, :count], arrays[count:, :count]
    gram = np.empty((3 * count, 3 * count))
    gram[one, one] = straight * plain
    gram[two, one] = straight * first
    gram[one, two] = gram[two, one].T
    gram[two, two] = straight * both
    gram[three, one] = turned * plain
    gram[one, three] = gram[three, one].T
    gram[three, two] = turned * first.T
    gram[two, three] = gram[three, two].T
    gram[three, three] = arrays[count:, count:] * plain
    output = (spectrum @ got.halves).view(np.complex128).reshape(count, 2, len(c))
    response = (c - 1j * s).T  # conjugate
    matched = np.empty((3, count), np.complex128)
    matched[0] = (response * output[:, 0]).sum(1) * fall
    matched[1] = (response * output[:, 1]).sum(1) * fall - matched[0] * fall
    matched[2] = (-1j * lean.T * response * output[:, 0]).sum(1) * fall
    return Products(gram, matched.ravel(), got.energy, got.size)


def whiten(known: Products, power: Array, noise: float) -> Whitened:
    """Under noise and paths of these powers (C,); any further responses are slopes of the paths'."""
    count = len(power)
    if not count:
        density = float(-known.energy / noise - known.size * np.log(np.pi * noise))
        return Whitened(known.gram / noise, known.matched / noise, density)
    root = np.sqrt(power)
    cross = known.gram[:, :count] * root
    small = root[:, None] * cross[:count]
    small[np.arange(count), np.arange(count)] += noise
    lower, wrong = lapack.dpotrf(small, lower=1, clean=0)
    assert not wrong
    right = np.empty((count, len(cross) + 2), order="F")
    right[:, :-2] = cross.T
    met = root * known.matched[:count]
    right[:, -2], right[:, -1] = met.real, met.imag
    half, _ = lapack.dtrtrs(lower, right, lower=1, overwrite_b=1)
    rest = half[:, -2] + 1j * half[:, -1]
    gram = (known.gram - half[:, :-2].T @ half[:, :-2]) / noise
    matched = (known.matched - half[:, :-2].T @ rest) / noise
    fit = (known.energy - (half[:, -2:] ** 2).sum()) / noise
    logdet = 2 * np.log(np.diagonal(lower)).sum() - count * np.log(noise)
    return Whitened(gram, matched, float(-fit - logdet - known.size * np.log(np.pi * noise)))
