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
    power : (T, R, D)
        By departure, arrival and length, in the scale of the samples.
    """

    band: ArrayBand
    power: Array

    @classmethod
    def of(cls, band: ArrayBand, samples: Complex) -> MatchedPower:
        """That of samples (A, B, M)."""
        beams = band.beams
        delayed = np.fft.ifft(samples * np.conj(band.pulse), len(beams.length), axis=2)
        agent, delays = delayed.shape[1:]
        part = (beams.out @ delayed.reshape(len(delayed), -1)).reshape(-1, agent, delays)
        part = beams.back @ part
        power = np.square(part.real)
        power += np.square(part.imag)
        power *= delays**2
        return cls(band, power)

    def without(self, path: Array) -> MatchedPower:
        """The same with -1 beside paths (K, 3)."""
        power, beams, band = self.power.copy(), self.band.beams, self.band
        for one in path:
            turned = 2 * np.pi / band.folding_m * (beams.length - one[0])
            near = [np.abs(wrap(turned)) * band.folding_m / (2 * np.pi) * band.steepness[0] < BESIDE]
            near += [
                np.abs(wrap(angles - angle)) * steep < BESIDE
                for angles, angle, steep in zip(
                    (beams.leaving, beams.arriving), one[1:], band.steepness[1:], strict=True
                )
            ]
            power[np.ix_(near[1], near[2], near[0])] = -1.0
        return MatchedPower(band, power)

    @property
    def highest(self) -> Array:
        """Where it is highest, (3,) m, rad, rad."""
        beams = self.band.beams
        t, r, d = np.unravel_index(int(self.power.argmax()), self.power.shape)
        return np.array([beams.length[d], beams.leaving[t], beams.arriving[r]])


def beside(band: ArrayBand, path: Array, other: Array) -> NDArray[np.bool_]:
    """Which paths (..., 3) lie within the resolution of another one (3,), (...) bool."""
    return widths_apart(band, path, other) < BESIDE


def widths_apart(band: ArrayBand, path: Array, other: Array) -> Array:
    """Turn of phase (rms, rad) between paths (..., 3) and another one (3,), the largest of three, (...)."""
    gap = path - other
    gap[..., 0] -= band.folding_m * np.round(gap[..., 0] / band.folding_m)
    gap[..., 1:] = wrap(gap[..., 1:])
    return np.asarray((np.abs(gap) * band.steepness).max(-1))
