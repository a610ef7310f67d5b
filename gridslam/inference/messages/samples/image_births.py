"""New images of direct SLAM: paths that a snapshot holds and the model doesn't (M81), (M82)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, squared
from gridslam.inference.messages.samples.distance_mode import Mode, PathPrior, joint_mode
from gridslam.inference.messages.samples.path_search import take_in
from gridslam.inference.messages.samples.returning_paths import Explanation, explanations, reach_of
from gridslam.inference.messages.samples.signal_likelihood import Band, Inverse, Sweep, log_ratio

Complex = NDArray[np.complex128]
LEVELS = (1.0, 3.0, 10.0, 30.0)
"""By how much the line of sight may be louder at the first steps than is believed, equally likely."""
INTENSITIES_DB = np.arange(3.0, 34.0, 5.0)
"""Intensities of a new path over the noise, equally likely."""
MOST_NEW, MOST_TENTATIVE = 10, 8
"""New images per anchor and step; tentative ones per anchor."""
BIRTHS, FIRST_BIRTHS, FIRST_STEPS = (1e-4, 5e-4), (0.05, 0.5), 8.0
"""Probability of a new path per delay cell, where walls reflect once and where they do twice: of a running
filter; at the first step, and for how many steps. At the start several cells hold paths, over two bounces
half of them; with the rate of a running filter the line of sight is dragged towards reflections that aren't
in the model yet."""
POINTS = 2048
"""Of the folding range, at which one more path is tried."""
LEAST_EXISTENCE = 0.01
"""Existence below which a tentative image isn't begun."""
NEAR_M, BESIDE_M = 0.05, 0.2
"""By how much an image must be farther than its anchor; how near to a known path a weak one is none."""
DEVIATIONS = 2.0
"""Deviations of the line of sight that come on top."""
ACCEPTED = np.log(8.0) - 2.0
"""What a gain in log posterior is worth more than a ratio of likelihoods: searched at 8 points of a cell,
less what fitting a distance and an intensity gains in noise."""
SOLVED_AGAIN = 1.0
"""What solving everything again may gain on top of what the others' present fit shows; 0.5 is usual."""
WIDEST_M = 0.3
"""Deviation of a predicted distance beyond which it isn't broadened any more."""
OWN_PLACE_M = 0.6
"""An image so near to its anchor is the anchor itself."""


@dataclass(frozen=True, eq=False)
class NewDistance:
    """A path of which its distance is known, and which may come from a new image.

    Attributes
    ----------
    existence : float
    distance, variance : float; m, m^2
    intensity : float
    """

    existence: float
    distance: float
    variance: float
    intensity: float


@dataclass(frozen=True, eq=False)
class FoundDistances:
    """What a snapshot holds.

    Attributes
    ----------
    prior : PathPrior
        Of the known paths, and of new ones that were taken in.
    mode : Mode
        Of them.
    new : list of NewDistance
        All new ones. Those taken in come first, in the order of the prior's last rows, all above 0.5.
    inverse : Inverse
        C^-1 at the mode.
    table : Sweep
        What one more path would be worth.
    known : int
        How many of the prior's rows are known paths.
    """

    prior: PathPrior
    mode: Mode
    new: list[NewDistance]
    inverse: Inverse
    table: Sweep
    known: int

    @cached_property
    def apart(self) -> tuple[Array, Array]:
        """|y|^2 and g (N,) of every path at the mode, on top of all others."""
        return self.inverse.without(self.mode.distance)


def birth_rate(step: int, bounces: int) -> float:
    """Probability of a new path per delay cell (M81).

    Parameters
    ----------
    step : int
        Steps taken before this one.
    bounces : int
        Over how many walls the radio's paths go at most.
    """
    which = 0 if bounces < 2 else 1
    return max(BIRTHS[which], FIRST_BIRTHS[which] * float(np.exp(-step / FIRST_STEPS)))


