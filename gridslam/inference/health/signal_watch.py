"""Whether samples fit the belief, as a filter on samples itself can judge. Nothing here needs the truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from gridslam.arrays import LATER, Array, replace
from gridslam.estimates import Health
from gridslam.inference.beliefs.belief import diagonal_together
from gridslam.inference.beliefs.calibration import KEEP
from gridslam.inference.health import reasons
from gridslam.inference.health.monitor import DISTRUSTED, MISFIT, SILENT, VAGUE_M, innovation_band

LEAST_EXPLAINED = 0.2
"""Share of the received power that paths of the joint belief explain as long as the agent is followed."""
EARLY = 0.5
"""Share of the latest steps at which something may arrive before a line of sight, as nothing can."""
FEW = 30.0
"""Effective number of particles of hybrid SLAM below which too few carry the weight."""


@dataclass(frozen=True)
class SignalWatch:
    """How well samples have fitted lately.

    Attributes
    ----------
    misfit, freedom : float
        Normalised shifts squared of distances from prediction to mode, and their degrees of freedom.
    explained, power : float
        Power, over the noise, of the lines of sight and settled images, and of all paths.
    silent : int
        Steps for which nothing has been heard.
    early : float
        Share of the latest steps at which something arrived before a line of sight.
    """

    misfit: float = 0.0
    freedom: float = 0.0
    explained: float = 0.0
    power: float = 0.0
    silent: int = 0
    early: float = field(default=0.0, metadata=LATER)

    def next_step(self, audible: int) -> Self:
        """A new step with snapshots of so many anchors."""
        return replace(
            self, misfit=KEEP * self.misfit, freedom=KEEP * self.freedom, explained=KEEP * self.explained,
            power=KEEP * self.power, silent=0 if audible else self.silent + 1,
        )  # fmt: skip

    def fitted(self, shift: Array, before: Array, after: Array, explained: float, power: float) -> Self:
        """Take in one anchor.

        Parameters
        ----------
        shift : (N,) m
            Mode less prediction.
        before, after : (N, N) m^2
            Covariance of the distances as predicted, and at the mode.
        explained, power : float
            Of the paths of the joint belief and of all, over the noise.
        """
        left, frame = diagonal_together(after, before)
        value, news = 1 - left, frame.T @ shift
        informed = value > 0.05  # a distance of which nothing was told can't misfit
        squared = float((news[informed] ** 2 / value[informed]).sum())
        return replace(
            self, misfit=self.misfit + squared, freedom=self.freedom + float(informed.sum()),
            explained=self.explained + explained, power=self.power + power,
        )  # fmt: skip

    def arrived(self, early: bool) -> Self:
        """Take in whether something arrived before a line of sight."""
        return replace(self, early=KEEP * self.early + (1 - KEEP) * early)

    def assess(self, spread_m: float, anchors: int, mirrored: bool = False) -> Health:
        """Say how things are.

        Parameters
        ----------
        spread_m : float
            Standard deviation of the position.
        anchors : int
        mirrored : bool
            Whether a mirrored place fits as well, (M444).
        """
        ratio = self.misfit / self.freedom if self.freedom > 0 else 1.0
        low, high = innovation_band(self.freedom)
        share = (self.explained + 1) / (self.power + 1)
        found = []
        if self.silent >= SILENT:
            found.append(reasons.silent(self.silent))
        if spread_m > VAGUE_M:
            found.append(reasons.vague(spread_m))
        if mirrored:
            found.append(reasons.MIRRORED)
        if self.early > EARLY:
            found.append(reasons.early(self.early))
        if share < LEAST_EXPLAINED:
            found.append(reasons.little_power(share))
        if ratio > max(high, MISFIT):
            found.append(reasons.misfit(ratio))
        return Health(
            not found, "; ".join(found), np.inf, ratio, (low, high), share, np.zeros(anchors), 1.0,
            np.zeros(anchors), self.silent,
        )  # fmt: skip


def assess_particles(
    spread_m: float, effective: float, silent: int, early: float, anchors: int, by_particles: bool,
    unsighted: bool = False, leap: tuple[float, int] = (0.0, DISTRUSTED), turnable: bool = False,
    astray: bool = False,
) -> Health:  # fmt: skip
    """Whether hybrid SLAM still knows its agent.

    Parameters
    ----------
    spread_m : float
        Standard deviation of the position.
    effective : float
        Effective number of particles, if the belief is `by_particles`.
    silent : int
        Steps for which nothing has been heard.
    early : float
        Share of the latest steps at which something arrived before a line of sight.
    unsighted : bool
        Whether hardly a line of sight was heard so far, and something tells where it is.
    leap : (float, int)
        By how far it was moved last as no motion does, and how many steps ago.
    turnable : bool
        Whether features are known, of antennas without directions, and one anchor at most was in sight.
    astray : bool
        Whether it hasn't been found since a silence.
    """
    found = []
    if silent >= SILENT:
        found.append(reasons.silent(silent))
    if astray or spread_m > VAGUE_M:
        found.append(reasons.vague(spread_m))
    if by_particles and effective < FEW:
        found.append(reasons.few_particles(effective))
    if early > EARLY:
        found.append(reasons.early(early))
    if unsighted:
        found.append(reasons.UNSIGHTED)
    elif turnable:
        found.append(reasons.TURNABLE)
    if leap[1] < DISTRUSTED:
        found.append(reasons.leapt(*leap))
    return Health(
        not found, "; ".join(found), effective, clutter=np.zeros(anchors), turned_rad=np.zeros(anchors),
        silent_steps=silent,
    )  # fmt: skip
