"""Lines of sight among paths that nobody knows yet; docs/model.md, (M451), (M452).

As long as no feature is known, whatever else is received isn't noise: it may be louder than the line of
sight, and overlap it. Two things tell them apart: no way is shorter than the straight one, so that nothing
arrives before a line of sight, be it seen or hidden; and it is one wave of one direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.matched_outputs import COARSE_ROWS, ROWS
from gridslam.inference.messages.samples.noise_levels import median_noise

Complex = NDArray[np.complex128]
STRIDE = 2
"""Every which row of the coarse tables is looked at: 6 cm at 10 MHz."""
COST = 12.0
"""Nats that a path costs that nobody knows of, as a new feature does."""
LEAKS = 4.0
"""Least power of an arrival in that of any other's side lobe where it stands: lobes add up."""
MISFIT = 0.03
"""Share of a line of sight's power that is left of it where it is looked for 5 cm beside its place."""
DEVIATIONS = 3.0
"""Of the agent's place, by which a line of sight may be shorter."""
OLD_M = 0.3
"""How near a path is to where one was the step before, to be the same."""
FINE = 2
"""Rows of a pulse's flank, at least, for what arrives first to be told from side lobes: 41 frequencies have
six, 201 two."""
HALF, LOBE = 0.5, 0.05
"""Shares of its power to which a pulse falls on its flank, and where its main lobe ends."""


@dataclass(frozen=True, eq=False)
class Arrivals:
    """What an anchor's antennas receive at one step by lengths, every `step_m`.

    Attributes
    ----------
    output : (T, N) complex128
        Matched outputs.
    noise : float
        Their power in noise.
    pulse : (T,)
        Correlation of the pulse.
    step_m : float
    peak : (n,) int64
        Rows where most is received.
    lobes : (T,)
        Most that these send elsewhere by their side lobes, power per antenna.
    old : (T,) bool
        Where a path was heard the step before.
    """

    output: Complex
    noise: float
    pulse: Array
    step_m: float
    peak: NDArray[np.int64]
    lobes: Array
    old: NDArray[np.bool_]

    @classmethod
    def of(cls, samples: Complex, front: Front, before: Complex | None = None) -> Self:
        """Those of the samples (N, M) of a step, and of the one before."""
        part = front.coarse(samples[None])[0, ::STRIDE].astype(np.float64)
        noise = max(median_noise((part**2).sum(-1)), 1e-300)
        apart = STRIDE * ROWS // COARSE_ROWS
        pulse = front.pulse[::apart, 0] / front.pulse[0, 0]
        output = part[..., 0] + 1j * part[..., 1]
        power = (np.abs(output) ** 2).mean(1)
        peak = 1 + np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:]))
        apart_by = np.abs(np.arange(len(power))[:, None] - peak)
        lobes = (_side_lobes(pulse)[apart_by] * power[peak]).max(1, initial=0.0)
        found = cls(output, noise, pulse, apart / front.reach[0], peak, lobes, np.zeros(len(output), bool))
        return found if before is None else replace(found, old=found._near(cls.of(before, front)))

    def _near(self, other: Self) -> NDArray[np.bool_]:
        """Rows (T,) within `OLD_M` of the paths of another step."""
        power = (np.abs(other.output[other.peak]) ** 2).mean(1)
        path = other.peak[other._explained(power, other.peak) > COST]
        apart_by = np.abs(np.arange(len(self.output))[:, None] - path)
        near: NDArray[np.bool_] = (apart_by * self.step_m < OLD_M).any(1)
        return near

    def against(self, length_m: Array) -> Array:
        """Nats that speak against lines of sight of these lengths (P,): what arrives before them.

        At a length where N antennas receive the power N s, in that of noise, besides what the line of sight
        sends there, a path explains N (s - 1 - log s).
        """
        row = np.clip(length_m / self.step_m, 0, len(self.output) - 1)
        first, last = int(row.min()), min(int(row.max()) + 2, len(self.output))
        found = np.zeros(last - first)
        for at in range(first, last):
            sent = self.pulse[at:0:-1, None] * self.output[at]
            left = (np.abs(self.output[:at] - sent) ** 2).mean(1)
            left -= MISFIT * (np.abs(self.output[at]) ** 2).mean()
            found[at - first] = self._explained(left, slice(0, at)).max(initial=COST) - COST
        nats: Array = np.interp(row, np.arange(first, last), found)
        return nats

    def before(self, length_m: float) -> bool:
        """Whether something arrives before a line of sight of this length, and isn't its own flank."""
        flank = self.flank
        if flank < FINE:
            return False
        early = self.peak[self.peak < length_m / self.step_m - flank]
        power = (np.abs(self.output[early]) ** 2).mean(1)
        return bool((self._explained(power, early) > COST).any())

    @property
    def flank(self) -> int:
        """Rows from a pulse's summit to half of its power."""
        return int(np.argmax(self.pulse**2 < HALF))

    def first_m(self) -> float:
        """Length of the path that arrives first, m; 0 if none does, or rows are too coarse to tell."""
        if self.flank < FINE:
            return 0.0
        power = (np.abs(self.output[self.peak]) ** 2).mean(1)
        heard = self.peak[self._explained(power, self.peak) > COST]
        if not len(heard):
            return 0.0
        before, at, after = np.sqrt((np.abs(self.output[heard[0] - 1 : heard[0] + 2]) ** 2).mean(1))
        beside = 0.5 * (before - after) / (before - 2 * at + after)  # summit of a parabola
        return float((heard[0] + beside) * self.step_m)

    def seen(self, length_m: Array, coherent: Array, level: Array, comes: bool = False) -> Array:
        """Nats by which lines of sight explain what is received at their lengths, (P, G).

        Parameters
        ----------
        length_m : (P,)
        coherent : (P,)
            Power of the one wave from their direction, matched by all antennas.
        level : (P, G)
            The same as expected of their powers.
        comes : bool
            Whether none was there the step before: a path that was is none, and costs nothing as another.
        """
        count, lengths = self.output.shape[1], self.step_m * np.arange(len(self.output))
        total = np.interp(length_m, lengths, (np.abs(self.output) ** 2).sum(1))
        rest = np.maximum(total - coherent, 0.0)
        noise = self.noise + LEAKS * np.interp(length_m, lengths, self.lobes)
        floor = np.maximum(rest / max(count - 1, 1), noise)[:, None] + level
        nats: Array = -np.log(floor) - coherent[:, None] / floor
        row = np.clip(np.rint(length_m / self.step_m).astype(int), 0, len(self.old) - 1)
        cost = np.where(comes & self.old[row], 0.0, COST)
        nats += (_density(rest, count - 1, noise, COST) - _density(total, count, noise, cost))[:, None]
        return nats

    def _explained(self, power: Array, rows: slice | NDArray[np.int64]) -> Array:
        """Nats that paths explain at some rows, where antennas receive these powers on average."""
        nats: Array = _gain(power / self.noise, self.output.shape[1])
        return np.where(power > LEAKS * self.lobes[rows], nats, 0.0)