def find_births(
    band: Band, samples: Complex, prior: PathPrior, noise: float, rate: float, first: bool = False
) -> FoundDistances:
    """The joint mode of the known paths, and of new ones that these leave unexplained; see `take_in`.

    Parameters
    ----------
    rate : float
        Probability of a new path per delay cell; see `birth_rate`.
    first : bool
        At the first steps the line of sight may be louder than it was when its level was guessed; see
        `with_sight`.
    """
    prior = with_sight(band, samples, prior, noise) if first else prior
    births, known = _Births(band, samples, prior, noise, rate), len(prior.mean)
    prior, mode = take_in(births, prior)
    inverse, table = births.explained(prior, mode)
    return FoundDistances(prior, mode, births.taken + births.weak, inverse, table, known)


def with_sight(band: Band, samples: Complex, prior: PathPrior, noise: float) -> PathPrior:
    """The prior with the level of the anchor's own path at which the known paths are likeliest (M333).

    At the first steps little is known of that level, and if the path has faded then, the next reflection
    takes its place for good.
    """
    louder = [prior.weighed(0, level * float(prior.weight[0])) for level in LEVELS]
    trials = [joint_mode(band, samples, each, noise).log_posterior for each in louder]
    return louder[int(np.argmax(trials))]


@dataclass(frozen=True, eq=False)
class _Scores:
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


