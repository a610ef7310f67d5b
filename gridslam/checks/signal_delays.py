"""Delays of sampled signals against the lengths of lines of sight at known places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.signal_places import Complex, Places
from gridslam.world.waveform import Waveform

FINE = 8
"""Points per resolution cell of the delay."""
STRONG = 0.8
"""Height, over a snapshot's highest peak, from which on one counts for an offset of all delays."""
SHARP, FAR = 0.125, 10.0
"""Resolution cells by which peaks of an offset differ; how many times that the agent must move."""
OFTEN = 0.35
"""Share of an anchor's snapshots, more than those with nothing off, that an offset must be seen in."""


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
        """Those of a file's samples (K, J, A, B, M)."""
        own = samples[places.step, places.anchor].astype(np.complex128)
        profile = delay_profile(own, waveform)
        return cls(own, profile / profile.max(-1, keepdims=True), waveform.folding_m)

    def share(self, places: Places, half: float, shift: float = 0.0, flipped: bool = False) -> float:
        """Mean height of what is at the line of sight, over the highest peak."""
        table = np.roll(self.profile[:, ::-1], 1, axis=1) if flipped else self.profile
        return float(_at(table, places.distance_m + shift, half, self.folding_m).mean())

    def middle(self, places: Places, half: float, shift: float) -> float:
        """Median offset of the peaks within `half` of a shift, m: shifts up to there find them as well."""
        return float(np.median(self.peaks(places, half, shift)[0]))

    def peaks(self, places: Places, half: float, shift: float) -> tuple[Array, Array]:
        """Offsets (N,) in m of the highest peaks within `half` of a shift, and their heights."""
        count = self.profile.shape[1]
        reach = int(np.ceil(half * count / self.folding_m))
        about = np.rint((places.distance_m + shift) * count / self.folding_m).astype(int)
        columns = about[:, None] + np.arange(-reach, reach + 1)
        near = np.take_along_axis(self.profile, columns % count, 1)
        peak = np.take_along_axis(columns, near.argmax(1)[:, None], 1)[:, 0] * self.folding_m / count
        return peak - places.distance_m, near.max(1)

    def common(self, places: Places, half: float) -> float | None:
        """An offset (m) that all delays of several anchors have while the agent moves, or None.

        Walls may hide one anchor or another for all the way, or for a part of it: what counts are snapshots
        whose strongest peak is there, so sharply that paths by walls, whose lengths change by other amounts
        than the line of sight's, can't be meant.
        """
        wide = np.array([np.ptp(places.distance_m[places.anchor == one]) for one in places.anchors])
        sharp = max(SHARP * self.folding_m * FINE / self.profile.shape[1], places.slack_m)
        moving = places.anchors[wide > FAR * sharp]
        if sharp > half or len(moving) < 2:
            return None

        def there(shift: float) -> NDArray[np.bool_]:
            offset, height = self.peaks(places, half, shift)
            strong = height > STRONG
            about = np.median(offset[strong]) if shift and strong.any() else 0.0
            return strong & (np.abs(offset - about) < sharp)

        shifts = np.arange(half, self.folding_m - half, 0.5 * half)
        shift = max(shifts, key=lambda one: there(one).sum(), default=0.0)
        own, plain = (
            np.array([at[places.anchor == j].mean() for j in moving]) for at in map(there, (shift, 0))
        )
        return shift if (own - plain > OFTEN).sum() > 1 and (plain - own < OFTEN).all() else None


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
