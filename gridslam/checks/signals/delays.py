"""Delays of sampled signals against the lengths of lines of sight at known places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.signals.places import Complex, Places
from gridslam.world.waveform import Waveform

FINE = 8
"""Points per resolution cell of the delay."""
STRONG = 0.8
"""Height, over a snapshot's highest peak, from which on one counts for an offset of all delays."""
SHARP, FAR = 0.125, 10.0
"""Resolution cells by which peaks of an offset differ; how many times that the agent must move."""
OFTEN = 0.35
"""Share of an anchor's snapshots, more than those with nothing off, that an offset must be seen in."""
HIGHEST_M, MORE = 12.0, 1.1
"""How far anchors may be above the agent; how many times as many snapshots as by an offset must fit then."""


@dataclass(frozen=True, eq=False)
class Delays:
    """Snapshots at known places, and their delays.

    Attributes
    ----------
    samples : (N, A, B, M) complex
    profile : (N, n)
        Power over delays, by its highest.
    folding_m : float
    """

    samples: Complex
    profile: Array
    folding_m: float

    @classmethod
    def of(cls, samples: Array, waveform: Waveform, places: Places) -> Delays:
        """Delays of a file's snapshots, those at known places.

        Parameters
        ----------
        samples : (K, J, A, B, M) complex
            Of all steps and anchors.
        """
        return cls.alone(samples[places.step, places.anchor].astype(np.complex128), waveform)

    @classmethod
    def alone(cls, own: Complex, waveform: Waveform) -> Delays:
        """Delays of snapshots (N, A, B, M), those at known places alone."""
        profile = delay_profile(own, waveform)
        return cls(own, profile / profile.max(-1, keepdims=True), waveform.folding_m)

    def share(self, places: Places, half: float, shift: float = 0.0, flipped: bool = False) -> float:
        """Mean height of what is at the line of sight, over the highest peak."""
        table = np.roll(self.profile[:, ::-1], 1, axis=1) if flipped else self.profile
        return float(_at(table, places.distance_m + shift, half, self.folding_m).mean())

    def middle(self, places: Places, half: float, shift: float) -> float:
        """Median offset of the peaks within `half` of a shift, m: shifts up to there find them as well."""
        offset, height = self.peaks(places, half, shift)
        strong = height > STRONG
        return float(np.median(offset[strong] if strong.any() else offset))

    def peaks(self, places: Places, half: float, shift: float | Array) -> tuple[Array, Array]:
        """Offsets (N,) in m of the highest peaks within `half` of a shift, and their heights.

        Parameters
        ----------
        half : float
            How far from the shift peaks are looked for, m.
        shift : float or (N,) m
        """
        count = self.profile.shape[1]
        reach = int(np.ceil(half * count / self.folding_m))
        about = np.rint((places.distance_m + shift) * count / self.folding_m).astype(int)
        columns = about[:, None] + np.arange(-reach, reach + 1)
        near = np.take_along_axis(self.profile, columns % count, 1)
        peak = np.take_along_axis(columns, near.argmax(1)[:, None], 1)[:, 0] * self.folding_m / count
        return peak - places.distance_m, near.max(1)

    def blur(self, places: Places) -> float:
        """By how much (m) peaks of one offset differ."""
        return max(SHARP * self.folding_m * FINE / self.profile.shape[1], places.slack_m)

    def sharp(self, places: Places, half: float, shift: float | Array, loose: bool) -> NDArray[np.bool_]:
        """Which snapshots (N,) have their strongest peak sharply at a shift, or, `loose`, all beside it.

        Parameters
        ----------
        half : float
            How far from the shift peaks are looked for, m.
        shift : float or (N,) m
        """
        offset, height = self.peaks(places, half, shift)
        strong, apart = height > STRONG, offset - shift
        about = np.median(apart[strong]) if loose and strong.any() else 0.0
        return strong & (np.abs(apart - about) < self.blur(places))

    def common(self, places: Places, half: float) -> tuple[float | None, float | None]:
        """An offset (m) of all delays of several anchors, and their height (m) over the agent if that is it.

        Walls may hide one anchor or another for all the way, or for a part of it: what counts are snapshots
        whose strongest peak is there, so sharply that paths by walls, whose lengths change by other amounts
        than the line of sight's, can't be meant.
        """
        shifts = np.arange(half, self.folding_m - half, 0.5 * half)
        shift = max(shifts, key=lambda one: self.sharp(places, half, one, True).sum(), default=0.0)
        rise = self.rise(places, half, shift)
        if rise is not None:
            fits = self._often(places, half, self.sharp(places, half, _longer(places, rise), False))
        else:
            there = self.sharp(places, half, shift, True)
            small = there.any() and abs(np.median(self.peaks(places, half, shift)[0][there])) < half
            fits = not small and self._often(places, half, there)
        return (shift, rise) if fits else (None, None)

    def rise(self, places: Places, half: float, shift: float) -> float | None:
        """How far anchors are above or below the agent, m, if that explains lengths better than a shift."""
        rises = np.arange(half, HIGHEST_M, 0.25 * half)
        seen = [self.sharp(places, half, _longer(places, rise), False).sum() for rise in rises]
        least = self.sharp(places, half, shift, True).sum()
        if not len(self._moving(places)) or max(seen, default=0) <= MORE * least:
            return None
        return float(rises[int(np.argmax(seen))])

    def _moving(self, places: Places) -> NDArray[np.intp]:
        """Anchors from which the agent's distance changes by enough to tell offsets from other paths."""
        each = np.unique(places.anchor)
        wide = np.array([np.ptp(places.distance_m[places.anchor == one]) for one in each])
        return each[wide > FAR * self.blur(places)]

    def _often(self, places: Places, half: float, there: NDArray[np.bool_]) -> bool:
        """Whether moving anchors' peaks are there, for two or more, and for none rather where they belong."""
        plain = self.sharp(places, half, 0.0, False)
        rows = self._moving(places)[:, None] == places.anchor
        more = np.array([there[own].mean() - plain[own].mean() for own in rows])
        return bool((more > OFTEN).sum() > 1 and (more > -OFTEN).all())


def _longer(places: Places, rise: float) -> Array:
    """By how much lines of sight (N,) to anchors above or below are longer, m."""
    return np.asarray(np.hypot(places.distance_m, rise) - places.distance_m)


def delay_profile(samples: Complex, waveform: Waveform) -> Array:
    """Power (N, n) over lengths up to the folding range, of snapshots (N, A, B, M), all antennas together."""
    count = FINE * len(waveform.offset_hz)
    response = np.fft.ifft(samples * waveform.pulse.conj(), count, axis=-1) * count
    return np.asarray((np.abs(response) ** 2).sum((1, 2)))


def _at(table: Array, lengths: Array, half: float, folding: float) -> Array:
    """Largest value (N,) of rows (N, n) within `half` of lengths (N,), around the folding range."""
    count = table.shape[1]
    reach = int(np.ceil(half * count / folding))
    middle = np.rint(lengths * count / folding).astype(int)
    columns = (middle[:, None] + np.arange(-reach, reach + 1)) % count
    return np.asarray(np.take_along_axis(table, columns, 1).max(1))
