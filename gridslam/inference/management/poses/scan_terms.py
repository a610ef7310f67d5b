"""What all searches for poses ask of an anchor's measurements: the loudest, variances, strengths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.health.monitor import MOST_LOUD
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.deviations import deviations
from gridslam.world.radio import RadioModel

MAP_M, MAP_RAD = 0.03, 0.02
"""What a map's own errors add to a measurement's."""
MAP_VARIANCE = np.array([MAP_M, MAP_RAD, MAP_RAD]) ** 2
LOUDEST = 25.0
"""Nats that a loud amplitude tells against clutter at most."""


def loudest_rows(scan: AnchorScan, radio: RadioModel) -> tuple[NDArray[np.intp], Array]:
    """Rows (N,) of the loud measurements with distance and both angles, and their deviations (N, 3).

    `MOST_LOUD` at most: else poses times measurements would grow with their square.
    """
    rows = np.flatnonzero(~np.isnan(scan.value).any(1) & scan.loud)
    if len(rows) > MOST_LOUD:
        rank = np.argsort(-np.nan_to_num(scan.amplitude[rows], nan=radio.threshold), kind="stable")
        rows = np.sort(rows[rank[:MOST_LOUD]])
    if not len(rows):
        return rows, np.zeros((0, 3))
    strength = np.nan_to_num(scan.amplitude[rows], nan=radio.threshold)
    return rows, deviations(scan, rows, strength, scan.value[rows, 1:], radio)


@dataclass(frozen=True, eq=False)
class ScanTerms:
    """One anchor's measurements, to be compared with paths over a map.

    Attributes
    ----------
    known : (M,) bool
        Whether the amplitude is measured.
    amplitude : (M,)
        The threshold where it isn't.
    measured : (M, 3) bool
        Of distance, AoD and AoA.
    variance : (M, 3) m^2, rad^2, rad^2
        With the map's own; 1 where nothing is measured.
    tail : (M,)
        How much rarer among clutter one so loud is than at the threshold, nats.
    flat : (3,)
        Ranges in which clutter may lie anywhere: m, rad, rad.
    """

    known: NDArray[np.bool_]
    amplitude: Array
    measured: NDArray[np.bool_]
    variance: Array
    tail: Array
    flat: Array

    @classmethod
    def of(cls, scan: AnchorScan, radio: RadioModel) -> Self:
        """The measurements of a scan."""
        known = np.isfinite(scan.amplitude)
        amplitude = np.where(known, scan.amplitude, radio.threshold)
        std = deviations(scan, np.arange(len(scan)), amplitude, np.nan_to_num(scan.value[:, 1:]), radio)
        measured = np.isfinite(std)
        variance = np.where(measured, std, 1.0) ** 2 + MAP_VARIANCE
        tail = np.where(known, np.minimum(amplitude**2 - radio.threshold**2, LOUDEST), 0.0)
        flat = np.array([radio.span_m, 2 * np.pi, 2 * np.pi])
        return cls(known, amplitude, measured, variance, tail, flat)

    def misfit(self, strength: Array) -> Array:
        """Squared misfits of the amplitudes, of paths of strengths (N, L) at poses: (N, L, M)."""
        blur = 0.5 + (0.25 * strength[..., None]) ** 2
        return np.asarray(np.where(self.known, (self.amplitude - strength[..., None]) ** 2 / blur, 0.0))