class _Births:
    """Peaks over distance; see `path_search.Candidates`. A peak is a distance (m) and an intensity.

    Parameters
    ----------
    prior : PathPrior
        Of the known paths.
    rate : float
        Probability of a new path per delay cell.

    Attributes
    ----------
    taken, weak : list of NewDistance
        Those taken in; those that aren't sure enough.
    """

    tries = MOST_NEW

    def __init__(self, band: Band, samples: Complex, prior: PathPrior, noise: float, rate: float) -> None:
        self.band, self.samples, self.noise, self.rate = band, samples, noise, rate
        self.taken, self.weak = list[NewDistance](), list[NewDistance]()
        deviation = DEVIATIONS * float(np.sqrt(1 / prior.precision[0, 0]))
        self.nearest = float(prior.mean[0]) + NEAR_M + deviation
        self.reach = reach_of(prior, band.resolution_m)
        gone = prior.away is not None and prior.away[0] > 0
        lowest = min(self.nearest, float(prior.mean[0]) - self.reach[0]) if gone else self.nearest
        # (M540): a folding range on from where the line of sight may be, it is heard itself
        self.farthest = float(prior.mean[0]) - deviation + band.folding_m - band.resolution_m
        self.points = max(POINTS, 2 * len(band))
        grid = band.folding_m / self.points * np.arange(self.points)
        self.grid = grid + band.folding_m * (grid < lowest)
        sight = gone & (np.abs(self.grid - prior.mean[0]) < self.reach[0])
        self.open = (self.grid < self.farthest) & ((self.grid >= self.nearest) | sight)
        self.intensities = noise * 10 ** (INTENSITIES_DB / 10)
        self.least = float(np.log(LEAST_EXISTENCE) - np.log(rate) - ACCEPTED - SOLVED_AGAIN)
        self._latest: tuple[Mode, Inverse, Sweep] | None = None
        self._solved: list[tuple[PathPrior, Mode]] = []
        self._tried: dict[tuple[float, float], list[tuple[Explanation, Mode]]] = {}
        self._tried_of: PathPrior | None = None
        self._scored: list[tuple[Sweep, _Scores]] = []
        self._judged: Explanation
        self._predicted: tuple[PathPrior, Sweep] | None = None

    def solve(self, prior: PathPrior) -> Mode:
        for known, mode in self._solved:
            if known is prior:
                return mode
        return joint_mode(self.band, self.samples, prior, self.noise)

    def explained(self, prior: PathPrior, mode: Mode) -> tuple[Inverse, Sweep]:
        """All paths at their mode, broadened by their variance, and what one more would be worth on top.

        An error of 1 cm would else leave -24 dB of a strong path to be explained.
        """
        if self._latest is None or self._latest[0] is not mode:
            inverse = Inverse.of(
                self.band, self.samples, prior.weight, mode.distance, mode.variance, self.noise
            )
            self._latest = mode, inverse, inverse.sweep(self.points)
        return self._latest[1:]

    def strongest(self, prior: PathPrior, mode: Mode) -> tuple[float, float] | None:
        """Of two peaks the one with which all is likelier: beside the mode, or beside the prediction.

        Where two paths lie within the resolution, the one that is known may stand in for both at the mode,
        and nothing is left over.
        """
        _, table = self.explained(prior, mode)
        while peaks := [peak for peak in map(self._peak, (table, self._before(prior))) if peak is not None]:
            tried = [one for peak in peaks for one in self._tries(prior, peak)]
            worth = [trial.log_posterior + one.log_odds for one, trial in tried]
            able = [one.possible(trial, mode, self.reach) for one, trial in tried]
            if any(able):
                self._judged, trial = tried[int(np.argmax(np.where(able, worth, -np.inf)))]
                self._solved = [(self._judged.prior, trial)]
                return self._judged.peak
            for distance, _ in peaks:  # too near for a new path, and too faint for the line of sight
                self._put_aside(distance)
        return None

    def _put_aside(self, distance: float) -> None:
        self.open &= np.abs(self.grid - distance) > BESIDE_M

    def _tries(self, prior: PathPrior, peak: tuple[float, float]) -> list[tuple[Explanation, Mode]]:
        """What may make a peak, each with its mode; the less likely one of two peaks is looked at again."""
        if self._tried_of is not prior:
            self._tried_of, self._tried = prior, {}
        if peak not in self._tried:
            new = float(np.log(self.rate) + ACCEPTED) if peak[0] >= self.nearest else None
            may = explanations(prior, peak, new, self.reach)
            self._tried[peak] = [(one, self.solve(one.prior)) for one in may]
        return self._tried[peak]

    def _before(self, prior: PathPrior) -> Sweep:
        """What one more path would be worth, with the others as broad as they were predicted."""
        if self._predicted is None or self._predicted[0] is not prior:
            spread = np.minimum(np.linalg.inv(prior.precision).diagonal(), WIDEST_M**2)
            inverse = Inverse.of(self.band, self.samples, prior.weight, prior.mean, spread, self.noise)
            self._predicted = prior, inverse.sweep(self.points)
        return self._predicted[1]

    def _peak(self, table: Sweep) -> tuple[float, float] | None:
        """The likeliest distance of one more path, and its intensity; None where it isn't worth a look."""
        scores = next((known for of, known in self._scored if of is table), None)
        if scores is None:
            scores = self._score(table)
            self._scored = [*self._scored[-1:], (table, scores)]
        worth = np.where(self.open[scores.rows], scores.worth, -np.inf)
        if not len(worth):
            return None
        peak = int(worth.argmax())
        if worth[peak] < self.least:
            return None
        share = np.exp(scores.logs[:, peak] - scores.best[peak])
        return float(self.grid[scores.rows[peak]]), float(share @ self.intensities / share.sum())

    def _score(self, table: Sweep) -> _Scores:
        """What one more path is worth at all distances where it may be worth a look."""
        least, matched = self.least, squared(table.matched)
        # the best of all intensities is worth q - 1 - log q, q = matched / self_power > 1
        worthy = self.open & (matched >= (1 + least) * table.self_power) if least > 0 else self.open
        rows = np.flatnonzero(worthy)
        logs = log_ratio(matched[rows], table.self_power[rows], self.intensities[:, None])
        best = logs.max(0)
        return _Scores(rows, logs, best, best + np.log(np.exp(logs - best).mean(0)))

    def widened(self, prior: PathPrior, mode: Mode, peak: tuple[float, float]) -> PathPrior:
        return self._solved[0][0]

    def takes(self, prior: PathPrior, mode: Mode, trial: Mode, peak: tuple[float, float]) -> bool:
        log_odds = trial.log_posterior - mode.log_posterior + self._judged.log_odds
        if self._judged.back is not None:
            if log_odds <= 0:
                self._put_aside(peak[0])
            return log_odds > 0
        existence = float(1 / (1 + np.exp(-np.clip(log_odds, -50, 50))))
        new = NewDistance(existence, float(trial.distance[-1]), float(trial.variance[-1]), peak[1])
        possible = existence >= LEAST_EXISTENCE and self.nearest <= new.distance < self.farthest
        if possible and existence > 0.5:
            self.taken.append(new)
            return True
        self._put_aside(peak[0])
        known = np.append(mode.distance, [path.distance for path in self.weak])
        if possible and (np.abs(known - new.distance) > BESIDE_M).all():
            self.weak.append(new)
        return False
