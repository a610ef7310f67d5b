"""What a measurement's amplitude says of a path, and how accurate its distance and angles are.

A belief about a path's amplitude is a distribution over nodes: products of reflection coefficients in grid
SLAM, amplitudes in adaptive SLAM. Both meet the measurements through the same table of Rician densities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.heard import Heard
from gridslam.signal import SignalModel

Array = NDArray[np.float64]
FAINTEST = 0.3
"""Amplitude below which accuracy is taken to get no worse: nothing fainter is detected."""


class AmplitudeBelief(Protocol):
    """Distribution of every path's amplitude over nodes."""

    @property
    def probability(self) -> Array:
        """Probability of every node, (L, K)."""
        ...

    def levels(self, distance: Array) -> Array:
        """Amplitudes of the nodes for a path of length `distance` (n,) m, shape (n, K)."""
        ...


class DetectionTable:
    """p_d(u) by interpolation in a table, since it depends on u alone."""

    def __init__(self, signal: SignalModel) -> None:
        self._u = np.linspace(0, 40, 2001)
        self._p = signal.detection_probability(np.maximum(self._u, 1e-6))

    def __call__(self, amplitude: Array) -> Array:
        """Detection probability of any amplitudes."""
        return np.interp(amplitude, self._u, self._p)


@dataclass(frozen=True)
class Strengths:
    """What the amplitudes say.

    Attributes
    ----------
    detected : (L,)
        Detection probability of the path.
    ratio : (L, M)
        Amplitude's likelihood times p_d, over ``mu_fa f_fa`` of the whole measurement.
    amplitude : (L, M)
        Mean amplitude of the path, if the measurement is its.
    """

    detected: Array
    ratio: Array
    amplitude: Array


def strengths(
    belief: AmplitudeBelief, heard: Heard, distance: Array, table: DetectionTable, signal: SignalModel
) -> Strengths:
    """Evaluate the amplitudes of all measurements under all paths of length `distance` (L,)."""
    paths, count = len(distance), len(heard)
    strength, mean = np.zeros((paths, count)), np.zeros((paths, count))
    own = belief.levels(distance)
    detected = (belief.probability * table(own)).sum(1)
    if not paths or not count:
        return Strengths(detected, strength, mean)
    loud = ~np.isnan(heard.amplitude)
    ranged = ~np.isnan(heard.value[:, 0])
    # the path behind a gated measurement has the measured length: one row of nodes per measurement
    quick = np.flatnonzero(loud & ranged)
    level = belief.levels(heard.value[quick, 0])
    density = np.exp(signal.log_rician(heard.amplitude[quick, None], level))
    strength[:, quick] = belief.probability @ density.T
    mean[:, quick] = belief.probability @ (density * level).T
    for m in np.flatnonzero(~(loud & ranged)):
        factor = np.exp(signal.log_rician(np.full(1, heard.amplitude[m]), own)) if loud[m] else table(own)
        strength[:, m] = (belief.probability * factor).sum(1)
        mean[:, m] = (belief.probability * factor * own).sum(1)
    usual = (belief.probability * own).sum(1)[:, None]
    mean = np.where(strength > 1e-300, mean / np.maximum(strength, 1e-300), usual)
    clutter = np.log(signal.false_alarms) + signal.log_clutter(heard.amplitude)
    return Strengths(detected, strength * np.exp(-clutter), mean)


def deviations(
    heard: Heard, measurement: NDArray[np.intp], amplitude: Array, angles: Array, signal: SignalModel
) -> Array:
    """Standard deviations (n, 3) of (distance, AoD, AoA): the table's own, or from Fisher information.

    Infinite where nothing was measured.

    Parameters
    ----------
    measurement : (n,)
        Rows of `heard`.
    amplitude : (n,)
        Believed amplitude of the path behind each.
    angles : (n, 2) rad
        AoD and AoA, on which the arrays' aperture depends.
    """
    aperture = signal.anchor_aperture[heard.anchor]
    return accuracy(heard.value[measurement], heard.own_std[measurement], amplitude, angles, aperture, signal)


def accuracy(
    value: Array, own_std: Array, amplitude: Array, angles: Array, aperture: Array, signal: SignalModel
) -> Array:
    """As `deviations`, of measurements `value` and deviations `own_std` that came with them, (n, 3) both.

    Parameters
    ----------
    aperture : (2,) or (n, 2)
        Mean square extents of the anchors' arrays.
    """
    amplitude = np.maximum(amplitude, FAINTEST)
    fisher = np.empty((len(value), 3))
    fisher[:, 0] = signal.distance_std(amplitude)
    fisher[:, 1] = signal.angle_std(amplitude, angles[:, 0], aperture)
    fisher[:, 2] = signal.angle_std(amplitude, angles[:, 1], signal.agent_aperture)
    std = np.where(np.isnan(own_std), fisher, own_std)
    return np.where(np.isnan(value), np.inf, std)
