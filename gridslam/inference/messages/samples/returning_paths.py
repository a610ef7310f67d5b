"""What may make a peak of direct SLAM's snapshots: a new path, or one that was away; (M332), (M573)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.samples.distance_mode import Mode, PathPrior

Peak = tuple[float, float]
"""Distance (m) and intensity."""
BACK_M, BACK_DEVIATIONS, BACK_SHARE = 0.3, 3.0, 0.5
"""How near to a peak a path that was away may be what makes it; the line of sight also within so many
deviations, while these are less than that share of the resolution."""
LOUD, BEGIN_M = 50.0, 0.1
"""Log odds that it has to reach there: fainter ones were reflections of hidden anchors. How far from its
prediction a path that is back is looked for at the peak, too."""
SURELY = 1 - 1e-9
"""Greatest probability that a path is back."""


class Explanation(NamedTuple):
    """What may make a peak.

    Attributes
    ----------
    prior : PathPrior
        All paths then.
    log_odds : float
        Of it before the snapshot.
    peak : (float, float)
        m, and an intensity.
    back : int or None
        Row of the path that is back; None of a new one.
    """

    prior: PathPrior
    log_odds: float
    peak: Peak
    back: int | None = None

    def possible(self, mode: Mode, before: Mode, reach: Array) -> bool:
        """Whether it may be, by where its path has come to: a line of sight that is far off has to be loud.

        Nothing arrives before a line of sight, so that one which is loud may be any way nearer.

        Parameters
        ----------
        mode, before : Mode
            With it, and without.
        reach : (N,) m
            See `reach_of`.
        """
        gap = float(mode.distance[0] - self.prior.mean[0])
        if self.back != 0 or abs(gap) < BACK_M:
            return True
        return gap < reach[0] and mode.log_posterior + self.log_odds > before.log_posterior + LOUD


def reach_of(prior: PathPrior, resolution_m: float) -> Array:
    """How far (N,) m from its prediction each path may be back (M573)."""
    reach = np.full(len(prior.mean), BACK_M)
    deviation = float(np.sqrt(np.linalg.inv(prior.precision)[0, 0]))
    if deviation < BACK_SHARE * resolution_m:
        reach[0] = max(BACK_M, BACK_DEVIATIONS * deviation)
    return reach


def explanations(prior: PathPrior, peak: Peak, new: float | None, reach: Array) -> list[Explanation]:
    """A new path, and known ones that were away and are back (M332).

    Parameters
    ----------
    prior : PathPrior
        With new paths that were taken in, which come last.
    new : float or None
        Log odds of a new path before the snapshot; None where it can't be one.
    reach : (N,) m
        Of known paths, see `reach_of`.
    """
    found = [] if new is None else [Explanation(prior.with_path(*peak), new, peak)]
    if prior.away is None:
        return found
    gap, known = np.abs(prior.mean - peak[0]), len(reach)
    for row in np.flatnonzero((prior.away[:known] > 0) & (gap[:known] < reach)).tolist():
        chance = min(float(prior.weight[row] / prior.away[row]), SURELY)  # rounding may make it 1
        log_odds = float(np.log(chance / (1 - chance)))
        begins = [None, peak[0]] if gap[row] > BEGIN_M else [None]
        found += [Explanation(prior.back(row, begin), log_odds, peak, row) for begin in begins]
    return found
