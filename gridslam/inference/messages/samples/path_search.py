"""Which paths a snapshot of samples holds: their joint mode, and new ones beside the known; (M79), (M151).

What is searched is handed over as an object: distances of single antennas (`distance_mode`, `image_births`),
or agent and surfaces by arrays (`state_mode`, `array_search`).
"""

from __future__ import annotations

from typing import Protocol, TypeVar

import numpy as np

from gridslam.arrays import Array

ROUNDS, HALVINGS = 8, 6
"""Gauss-Newton steps at most, and halvings of each."""
STILL = 0.02
"""Share of a deviation below which a step ends the search."""


class Place(Protocol):
    """Where a search has got to."""

    @property
    def value(self) -> float:
        """Log posterior."""


Where = TypeVar("Where", bound=Place)
Prior = TypeVar("Prior")
Mode = TypeVar("Mode")
Peak = TypeVar("Peak")


class Posterior(Protocol[Where]):
    """Log posterior of some numbers, given a snapshot."""

    def at(self, numbers: Array) -> Where:
        """Evaluate it."""

    def slopes(self, numbers: Array, place: Where) -> tuple[Array, Array]:
        """Gradient, and curvature (of the other sign) by the information of the snapshot."""

    def shortened(self, place: Where, step: Array) -> Array:
        """A step that is no longer than any path may go: farther off, it jumps to the next sidelobe."""


def climb(posterior: Posterior[Where], numbers: Array, place: Where) -> tuple[Array, Where]:
    """Find the mode by Gauss-Newton steps with halving."""
    for _ in range(ROUNDS):
        gradient, curvature = posterior.slopes(numbers, place)
        step: Array = np.asarray(np.linalg.solve(curvature, gradient), np.float64)
        if float(gradient @ step) < STILL**2:
            break
        step = posterior.shortened(place, step)
        for _ in range(HALVINGS):
            trial = posterior.at(numbers + step)
            if trial.value > place.value:
                break
            step = 0.5 * step
        else:
            break
        numbers, place = numbers + step, trial
    return numbers, place


class Candidates(Protocol[Prior, Mode, Peak]):
    """What of a snapshot may be a new path.

    Attributes
    ----------
    tries : int
        Peaks that are looked at, at most.
    """

    tries: int

    def solve(self, prior: Prior) -> Mode:
        """The joint mode of all paths of a prior, from their prediction."""

    def strongest(self, prior: Prior, mode: Mode) -> Peak | None:
        """The highest peak that nothing explains; None where it isn't worth a look."""

    def widened(self, prior: Prior, mode: Mode, peak: Peak) -> tuple[Prior, Mode] | None:
        """The prior with what may make a peak, and its mode; None where a known path makes it, and the peak
        is put aside."""

    def takes(self, prior: Prior, mode: Mode, trial: Mode, peak: Peak) -> bool:
        """Whether a wider prior and its mode, `trial`, are to take the place of a prior and its mode.

        Else the peak is put aside.
        """


def take_in(candidates: Candidates[Prior, Mode, Peak], prior: Prior) -> tuple[Prior, Mode]:
    """The joint mode, with paths that the known ones leave unexplained taken in, strongest first.

    Each is solved for together with all known paths from their prediction: judged after an update, the agent
    would have swallowed the misfit.
    """
    mode = candidates.solve(prior)
    for _ in range(candidates.tries):
        peak = candidates.strongest(prior, mode)
        if peak is None:
            break
        wider = candidates.widened(prior, mode, peak)
        if wider is not None and candidates.takes(wider[0], mode, wider[1], peak):
            prior, mode = wider
    return prior, mode
