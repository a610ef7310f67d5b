"""Beliefs about amplitudes, and the probability of detection that follows from an amplitude.

A belief about a path's amplitude is a distribution over nodes: products of reflection coefficients in grid
SLAM, amplitudes in adaptive SLAM. Both meet the measurements in one kernel: `likelihood_ratios.evaluate`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol

import numpy as np

from gridslam.arrays import Array
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

    def __init__(self, radio: RadioModel) -> None:
        self._u = np.linspace(0, 40, 2001)
        self.step = float(self._u[1])
        self.chance = radio.detection_probability(np.maximum(self._u, 1e-6))

    def __call__(self, amplitude: Array) -> Array:
        """Detection probability of any amplitudes."""
        return np.interp(amplitude, self._u, self.chance)


@lru_cache(16)
def detection_table(radio: RadioModel) -> DetectionTable:
    """The table of a radio, made once."""
    return DetectionTable(radio)
