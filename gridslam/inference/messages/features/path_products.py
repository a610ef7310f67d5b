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
    """Products of responses and samples in units of what is expected of samples, C being their covariance.

    Attributes
    ----------
    own : (C,) float64
        ``h^H C^-1 h`` of each response.
    matched : (C,) complex128
        ``h^H C^-1 z``.
    log_density : float
        Of the samples.
    """

    own: Array
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
    table : (4, H) float64
        Rate, weight, and weight times the rate and its square, as kernels take them.
    """

    rate: Array
    weight: Array
    element: Array
    table: Array


@lru_cache(8)
def band_of(wave: Waveform) -> Band:
    """The upper half of a waveform's band."""
    rate = 2 * np.pi / SPEED_OF_LIGHT * wave.offset_hz
    power = np.abs(wave.pulse) ** 2
    upper, middle = len(rate) // 2, len(rate) % 2
    both = power[upper:] + power[: len(rate) - upper][::-1]
    if middle:
        both[0] /= 2
    rate = rate[upper:]
    table = np.stack([rate, both, both * rate, both * rate**2])
    return Band(rate, both, 2 * np.pi / wave.wavelength_m * wave.agent_element_m, table)


def halves_of(samples: Complex, wave: Waveform) -> Array:
    """What cosines and sines at the frequencies above the carrier meet, (A, 4 N, H), of samples (A, N, M).

    Of each antenna, one below the other: what cosines meet, real and imaginary part, and what sines do.
    """
    upper, size = len(wave.offset_hz) // 2, len(wave.offset_hz)
    turned = wave.pulse.conj() * samples
    above, below = turned[..., upper:], turned[..., : size - upper][..., ::-1]
    out = np.empty((*samples.shape[:2], 4, size - upper))
    np.add(above.real, below.real, out=out[:, :, 0])
    np.add(above.imag, below.imag, out=out[:, :, 1])
    np.subtract(below.imag, above.imag, out=out[:, :, 2])
    np.subtract(above.real, below.real, out=out[:, :, 3])
    if size % 2:  # the carrier is its own mirror image
        out[:, :, 0, 0], out[:, :, 1, 0] = turned[..., upper].real, turned[..., upper].imag
        out[:, :, 2:, 0] = 0.0
    return out.reshape(len(samples), -1, size - upper)


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


def whiten(known: Products, power: Array, noise: float) -> Whitened:
    """Under noise and paths of these powers (C,)."""
    count = len(power)
    if not count:
        density = float(-known.energy / noise - known.size * np.log(np.pi * noise))
        return Whitened(np.zeros(0), known.matched, density)
    root = np.sqrt(power)
    cross = root[:, None] * known.gram
    small = cross * root
    small[np.arange(count), np.arange(count)] += noise
    lower, wrong = lapack.dpotrf(small, lower=1, clean=0)
    assert not wrong
    right = np.empty((count, count + 2), order="F")
    right[:, :-2] = cross
    met = root * known.matched
    right[:, -2], right[:, -1] = met.real, met.imag
    half, _ = lapack.dtrtrs(lower, right, lower=1, overwrite_b=1)
    own = (np.diagonal(known.gram) - (half[:, :-2] ** 2).sum(0)) / noise
    shared = half[:, :-2].T @ half[:, -2:]
    matched = (known.matched - shared[:, 0] - 1j * shared[:, 1]) / noise
    fit = (known.energy - (half[:, -2:] ** 2).sum()) / noise
    logdet = 2 * np.log(np.diagonal(lower)).sum() - count * np.log(noise)
    return Whitened(own, matched, float(-fit - logdet - known.size * np.log(np.pi * noise)))
