"""Distances at which a snapshot may hold one more path, and its peaks there (M81)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, squared
from gridslam.inference.messages.samples.distance_mode import PathPrior
from gridslam.inference.messages.samples.returning_paths import Peak
from gridslam.inference.messages.samples.signal_likelihood import Band, Sweep, log_ratio

INTENSITIES_DB = np.arange(3.0, 34.0, 5.0)
"""Intensities of a new path over the noise, equally likely."""
POINTS = 2048
"""Of the folding range, at which one more path is tried."""
NEAR_M, BESIDE_M = 0.05, 0.2
"""By how much an image must be farther than its anchor; how near to a known path a weak one is none."""
DEVIATIONS = 2.0
"""Deviations of the line of sight that come on top."""


@dataclass(frozen=True, eq=False)
class Scores:
    """Log ratios of one more path, by intensity and distance, where it may be worth a look.

    Attributes
    ----------
    rows : (G,) int
        Of the grid.
    logs : (I, G)
    best, worth : (G,)
        The highest, and the log of the mean ratio.
    """

    rows: NDArray[np.intp]
    logs: Array
    best: Array
    worth: Array


class OpenDistances:
    """Where one more path is looked for in a snapshot: fewer as peaks are put aside.

    Parameters
    ----------
    prior : PathPrior
        Of the known paths.
    noise : float
    least : float
        Log ratio below which a peak isn't worth a look.
    reach_m : float
        How far from its prediction the line of sight may be back.

    Attributes
    ----------
    nearest, farthest : float, m
        Of a new path.
    """

    def __init__(self, band: Band, prior: PathPrior, noise: float, least: float, reach_m: float) -> None:
        sight = float(prior.mean[0])
        deviation = DEVIATIONS * float(np.sqrt(1 / prior.precision[0, 0]))
        self.nearest = sight + NEAR_M + deviation
        gone = prior.away is not None and prior.away[0] > 0
        lowest = min(self.nearest, sight - reach_m) if gone else self.nearest
        # (M540): a folding range on from where the line of sight may be, it is heard itself
        self.farthest = sight - deviation + band.folding_m - band.resolution_m
        self.points = max(POINTS, 2 * len(band))
        grid = band.folding_m / self.points * np.arange(self.points)
        self._grid = grid + band.folding_m * (grid < lowest)
        back = gone & (np.abs(self._grid - sight) < reach_m)
        self._open = (self._grid < self.farthest) & ((self._grid >= self.nearest) | back)
        self._intensities = noise * 10 ** (INTENSITIES_DB / 10)
        self._least = least

    def put_aside(self, distance_m: float) -> None:
        """Look for nothing more beside this distance."""
        self._open &= np.abs(self._grid - distance_m) > BESIDE_M

    def scores(self, table: Sweep) -> Scores:
        """What one more path is worth at all open distances where it may be worth a look."""
        least, matched = self._least, squared(table.matched)
        # the best of all intensities is worth q - 1 - log q, q = matched / self_power > 1
        worthy = self._open & (matched >= (1 + least) * table.self_power) if least > 0 else self._open
        rows = np.flatnonzero(worthy)
        logs = log_ratio(matched[rows], table.self_power[rows], self._intensities[:, None])
        best = logs.max(0)
        return Scores(rows, logs, best, best + np.log(np.exp(logs - best).mean(0)))

    def peak(self, scores: Scores) -> Peak | None:
        """The likeliest distance of one more path, and its intensity; None where it isn't worth a look."""
        worth = np.where(self._open[scores.rows], scores.worth, -np.inf)
        if not len(worth):
            return None
        peak = int(worth.argmax())
        if worth[peak] < self._least:
            return None
        share = np.exp(scores.logs[:, peak] - scores.best[peak])
        return float(self._grid[scores.rows[peak]]), float(share @ self._intensities / share.sum())
