"""Joint mode of the distances of all paths of one anchor, and what a snapshot tells of them (M79)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.messages.samples.path_search import HALVINGS, ROUNDS, STILL
from gridslam.inference.messages.samples.signal_likelihood import Band, Superposition, pairs, superpose

Complex = NDArray[np.complex128]
FARTHEST = 0.2
"""Longest step, in resolutions: a longer one jumps to the next sidelobe."""
BEHIND_M = 0.05
"""Scale over which it becomes unlikely that an image is nearer than its anchor."""
FREE_M = 100.0
"""Prior deviation of a distance of which nothing is known."""


@dataclass(frozen=True, eq=False)
class PathPrior:
    """What is predicted of the N paths of one anchor, its own first, which is the shortest.

    Attributes
    ----------
    mean : (N,) m
        Distances.
    precision : (N, N) 1/m^2
        Inverse covariance.
    weight : (N,)
        Mean power of each path, times the probability that it is there.
    away : (N,), optional
        Mean power of those that are hardly there and may be back; 0 for others (default: all).
    chance : (N,), optional
        Probability that each is there: one that isn't may well be nearer than its anchor (default: all are).
    begin : (N,) m, optional
        Where a search for the mode begins (default: at the means).
    """

    mean: Array
    precision: Array
    weight: Array
    away: Array | None = None
    chance: Array | None = None
    begin: Array | None = None

    @property
    def chances(self) -> Array:
        """Probability (N,) that each path is there."""
        return np.ones(len(self.mean)) if self.chance is None else self.chance

    def back(self, row: int, distance: float | None = None) -> PathPrior:
        """The prior if a path that was away is there, at a distance or where it is predicted."""
        away = np.zeros(len(self.weight)) if self.away is None else self.away.copy()
        there = self.weighed(row, float(away[row]))
        away[row] = 0.0
        chance = self.chances.copy()
        chance[row] = 1.0
        begin = (self.mean if self.begin is None else self.begin).copy()
        begin[row] = self.mean[row] if distance is None else distance
        return replace(there, away=away, chance=chance, begin=begin)

    def weighed(self, row: int, weight: float) -> PathPrior:
        """The prior with another mean power of one path."""
        fresh = self.weight.copy()
        fresh[row] = weight
        return replace(self, weight=fresh)

    def with_path(self, distance: float, weight: float) -> PathPrior:
        """One path more, whose distance is free; the search starts from the one that is given."""
        size = len(self.mean)
        precision = np.zeros((size + 1, size + 1))
        precision[:size, :size] = self.precision
        precision[size, size] = FREE_M**-2
        away = None if self.away is None else np.append(self.away, 0.0)
        return PathPrior(
            np.append(self.mean, distance), precision, np.append(self.weight, weight), away,
            np.append(self.chances, 1.0), None if self.begin is None else np.append(self.begin, distance),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Mode:
    """Where the posterior of the distances is highest, and its Gaussian there.

    Attributes
    ----------
    distance : (N,) m
    covariance : (N, N) m^2
        Inverse of prior precision plus information.
    log_posterior : float
        log CN(z; 0, C) + log prior but for constants.
    band : Band
    samples : (M,) complex128
    weight : (N,)
        Mean power of each path, as assumed.
    noise : float
        Power of the noise in each sample, as assumed.
    """

    distance: Array
    covariance: Array
    log_posterior: float
    band: Band
    samples: Complex
    weight: Array
    noise: float

    @cached_property
    def paths(self) -> Superposition:
        """The paths at the mode."""
        return superpose(self.band, self.samples, self.distance, self.weight, self.noise)

    @property
    def noise_ratio(self) -> float:
        """Power left over in ratio to what is expected, less what fitting the distances took (M86)."""
        taken = 0.5 * float(np.sum(self.covariance * self.paths.information))
        return self.paths.rest_power / (self.noise * max(self.paths.unexplained - taken, 1.0))

    @property
    def variance(self) -> Array:
        """(N,) m^2."""
        return np.asarray(self.covariance.diagonal())


def joint_mode(band: Band, samples: Complex, prior: PathPrior, noise: float) -> Mode:
    """Find the mode by Gauss-Newton steps with the information of the whole snapshot (M79).

    Parameters
    ----------
    samples : (M,) complex128
    noise : float
        Power of the noise in each sample.
    """
    runtime.start()
    from gridslam.kernels.messages.distances import climb_distances

    size = len(prior.mean)
    weight = np.empty((size, 2))
    weight[:, 0], weight[:, 1] = prior.weight, prior.chances
    distance = np.array(prior.mean if prior.begin is None else prior.begin, np.float64)
    information, value = np.empty((size, size)), np.empty(1)
    climb_distances(
        band.wavenumber, pairs(band.pulse), pairs(np.ascontiguousarray(samples)), prior.mean,
        prior.precision, weight, limits_of(band, noise),
        np.empty((7, size + 1, size, 2)), np.empty((size, 9)), distance, information, value,
    )  # fmt: skip
    covariance = np.linalg.inv(prior.precision + information)
    return Mode(
        distance, 0.5 * (covariance + covariance.T), float(value[0]), band, samples, prior.weight, noise
    )


def limits_of(band: Band, noise: float) -> Array:
    """Numbers of a search, (7,), as the kernel takes them."""
    farthest, norm = FARTHEST * band.resolution_m, 1 / np.sqrt(2 * np.pi)
    return np.array([noise, farthest, BEHIND_M, ROUNDS, HALVINGS, STILL**2, norm])
