"""New images of direct SLAM: paths that a snapshot holds and the model doesn't (M81), (M82)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.samples.distance_mode import Mode, PathPrior, joint_mode
from gridslam.inference.messages.samples.open_distances import BESIDE_M, OpenDistances, Scores
from gridslam.inference.messages.samples.path_search import take_in
from gridslam.inference.messages.samples.returning_paths import Explanation, Peak, explanations, reach_of
from gridslam.inference.messages.samples.signal_likelihood import Band, Inverse, Sweep

Complex = NDArray[np.complex128]
LEVELS = (1.0, 3.0, 10.0, 30.0)
"""By how much the line of sight may be louder at the first steps than is believed, equally likely."""
MOST_NEW, MOST_TENTATIVE = 10, 8
"""New images per anchor and step; tentative ones per anchor."""
BIRTHS, FIRST_BIRTHS, FIRST_STEPS = (1e-4, 5e-4), (0.05, 0.5), 8.0
"""Probability of a new path per delay cell, where walls reflect once and where they do twice: of a running
filter; at the first step, and for how many steps. At the start several cells hold paths, over two bounces
half of them; with the rate of a running filter the line of sight is dragged towards reflections that aren't
in the model yet."""
LEAST_EXISTENCE = 0.01
"""Existence below which a tentative image isn't begun."""
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
    """The joint mode (M79) of the known paths, and of new ones that these leave unexplained; see `take_in`.

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
    inverse, table = births.at(prior, mode).left
    births.done()
    return FoundDistances(prior, mode, births.taken + births.weak, inverse, table, known)


def with_sight(band: Band, samples: Complex, prior: PathPrior, noise: float) -> PathPrior:
    """The prior with the level of the anchor's own path at which the known paths are likeliest (M333).

    At the first steps little is known of that level, and if the path has faded then, the next reflection
    takes its place for good.
    """
    louder = [prior.weighed(0, level * float(prior.weight[0])) for level in LEVELS]
    trials = [joint_mode(band, samples, each, noise).log_posterior for each in louder]
    return louder[int(np.argmax(trials))]


class _Trial(NamedTuple):
    """What may make a peak, and the joint mode of all paths then."""

    explanation: Explanation
    mode: Mode


class _Stage:
    """A prior and its mode, and what they leave unexplained: worked out where it is asked for, once."""

    def __init__(self, births: _Births, prior: PathPrior, mode: Mode) -> None:
        self._births, self.prior, self.mode = births, prior, mode
        self._tried = dict[Peak, list[_Trial]]()

    @cached_property
    def left(self) -> tuple[Inverse, Sweep]:
        """All paths at their mode, broadened by their variance, and what one more would be worth on top.

        An error of 1 cm would else leave -24 dB of a strong path to be explained.
        """
        return self._one_more(self.mode.distance, self.mode.variance)

    @cached_property
    def beside_mode(self) -> Scores:
        """Of one more path with the others at their mode."""
        return self._births.open.scores(self.left[1])

    @cached_property
    def beside_prediction(self) -> Scores:
        """Of one more path with the others as broad as they were predicted."""
        spread = np.minimum(np.linalg.inv(self.prior.precision).diagonal(), WIDEST_M**2)
        return self._births.open.scores(self._one_more(self.prior.mean, spread)[1])

    def trials(self, peak: Peak) -> list[_Trial]:
        """What may make a peak; the less likely one of two peaks is looked at again."""
        if peak not in self._tried:
            self._tried[peak] = self._births.trials(self.prior, peak)
        return self._tried[peak]

    def _one_more(self, distance: Array, variance: Array) -> tuple[Inverse, Sweep]:
        own = self._births
        inverse = Inverse.of(own.band, own.samples, self.prior.weight, distance, variance, own.noise)
        return inverse, inverse.sweep(own.open.points)


class _Births:
    """Peaks over distance, with what may make each; see `path_search.Candidates`.

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
        self.reach = reach_of(prior, band.resolution_m)
        least = float(np.log(LEAST_EXISTENCE) - np.log(rate) - ACCEPTED - SOLVED_AGAIN)
        self.open = OpenDistances(band, prior, noise, least, float(self.reach[0]))
        self._stage: _Stage | None = None

    def done(self) -> None:
        """Let go of the latest stage, which holds this: else both last until garbage is collected."""
        self._stage = None

    def at(self, prior: PathPrior, mode: Mode) -> _Stage:
        """What a prior and its mode leave unexplained."""
        stage = self._stage
        if stage is None or stage.prior is not prior or stage.mode is not mode:
            stage = self._stage = _Stage(self, prior, mode)
        return stage

    def solve(self, prior: PathPrior) -> Mode:
        return joint_mode(self.band, self.samples, prior, self.noise)

    def strongest(self, prior: PathPrior, mode: Mode) -> _Trial | None:
        """Of two peaks the one with which all is likelier: beside the mode, or beside the prediction.

        Where two paths lie within the resolution, the one that is known may stand in for both at the mode,
        and nothing is left over.
        """
        stage = self.at(prior, mode)
        while True:
            found = map(self.open.peak, (stage.beside_mode, stage.beside_prediction))
            peaks = [peak for peak in found if peak is not None]
            tried = [one for peak in peaks for one in stage.trials(peak)]
            able = [one for one in tried if one.explanation.possible(one.mode, mode, self.reach)]
            if able or not peaks:
                worth = [one.mode.log_posterior + one.explanation.log_odds for one in able]
                return able[int(np.argmax(worth))] if able else None
            for distance, _ in peaks:  # too near for a new path, and too faint for the line of sight
                self.open.put_aside(distance)

    def trials(self, prior: PathPrior, peak: Peak) -> list[_Trial]:
        """What may make a peak, each with its mode."""
        new = float(np.log(self.rate) + ACCEPTED) if peak[0] >= self.open.nearest else None
        may = explanations(prior, peak, new, self.reach)
        return [_Trial(one, self.solve(one.prior)) for one in may]

    def widened(self, prior: PathPrior, mode: Mode, peak: _Trial) -> tuple[PathPrior, Mode]:
        return peak.explanation.prior, peak.mode

    def takes(self, prior: PathPrior, mode: Mode, trial: Mode, peak: _Trial) -> bool:
        (distance, intensity), log_odds = peak.explanation.peak, peak.explanation.log_odds
        log_odds += trial.log_posterior - mode.log_posterior
        if peak.explanation.back is not None:
            if log_odds <= 0:
                self.open.put_aside(distance)
            return log_odds > 0
        existence = float(1 / (1 + np.exp(-np.clip(log_odds, -50, 50))))
        new = NewDistance(existence, float(trial.distance[-1]), float(trial.variance[-1]), intensity)
        possible = existence >= LEAST_EXISTENCE and self.open.nearest <= new.distance < self.open.farthest
        if possible and existence > 0.5:
            self.taken.append(new)
            return True
        self.open.put_aside(distance)
        known = np.append(mode.distance, [path.distance for path in self.weak])
        if possible and (np.abs(known - new.distance) > BESIDE_M).all():
            self.weak.append(new)
        return False
