"""Joint mode of the distances of all paths of one anchor, and what a snapshot tells of them (M79)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from gridslam.arrays import Array
from gridslam.inference.messages.samples.path_search import climb
from gridslam.inference.messages.samples.signal_likelihood import Band, Superposition, superpose

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
    """

    mean: Array
    precision: Array
    weight: Array

    def with_path(self, distance: float, weight: float) -> PathPrior:
        """One path more, whose distance is free; the search starts from the one that is given."""
        size = len(self.mean)
        precision = np.zeros((size + 1, size + 1))
        precision[:size, :size] = self.precision
        precision[size, size] = FREE_M**-2
        return PathPrior(np.append(self.mean, distance), precision, np.append(self.weight, weight))


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
    paths : Superposition
        The paths at the mode.
    noise : float
        Power of the noise in each sample, as assumed.
    """

    distance: Array
    covariance: Array
    log_posterior: float
    paths: Superposition
    noise: float

    @property
    def noise_ratio(self) -> float:
        """Power left over in ratio to what is expected, less what fitting the distances took (M86)."""
        taken = 0.5 * float(np.sum(self.covariance * self.paths.information))
        return self.paths.rest_power / (self.noise * max(self.paths.unexplained - taken, 1.0))

    @property
    def variance(self) -> Array:
        """(N,) m^2."""
        return np.asarray(self.covariance.diagonal())


@dataclass(frozen=True, eq=False)
class _Place:
    """Paths at some distances, and their log posterior."""

    paths: Superposition
    value: float


@dataclass(frozen=True, eq=False)
class _Distances:
    """Log posterior of the distances of all paths; see `path_search.Posterior`."""

    band: Band
    samples: Complex
    prior: PathPrior
    noise: float

    def at(self, distance: Array) -> _Place:
        prior = self.prior
        paths = superpose(self.band, self.samples, distance, prior.weight, self.noise)
        off = distance - prior.mean
        value = paths.log_density - 0.5 * float(off @ prior.precision @ off)
        return _Place(paths, value + float(log_behind(distance).sum()))

    def slopes(self, distance: Array, place: _Place) -> tuple[Array, Array]:
        push, stiff = _order(distance)
        prior, paths = self.prior, place.paths
        gradient = paths.gradient - prior.precision @ (distance - prior.mean) + push
        return gradient, prior.precision + paths.information + stiff

    def shortened(self, place: _Place, step: Array) -> Array:
        return step * min(1.0, FARTHEST * self.band.resolution_m / np.abs(step).max())


def joint_mode(
    band: Band, samples: Complex, prior: PathPrior, noise: float, start: Array | None = None
) -> Mode:
    """Find the mode by Gauss-Newton steps with the information of the whole snapshot (M79).

    Parameters
    ----------
    samples : (M,) complex128
    noise : float
        Power of the noise in each sample.
    start : (N,) m, optional
        Where the search begins. Default: the predicted distances.
    """
    posterior = _Distances(band, samples, prior, noise)
    begin = prior.mean if start is None else start
    distance, place = climb(posterior, begin, posterior.at(begin))
    covariance = np.linalg.inv(prior.precision + place.paths.information)
    return Mode(distance, 0.5 * (covariance + covariance.T), place.value, place.paths, noise)


def log_behind(distance: Array, margin: float = BEHIND_M) -> Array:
    """Log probability (N - 1,) that images at distances [1:] are farther than their anchor at [0]."""
    return np.asarray(log_ndtr((distance[1:] - distance[0]) / margin))


def _order(distance: Array) -> tuple[Array, Array]:
    """Gradient (N,) and curvature (N, N) of the sum of `log_behind`."""
    gap = (distance[1:] - distance[0]) / BEHIND_M
    slope = np.exp(-0.5 * gap**2 - log_ndtr(gap)) / np.sqrt(2 * np.pi)
    bend = slope * (slope + gap) / BEHIND_M**2
    slope = slope / BEHIND_M
    gradient = np.concatenate([[-slope.sum()], slope])
    curvature = np.diag(np.concatenate([[bend.sum()], bend]))
    curvature[0, 1:] = curvature[1:, 0] = -bend
    return gradient, curvature