def arrivals_of(samples: Complex, heard: NDArray[np.bool_], front: Front) -> list[list[Arrivals | None]]:
    """Those of steps and anchors (K, J, N, M), where heard (K, J)."""
    return [
        [Arrivals.of(one, front) if there else None for one, there in zip(step, audible, strict=True)]
        for step, audible in zip(samples, heard, strict=True)
    ]


def contradictions(arrivals: Sequence[Sequence[Arrivals | None]], way_m: Array, spread: Array) -> int:
    """At how many steps and anchors (K, J) something arrives before a line of sight.

    Parameters
    ----------
    way_m : (L, J, 2)
        Lines of sight, of these steps or more.
    spread : (2, 2)
        Covariance of the place, m^2.
    """
    nearest = np.sqrt((way_m**2).sum(-1)) - DEVIATIONS * np.sqrt(np.trace(spread))
    return sum(
        one is not None and one.before(length)
        for step, lengths in zip(arrivals, nearest.tolist(), strict=False)
        for one, length in zip(step, lengths, strict=True)
    )


def _gain(level: Array, count: int) -> Array:
    """Nats by which a power is likelier where it is as large as received: in that expected, per output."""
    level = np.maximum(level, 1.0)
    nats: Array = count * (level - 1 - np.log(level))
    return nats


def _density(power: Array, count: int, noise: Array, cost: Array | float) -> Array:
    """Log density of the power (P,) of so many outputs, in noise or, at a cost, of a path besides."""
    quiet = -power / noise - count * np.log(noise)
    nats: Array = np.logaddexp(quiet, quiet + _gain(power / (max(count, 1) * noise), count) - cost)
    return nats


def _side_lobes(pulse: Array) -> Array:
    """Most of a path's power that is heard so many rows away or farther, (T,); none within its main lobe."""
    power = np.square(pulse)
    half = len(power) // 2 + 1  # lengths fold
    falling = np.maximum.accumulate(power[:half][::-1])[::-1]
    falling[: int(np.argmax(falling < LOBE))] = 0.0
    lobes: Array = np.concatenate([falling, falling[: len(power) - half][::-1]])
    return lobes
