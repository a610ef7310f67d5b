"""Clocks that aren't set yet: a histogram over each anchor's offset; docs/model.md, (M101)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from gridslam.arrays import Array
from gridslam.world.clocks import ClockModel

CELL_M = 0.1
NARROW_M = 1.0
"""Half width of a prior up to which a clock counts as set; distance from the peak that counts as decided."""
SURE = 0.99
"""Share of the mass that lies there once a clock is set."""
SET_VARIANCE = 1.0
"""Variance (m^2) of an offset that a histogram has set: it has chosen the mode, no more."""
NEVER = -1e9
"""Log of no mass."""


@dataclass(frozen=True, eq=False)
class ClockSearch:
    """Which anchors' clocks are open, and what is known of their offsets.

    Attributes
    ----------
    unset : (J,) bool
    log : (J, C)
        Log mass of every cell, 0 at the peak.
    centre : (C,) m
    since : (J,) int
        Steps searched since the clock was opened.
    doubt : (J,) nats
        Of a set clock: how surely all paths of its anchor fell silent at once, while others were heard.
    """

    unset: NDArray[np.bool_]
    log: Array
    centre: Array
    since: NDArray[np.intp]
    doubt: Array

    @classmethod
    def start(cls, clocks: ClockModel) -> ClockSearch:
        """Uniform over each anchor's prior; narrow priors are no search."""
        half = clocks.half_width_m[: clocks.anchors]
        reach = int(np.ceil(half.max(initial=0.0) / CELL_M)) if (half > NARROW_M).any() else 0
        centre = np.asarray(CELL_M * np.arange(-reach, reach + 1), np.float64)
        log = np.where(np.abs(centre) <= half[:, None], 0.0, NEVER)
        none = np.zeros(clocks.anchors)
        return cls(half > NARROW_M, log, centre, none.astype(np.intp), none)

    @property
    def mass(self) -> Array:
        """Probability of every cell, (J, C)."""
        share = np.exp(self.log)
        return np.asarray(share / share.sum(1, keepdims=True))

    def walked(self, variance: float) -> ClockSearch:
        """A step later: every offset has walked by this variance, m^2."""
        share = 0.5 * variance / CELL_M**2
        if not self.unset.any() or not share:
            return self
        mass = self.mass
        if share < 0.5:  # less than a cell: a step of diffusion
            ends = np.pad(mass, ((0, 0), (1, 1)), mode="edge")
            mass = mass + share * (ends[:, 2:] - 2 * mass + ends[:, :-2])
        else:
            mass = gaussian_filter1d(mass, np.sqrt(variance) / CELL_M, axis=1, mode="nearest")
        with np.errstate(divide="ignore"):
            log = np.maximum(np.log(mass), NEVER)
        return replace(self, log=np.where(self.log > NEVER, log - log.max(1, keepdims=True), NEVER))

    def heard(self, evidence: Array) -> ClockSearch:
        """With the log evidence (J, C) of a step taken in."""
        log = self.log + np.where(self.unset[:, None], evidence, 0.0)
        log = np.maximum(log - log.max(1, keepdims=True), NEVER)
        return replace(self, log=log, since=np.where(self.unset, self.since + 1, 0))

    def decided(self) -> list[tuple[int, float]]:
        """Open clocks whose mass lies about one peak, and its mean there (m)."""
        found, mass = [], self.mass
        for anchor in np.flatnonzero(self.unset & (self.since > 0)):
            near = np.abs(self.centre - self.centre[mass[anchor].argmax()]) <= NARROW_M
            share = mass[anchor, near].sum()
            if share >= SURE:
                found.append((int(anchor), float(mass[anchor, near] @ self.centre[near] / share)))
        return found

    def moments(self, anchor: int) -> tuple[float, float]:
        """Mean (m) and variance (m^2) of an offset over all of its modes."""
        mass = self.mass[anchor]
        mean = float(mass @ self.centre)
        return mean, float(mass @ (self.centre - mean) ** 2)

    def closed(self, anchor: int) -> ClockSearch:
        """With a clock set."""
        unset, doubt = self.unset.copy(), self.doubt.copy()
        unset[anchor], doubt[anchor] = False, 0.0
        return replace(self, unset=unset, doubt=doubt)

    def opened(self, anchor: int, clocks: ClockModel) -> ClockSearch:
        """With a clock open again, about which nothing is known but its prior."""
        fresh = ClockSearch.start(clocks)
        unset, log, since, doubt = self.unset.copy(), self.log.copy(), self.since.copy(), self.doubt.copy()
        unset[anchor], log[anchor], since[anchor], doubt[anchor] = True, fresh.log[anchor], 0, 0.0
        return replace(self, unset=unset, log=log, since=since, doubt=doubt)
