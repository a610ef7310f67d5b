"""A path's amplitude, and what follows from it: detection probability and Fisher variances.

[Li2025adaptive], eqs. (2)-(5); docs/model.md, (M9)-(M14).

The normalised amplitude u is the square root of a path's SNR. Everything that a measurement's accuracy
depends on follows from it: a strong path is seen surely and measured sharply.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtr, i0e

from gridslam.arrays import Array

SPEED_OF_LIGHT = 299_792_458.0
REFLECTION_BINS: Array = (np.arange(20) + 0.5) / 20
"""Centres of the bins in which beliefs about a reflection coefficient are kept."""
BINS = len(REFLECTION_BINS)
CLUTTER_LOG_FLOOR = -25.0


@dataclass(frozen=True, eq=False)
class RadioModel:
    """The radio's numbers that the likelihoods need.

    Attributes
    ----------
    amplitude_at_1m : float
        u_1m = 10^(SNR_1m / 20).
    threshold : float
        Detection threshold u_de of the amplitude.
    bandwidth_hz : float
        Width of the flat spectrum; its root mean square bandwidth is B / sqrt(12).
    samples : float
        N, number of signal samples over all antenna pairs.
    false_alarms : float
        Mean number of clutter measurements per anchor and step.
    max_distance_m : float
    anchor_aperture, agent_aperture : (J, 2) and (2,)
        Mean square extent of the arrays along their own x and y axis, in wavelengths^2.
    measures : tuple of str
        Which of distance, aod, aoa and amplitude the radio measures.
    given_detection, given_distance_std : float or None
        Detection probability and sigma_d (m) of every path, instead of those that follow from its amplitude.
    window_m : (float, float) or None
        What measured distances may be; None for 0 to the longest.
    image_gains : tuple of float
        Factors of amplitudes of the anchors, and of their images in floor and ceiling where those follow.
    upright : tuple of float
        Mean square extents of the anchors' arrays upwards, then of the agent's, in wavelengths^2; empty where
        there are no heights.
    """

    amplitude_at_1m: float
    threshold: float
    bandwidth_hz: float
    samples: float
    false_alarms: float
    max_distance_m: float
    anchor_aperture: Array
    agent_aperture: Array
    measures: tuple[str, ...] = ("distance", "aod", "aoa", "amplitude")
    given_detection: float | None = None
    given_distance_std: float | None = None
    window_m: tuple[float, float] | None = None
    image_gains: tuple[float, ...] = (1.0,)
    upright: tuple[float, ...] = ()

    def imaged(self, gains: Array) -> RadioModel:
        """The radio of all anchors, then of their images in floor and ceiling, with gains (V,), 1 first."""
        aperture = np.tile(self.anchor_aperture, (len(gains), 1))
        return replace(self, anchor_aperture=aperture, image_gains=tuple(gains.tolist()))

    @property
    def senders(self) -> int:
        """Anchors without images."""
        return len(self.anchor_aperture) // len(self.image_gains)

    @property
    def span_m(self) -> float:
        """Width of the window that clutter's distances are uniform over, m."""
        return self.max_distance_m if self.window_m is None else self.window_m[1] - self.window_m[0]

    @property
    def distance_scale(self) -> float:
        """sigma_d times u, m."""
        return SPEED_OF_LIGHT / (math.sqrt(8) * math.pi * self.bandwidth_hz / math.sqrt(12))

    @cached_property
    def numbers(self) -> Array:
        """What kernels take of the radio, (J, 12), by anchors; see `gridslam.kernels.primitives.radio`."""
        given = 0.0 if self.given_distance_std is None else self.given_distance_std
        numbers = np.empty((len(self.anchor_aperture), 12))
        numbers[:] = (
            self.distance_scale, given, 0.0, 0.0, *self.agent_aperture, self.span_m,
            self.amplitude_at_1m, self.samples, self.threshold, self.false_alarms, 0.0,
        )  # fmt: skip
        numbers[:, 2:4] = self.anchor_aperture
        numbers[:, 7] *= np.repeat(self.image_gains, self.senders)
        numbers[:, 11] = np.arange(len(numbers)) % self.senders
        numbers.setflags(write=False)
        return numbers

    def amplitude(self, distance: Array | float, reflection: Array | float = 1.0) -> Array:
        """Predicted normalised amplitude, [Li2026grid], eq. (2)."""
        return self.amplitude_at_1m / np.maximum(distance, 1e-3) * reflection

    def distance_std(self, amplitude: Array) -> Array:
        """sigma_d of a path, m: given, or from Fisher information; [Li2026grid], section III-B."""
        if self.given_distance_std is not None:
            return np.full(np.shape(amplitude), self.given_distance_std)
        return self.distance_scale / amplitude

    def angle_std(self, amplitude: Array, angle: Array, aperture: Array, steep: Array | float = 1.0) -> Array:
        """sigma of an angle seen by an array with mean square extents `aperture` (..., 2), rad.

        [Li2026grid], section III-B. Infinite where the array has no extent across the direction. Of a path
        with the cosine `steep` of its elevation, a horizontal array sees that share of the difference between
        elements.
        """
        square = np.sin(angle) ** 2 * aperture[..., 0] + np.cos(angle) ** 2 * aperture[..., 1]
        with np.errstate(divide="ignore"):
            return 1 / (math.sqrt(8) * math.pi * amplitude * np.sqrt(square)) / steep

    @property
    def departs(self) -> bool:
        """Whether any anchor's directions of departure are measured: what one antenna sends has none."""
        return "aod" in self.measures and bool(self.anchor_aperture.any())

    @property
    def elevated(self) -> tuple[bool, bool]:
        """Whether elevations are measured: of departures, by any anchor, and of arrivals."""
        *anchors, agent = self.upright or (0.0,)
        departing = "aod" in self.measures and any(anchors)
        return departing, "aoa" in self.measures and agent > 0

    def elevation_std(self, amplitude: Array, anchor: NDArray[np.intp], steep: Array | float) -> Array:
        """sigma of elevations of departure and arrival, (..., 2) rad; docs/model.md, (M301).

        Infinite where an array has no extent upwards.

        Parameters
        ----------
        amplitude : (...)
        anchor : (...) int
        steep : (...)
            Cosine of the elevation.
        """
        extent = np.array(self.upright or (0.0,) * (self.senders + 1))
        both = np.stack([extent[anchor], np.full(np.shape(anchor), extent[-1])], -1)
        with np.errstate(divide="ignore"):
            std = 1 / (np.sqrt(8) * np.pi * np.asarray(amplitude * steep)[..., None] * np.sqrt(both))
        return np.where([end in self.measures for end in ("aod", "aoa")], std, np.inf)

    def amplitude_std(self, amplitude: Array) -> Array:
        """Scale sigma_u of the Rician amplitude; docs/model.md, (M10)."""
        return np.sqrt(0.5 + amplitude**2 / (4 * self.samples))

    def detection_probability(self, amplitude: Array) -> Array:
        """p_d(u): given, or Marcum Q of first order; [Li2026grid], section III-B."""
        if self.given_detection is not None:
            return np.full(np.shape(amplitude), self.given_detection)
        scale = self.amplitude_std(amplitude)
        return 1 - chndtr((self.threshold / scale) ** 2, 2, (amplitude / scale) ** 2)

    def log_rician(self, measured: Array, amplitude: Array) -> Array:
        """Log density of the measured amplitude, not truncated: p_d times the truncated Rician."""
        variance = self.amplitude_std(amplitude) ** 2
        argument = measured * amplitude / variance
        return (
            np.log(measured / variance) - (measured - amplitude) ** 2 / (2 * variance) + np.log(i0e(argument))
        )

    def log_clutter(self, amplitude: Array) -> Array:
        """Log density of a clutter measurement over distance, both angles and amplitude.

        The amplitude factor (a Rayleigh with scale^2 = 1/2 above the threshold) is floored, since an
        amplitude that clutter can't have would otherwise overflow the likelihood ratio. Missing
        amplitudes (NaN) leave that factor out.
        """
        missing = np.isnan(amplitude)
        known = np.where(missing, 1.0, amplitude)
        tail = np.log(2 * known) - (known**2 - self.threshold**2)
        tail = np.where(missing, 0.0, np.maximum(tail, CLUTTER_LOG_FLOOR))
        return np.asarray(tail - np.log(self.span_m) - 2 * np.log(2 * np.pi))


def aperture(rows: int, columns: int, spacing_wavelengths: float) -> Array:
    """Mean square extents (x: columns, y: rows) of a uniform rectangular array, wavelengths^2."""
    count = np.array([columns, rows], dtype=np.float64)
    return spacing_wavelengths**2 * (count**2 - 1) / 12
