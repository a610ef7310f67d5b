"""Paths that a snapshot of arrays holds, known ones and new ones; docs/model.md, (M151), (M154)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.samples.array_likelihood import (
    ArrayBand,
    Complex,
    climbed,
    composed,
    one_more,
)
from gridslam.inference.messages.samples.matched_power import MatchedPower, beside
from gridslam.inference.messages.samples.path_search import take_in
from gridslam.inference.messages.samples.state_mode import PathsPrior, StateMode, state_mode
from gridslam.world.geometry import wrap

MOST_NEW = 4
"""New paths of one anchor at one step."""
FALSE_PEAKS = 0.2
"""Mean number of peaks of noise, per anchor and step, that pass for new paths: each costs a mode."""
CLIMBS = 3
"""Steps from the grid's best point to the top of its peak."""
HALF = 0.5
"""Chance that a known path is there which was not believed in, where a peak lies beside it."""
LEAST_RAISE = 4.0
"""A known path whose chance a peak may raise is this many times below `HALF`."""


@dataclass(frozen=True, eq=False)
class NewPaths:
    """Paths that no known one explains.

    Attributes
    ----------
    path, std : (F, 3) m, rad, rad
        Where they are, and by how much they may be off.
    amplitude : (F,)
        Square roots of their SNR.
    """

    path: Array
    std: Array
    amplitude: Array

    def __len__(self) -> int:
        return len(self.amplitude)


@dataclass(frozen=True, eq=False)
class FoundPaths:
    """What a snapshot holds.

    Attributes
    ----------
    prior : PathsPrior
        Of the known paths, and the new ones that were taken in.
    mode : StateMode
        Of them.
    new : NewPaths
    rest : (A, B, M) complex128
        What they leave unexplained.
    power : MatchedPower
        How much of its power a path anywhere would take.
    """

    prior: PathsPrior
    mode: StateMode
    new: NewPaths
    rest: Complex
    power: MatchedPower


def peak_power(band: ArrayBand, rate: float = FALSE_PEAKS) -> float:
    """Squared amplitude that noise exceeds `rate` times per snapshot: the inverse of (M53)."""
    ranges = np.array([band.folding_m, 2 * np.pi, 2 * np.pi])
    cells = band.steepness * ranges
    many, level = cells[cells > 1], 10.0
    for _ in range(20):
        level = np.log(many).sum() + 0.5 * len(many) * np.log(max(level, np.pi) / np.pi) - np.log(rate)
    return float(level)


def find_paths(
    band: ArrayBand, samples: Complex, prior: PathsPrior, noise: float, power: Array
) -> FoundPaths:
    """The joint mode of the known paths, and of new ones that these leave unexplained; see `take_in`.

    A peak beside a known path that was hardly believed in is taken to be this.

    Parameters
    ----------
    power : (N,)
        Mean power of the known paths if they are there.
    """
    peaks = _Peaks(band, samples, noise, power)
    prior, mode = take_in(peaks, prior)
    return FoundPaths(prior, mode, _new(prior, mode), *peaks.left_by(mode))


@dataclass(frozen=True, eq=False)
class _Peak:
    """A path (3,) and its mean power, as it seems."""

    path: Array
    power: float


class _Peaks:
    """Peaks over length, departure and arrival; see `path_search.Candidates`."""

    tries = 2 * MOST_NEW

    def __init__(self, band: ArrayBand, samples: Complex, noise: float, power: Array) -> None:
        self.band, self.samples, self.noise, self.power = band, samples, noise, power
        self.level = peak_power(band)
        self.avoid = np.zeros((0, 3))
        self._latest: tuple[StateMode, Complex, MatchedPower] | None = None

    def left_by(self, mode: StateMode) -> tuple[Complex, MatchedPower]:
        """What a mode leaves unexplained, (A, B, M), and how much of its power a path anywhere would take."""
        if self._latest is None or self._latest[0] is not mode:
            rest = self.samples - composed(self.band, mode.path, mode.paths.amplitude)
            self._latest = mode, rest, MatchedPower.of(self.band, rest)
        return self._latest[1:]

    def solve(self, prior: PathsPrior) -> StateMode:
        return state_mode(self.band, self.samples, prior, self.noise)

    def strongest(self, prior: PathsPrior, mode: StateMode) -> _Peak | None:
        if len(prior.free) == MOST_NEW:
            return None
        rest, power = self.left_by(mode)
        path = climbed(self.band, rest, power.without(self.avoid).highest, CLIMBS)
        matched, own = one_more(self.band, self.samples, path[None], mode.path, prior.weight, self.noise)
        if abs(matched[0]) ** 2 / own[0] < self.level:
            return None
        return _Peak(path, float(abs(matched[0]) / own[0]) ** 2)

    def widened(self, prior: PathsPrior, mode: StateMode, peak: _Peak) -> tuple[PathsPrior, StateMode] | None:
        known, power = len(prior.table), self.power
        close = beside(self.band, mode.path, peak.path)
        faint = close[:known] & (LEAST_RAISE * prior.weight[:known] < HALF * power)
        if faint.any():
            row = int(np.where(faint, power, -1.0).argmax())
            return self._solved(prior.reweighted(row, HALF * power[row]))
        if close.any():
            self.avoid = np.concatenate([self.avoid, mode.path[close], peak.path[None]])
            return None
        return self._solved(prior.with_path(peak.path, peak.power))

    def _solved(self, prior: PathsPrior) -> tuple[PathsPrior, StateMode]:
        return prior, self.solve(prior)

    def takes(self, prior: PathsPrior, mode: StateMode, trial: StateMode, peak: _Peak) -> bool:
        if len(trial.path) == len(mode.path):  # a known path was raised
            return True
        gained, left = trial.paths.without(prior.weight)
        if gained[-1] / left[-1] >= self.level and not beside(self.band, mode.path, trial.path[-1]).any():
            return True
        self.avoid = np.concatenate([self.avoid, peak.path[None]])
        return False


def _new(prior: PathsPrior, mode: StateMode) -> NewPaths:
    """The free paths of a mode."""
    rows = slice(len(prior.table), None)
    matched, own = mode.paths.without(prior.weight)
    std = np.sqrt(np.einsum("npp->np", mode.free_spread))
    path = mode.path[rows] - mode.turned[rows]
    path[:, 1:] = wrap(path[:, 1:])
    return NewPaths(path, std, np.sqrt(matched[rows]) / own[rows])
