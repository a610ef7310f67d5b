"""How much power of a snapshot of arrays a path would take: a table over length, departure and arrival."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.samples.array_likelihood import ArrayBand, Complex
from gridslam.world.geometry import wrap

BESIDE = 1.2
"""Turn of phase (rms, rad) by length and by either angle, within which a peak is another path's."""


@dataclass(frozen=True, eq=False)
class MatchedPower:
    """|s^H z|^2 on the grid of a band's beams and of lengths that are even over its folding range.

    Attributes
    ----------
    band : ArrayBand
    power : (T, R, D) float32
        By departure, arrival and length, in the scale of the samples.
    """

    band: ArrayBand
    power: NDArray[np.float32]

    @classmethod
    def of(cls, band: ArrayBand, samples: Complex) -> MatchedPower:
        """That of samples (A, B, M)."""
        beams = band.beams
        anchor, agent, _ = samples.shape
        if beams.delay is None:
            delayed = band.delayed(samples)
        else:
            delayed = samples.astype(np.complex64).reshape(anchor * agent, -1) @ beams.delay
        part = (beams.out @ delayed.reshape(anchor, -1)).reshape(len(beams.out), agent, -1)
        part = beams.back @ part
        power = np.square(part.real)
        power += np.square(part.imag)
        return cls(band, power)

    def without(self, path: Array) -> MatchedPower:
        """The matched power with -1 beside paths (K, 3)."""
        power, beams, band = self.power.copy(), self.band.beams, self.band
        length, leaving, arriving = (
            np.abs(_turned(grid - path[:, [side]], turn)) * band.steepness[side] < BESIDE
            for side, (grid, turn) in enumerate(
                ((beams.length, band.folding_m), (beams.leaving, 2 * np.pi), (beams.arriving, 2 * np.pi))
            )
        )
        for d, t, r in zip(length, leaving, arriving, strict=True):
            power[np.ix_(np.flatnonzero(t), np.flatnonzero(r), np.flatnonzero(d))] = -1.0
        return MatchedPower(band, power)

    @property
    def highest(self) -> Array:
        """Where it is highest, (3,) m, rad, rad."""
        beams = self.band.beams
        t, r, d = np.unravel_index(int(self.power.argmax()), self.power.shape)
        return np.array([beams.length[d], beams.leaving[t], beams.arriving[r]])


def _turned(gap: Array, turn: float) -> Array:
    """Gaps less whole turns."""
    return np.asarray(gap - turn * np.round(gap / turn))


def beside(band: ArrayBand, path: Array, other: Array) -> NDArray[np.bool_]:
    """Which paths (..., 3) lie within the resolution of another one (3,), (...) bool."""
    return widths_apart(band, path, other) < BESIDE


def widths_apart(band: ArrayBand, path: Array, other: Array) -> Array:
    """Turn of phase (rms, rad) between paths (..., 3) and another one (3,), the largest of three, (...)."""
    gap = path - other
    gap[..., 0] = _turned(gap[..., 0], band.folding_m)
    gap[..., 1:] = wrap(gap[..., 1:])
    return np.asarray((np.abs(gap) * band.steepness).max(-1))
