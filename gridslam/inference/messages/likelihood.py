"""Beliefs about amplitudes, detection probability, and the accuracy of distance and angles.

A belief about a path's amplitude is a distribution over nodes: products of reflection coefficients in grid
SLAM, amplitudes in adaptive SLAM. Both meet the measurements in the same kernel.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.state.anchor_measurements import AnchorScan
from gridslam.kernels import FAINTEST
from gridslam.world.geometry import lean
from gridslam.world.radio import RadioModel


class AmplitudeBelief(Protocol):
    """Distribution of every path's amplitude over nodes."""

    @property
    def probability(self) -> Array:
        """Probability of every node, (L, K)."""
        ...

    @property
    def nodes(self) -> Array:
        """Amplitudes of the nodes (K,), at a metre's distance if they are `spreading`."""
        ...

    @property
    def spreading(self) -> bool:
        """Whether amplitudes fall with the inverse of the path's length."""
        ...


class DetectionTable:
    """p_d(u) by interpolation in a table, since it depends on u alone.

    Attributes
    ----------
    step : float
        From one entry to the next, beginning at 0.
    chance : (T,)
    """

    def __init__(self, signal: RadioModel) -> None:
        self._u = np.linspace(0, 40, 2001)
        self.step = float(self._u[1])
        self.chance = signal.detection_probability(np.maximum(self._u, 1e-6))

    def __call__(self, amplitude: Array) -> Array:
        """Detection probability of any amplitudes."""
        return np.interp(amplitude, self._u, self.chance)


@lru_cache(16)
def detection_table(signal: RadioModel) -> DetectionTable:
    """The table of a radio, made once."""
    return DetectionTable(signal)


def deviations(
    heard: AnchorScan, measurement: NDArray[np.intp], amplitude: Array, angles: Array, signal: RadioModel,
    steep: Array | float | None = None,
) -> Array:  # fmt: skip
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
    steep : (n,), optional
        Cosine of the path's elevation; default: by the anchor's height and the measured distance.
    """
    value, own_std = heard.value[measurement], heard.own_std[measurement]
    amplitude = np.maximum(amplitude, FAINTEST)
    fisher = np.empty((len(value), 3))
    fisher[:, 0] = signal.distance_std(amplitude)
    aperture = signal.anchor_aperture.mean(0) if heard.anchor < 0 else signal.anchor_aperture[heard.anchor]
    height = heard.height if heard.anchor >= 0 else 0.0
    if steep is None:
        steep = lean(np.nan_to_num(value[:, 0], nan=np.inf), height) if height else 1.0
    fisher[:, 1] = signal.angle_std(amplitude, angles[:, 0], aperture, steep)
    fisher[:, 2] = signal.angle_std(amplitude, angles[:, 1], signal.agent_aperture, steep)
    std = np.where(np.isnan(own_std), fisher, own_std)
    return np.where(np.isnan(value), np.inf, std)
