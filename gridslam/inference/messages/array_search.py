"""Paths that a snapshot of arrays holds, known ones and new ones; docs/model.md, (M151), (M154)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.array_likelihood import ArrayBand, Complex, one_more, products
from gridslam.inference.messages.path_search import take_in
from gridslam.inference.messages.state_mode import PathsPrior, StateMode, state_mode
from gridslam.world.geometry import wrap

Mask = NDArray[np.bool_]
MOST_NEW = 4
"""New paths of one anchor at one step."""
FALSE_PEAKS = 1.0
"""Mean number of peaks of noise, per anchor and step, that pass for new paths."""
CLIMBS = 3
"""Steps from the grid's best point to the top of its peak."""
POINTS = 2
"""At which delays are tried, in ratio to the frequencies; beams in ratio to their width."""
BESIDE = 1.2
"""Turn of phase (rms, rad) by length and by either angle, within which a peak is a known path's."""
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
class Found:
    """What a snapshot holds.

    Attributes
    ----------
    prior : PathsPrior
        Of the known paths, and the new ones that were taken in.
    mode : StateMode
        Of them.
    new : NewPaths
    """

    prior: PathsPrior
    mode: StateMode
    new: NewPaths


def level_of(band: ArrayBand, rate: float = FALSE_PEAKS) -> float:
    """Squared amplitude that noise exceeds `rate` times per snapshot: the inverse of (M53)."""
    ranges = np.array([band.folding_m, 2 * np.pi, 2 * np.pi])
    cells = band.steepness * ranges
    many, level = cells[cells > 1], 10.0
    for _ in range(20):
        level = np.log(many).sum() + 0.5 * len(many) * np.log(max(level, np.pi) / np.pi) - np.log(rate)
    return float(level)


def find_paths(band: ArrayBand, samples: Complex, prior: PathsPrior, noise: float, power: Array) -> Found:
    """The joint mode of the known paths, and of new ones that these leave unexplained; see `take_in`.

    A peak beside a known path that was hardly believed in is taken to be this.

    Parameters
    ----------
    power : (N,)
        Mean power of the known paths if they are there.
    """
    prior, mode = take_in(_Peaks(band, samples, noise, power), prior)
    return Found(prior, mode, _new(prior, mode, noise))


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
        self.level = level_of(band)
        self.avoid = np.zeros((0, 3))

    def solve(self, prior: PathsPrior) -> StateMode:
        return state_mode(self.band, self.samples, prior, self.noise)

    def strongest(self, prior: PathsPrior, mode: StateMode) -> _Peak | None:
        if len(prior.free) == MOST_NEW:
            return None
        rest = self.samples - _composed(self.band, mode)
        path = _climbed(self.band, rest, _strongest(self.band, rest, self.avoid))
        matched, own = one_more(self.band, self.samples, path[None], mode.path, prior.weight, self.noise)
        if abs(matched[0]) ** 2 / own[0] < self.level:
            return None
        return _Peak(path, float(abs(matched[0]) / own[0]) ** 2)

    def widened(self, prior: PathsPrior, mode: StateMode, peak: _Peak) -> PathsPrior | None:
        known, power = len(prior.table), self.power
        beside = _beside(self.band, mode.path, peak.path)
        faint = beside[:known] & (LEAST_RAISE * prior.weight[:known] < HALF * power)
        if faint.any():
            row = int(np.where(faint, power, -1.0).argmax())
            return prior.reweighted(row, HALF * power[row])
        if beside.any():
            self.avoid = np.concatenate([self.avoid, mode.path[beside], peak.path[None]])
            return None
        return prior.with_path(peak.path, peak.power)

    def takes(self, prior: PathsPrior, mode: StateMode, trial: StateMode, peak: _Peak) -> bool:
        if len(trial.path) == len(mode.path):  # a known path was raised
            return True
        gained, left = trial.paths.without(prior.weight)
        if gained[-1] / left[-1] >= self.level and not _beside(self.band, mode.path, trial.path[-1]).any():
            return True
        self.avoid = np.concatenate([self.avoid, peak.path[None]])
        return False


def _new(prior: PathsPrior, mode: StateMode, noise: float) -> NewPaths:
    """The free paths of a mode."""
    rows = slice(len(prior.table), None)
    matched, own = mode.paths.without(prior.weight)
    std = np.sqrt(np.einsum("npp->np", mode.spread[rows]))
    path = mode.path[rows].copy()
    path[:, 1:] = wrap(path[:, 1:])
    return NewPaths(path, std, np.sqrt(matched[rows]) / own[rows])


def _beside(band: ArrayBand, path: Array, peak: Array) -> Mask:
    """Which paths (N, 3) lie within the resolution of another one (3,), (N,) bool."""
    gap = path - peak
    gap[:, 0] -= band.folding_m * np.round(gap[:, 0] / band.folding_m)
    gap[:, 1:] = wrap(gap[:, 1:])
    return np.asarray((np.abs(gap) * band.steepness < BESIDE).all(1))


def _composed(band: ArrayBand, mode: StateMode) -> Complex:
    """What the paths of a mode explain, (A, B, M)."""
    delay, leaving, arriving = (factor[0] for factor in band.factors(mode.path))
    scaled = (mode.paths.amplitude[:, None] * leaving)[:, :, None] * arriving[:, None]
    return np.asarray(np.tensordot(scaled, delay, (0, 0)))


def _strongest(band: ArrayBand, rest: Complex, avoid: Array) -> Array:
    """The path (3,) that would take most energy out of what is left, but for those beside others (K, 3)."""
    size = POINTS * len(band.wavenumber)
    leaving, arriving = (_beams(element) for element in (band.anchor, band.agent))
    path = np.zeros((max(len(leaving), len(arriving)), 3))
    path[: len(leaving), 1], path[: len(arriving), 2] = leaving, arriving
    _, out, back = (np.conj(factor[0]) for factor in band.factors(path))
    part = np.tensordot(out[: len(leaving)], rest * np.conj(band.pulse), (1, 0))
    part = np.einsum("rb,tbm->trm", back[: len(arriving)], part, optimize=True)
    power = np.abs(np.fft.ifft(part, size, axis=-1)) ** 2
    lengths = band.folding_m * np.arange(size) / size
    for other in avoid:
        near = [np.abs(lengths - other[0] % band.folding_m) * band.steepness[0] < BESIDE]
        near += [
            np.abs(wrap(beams - angle)) * steep < BESIDE
            for beams, angle, steep in zip((leaving, arriving), other[1:], band.steepness[1:], strict=True)
        ]
        power[np.ix_(near[1], near[2], near[0])] = 0.0
    t, r, m = np.unravel_index(int(power.argmax()), power.shape)
    return np.array([lengths[m], leaving[t], arriving[r]])


def _climbed(band: ArrayBand, rest: Complex, peak: Array) -> Array:
    """The top of a peak (3,) next to a point of the search's grid."""
    for _ in range(CLIMBS):
        _, matched = products(band, rest, peak[None])
        step = np.where(band.steepness > 0, (matched[1:, 0] / matched[0, 0]).real, 0.0)
        peak = peak + step / np.maximum(band.steepness, 1e-9) ** 2
    return peak


def _beams(element: Array) -> Array:
    """Directions that are tried, (n,) rad: 0 alone for one element."""
    if len(element) == 1:
        return np.zeros(1)
    reach = float(np.linalg.norm(element - element.mean(0), axis=1).max())
    count = int(np.clip(np.ceil(2 * POINTS * reach), 12, 720))
    return np.linspace(-np.pi, np.pi, count, endpoint=False)
