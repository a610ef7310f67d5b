"""Joint mode of agent and surfaces, given a snapshot of antenna arrays; docs/model.md, (M151), (M152).

Lengths and angles of all paths of an anchor are functions of one state of fewer numbers, so that their
covariance is singular. The mode is sought over the state, in coordinates in which its prior is unit Gaussian.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array, squared
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.messages.samples.array_likelihood import (
    ArrayBand,
    ArraySuperposition,
    Complex,
    superpose_arrays,
)
from gridslam.inference.messages.samples.path_search import climb
from gridslam.world.geometry import wrap

FARTHEST = 0.36
"""Longest step of a path that matters, as a root mean square turn of phase, rad: 0.2 of c/B in length."""
FREE = np.array([1e-2, 1e-1, 1e-1])
"""Prior precision (1/m, 1/rad; its root) of a path of which nothing is known."""
WIDE, STARTS = 0.7, 48
"""Turn of phase (rms, rad) within a deviation of a path's prediction, from which on the posterior may have
several modes; states that are tried then, drawn from the belief."""
TURNS, LEAST_ACROSS = 4, 0.01
"""Slopes, along x and y, of phases over the anchor's array and the agent's; share of an array's extent that
it has across a direction at least."""
Whole = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class PathsPrior:
    """What is predicted of one anchor's paths: functions of the state, and free ones.

    Attributes
    ----------
    belief : Belief
        Of agent and surfaces.
    place : (3,)
        x, y (m) and orientation (rad) of the anchor.
    table : (N, 4) int32
        Rows of `Rays.table`.
    weight : (N + F,)
        Mean power of each path, times the probability that it is there.
    free : (F, 3) m, rad, rad
        Paths of which nothing is known: where the search for them begins.
    phase_std : float
        Of elements' phases, whose planes nobody knows, rad: they turn all departures or all arrivals of a
        snapshot beside the state, (M567).
    """

    belief: Belief
    place: Array
    table: Whole
    weight: Array
    free: Array
    phase_std: float = 0.0

    def with_path(self, path: Array, weight: float) -> PathsPrior:
        """One free path (3,) more."""
        free = np.concatenate([self.free, path[None]])
        return replace(self, free=free, weight=np.append(self.weight, weight))

    def reweighted(self, row: int, weight: float) -> PathsPrior:
        """The prior with another weight of one path."""
        fresh = self.weight.copy()
        fresh[row] = weight
        return replace(self, weight=fresh)


@dataclass(frozen=True, eq=False)
class StateMode:
    """Where the posterior is highest, and its Gaussian there.

    Attributes
    ----------
    belief : Belief
        Of agent and surfaces after the snapshot.
    path : (N + F, 3) m, rad, rad
        Its paths, the free ones last.
    spread : (N + F, 3, 3)
        Covariance of each.
    turned : (N + F, 3)
        By how much arrays have turned each, (M567).
    free_spread : (F, 3, 3)
        Covariance of the free paths but for that.
    paths : ArraySuperposition
        The paths at the mode.
    shift : (n,)
        Of the state, in prior deviations.
    information : (n, n)
        Information of the snapshot about these, if the free paths were known.
    log_posterior : float
        log CN(z; 0, C) + log prior but for constants.
    """

    belief: Belief
    path: Array
    spread: Array
    turned: Array
    free_spread: Array
    paths: ArraySuperposition
    shift: Array
    information: Array
    log_posterior: float

    @property
    def noise_ratio(self) -> float:
        """Power left over in ratio to what is expected, less what fitting the paths took."""
        block = np.einsum("npq,nqp->", self.spread, _blocks(self.paths.information))
        taken = 0.5 * min(float(block), float(self.spread.size) / 3)
        return self.paths.rest_power / (self.paths.noise * max(self.paths.unexplained - taken, 1.0))

    def log_evidence(self) -> Array:
        """What a ratio of likelihoods at the mode is worth as a mean over what was believed, (N + F,) logs.

        Laplace's approximation of the integral over each path's parameters, as all other paths predict them:
        with S its covariance at the mode and Lambda its own information, S (I - Lambda S)^-1 is that
        prediction's (M153).
        """
        own, gradient = _blocks(self.paths.information), self.paths.gradient
        shrinkage = np.eye(3) - own @ self.spread
        share = np.maximum(np.linalg.det(shrinkage), 1e-9)
        cavity = self.spread @ np.linalg.inv(shrinkage + 1e-9 * np.eye(3))
        pulled = np.einsum("np,npq,nq->n", gradient, cavity, gradient)
        return np.asarray(0.5 * np.log(np.minimum(share, 1.0)) - 0.5 * np.clip(pulled, 0.0, 50.0))


def _blocks(information: Array) -> Array:
    """Each path's own part (N, 3, 3) of what is of all, (3 N, 3 N)."""
    count = len(information) // 3
    rows = np.arange(count)
    return np.asarray(information.reshape(count, 3, count, 3)[rows, :, rows, :])


def paths_at(
    mean: Array, place: Array, table: Whole, head: int, root: Array | None = None
) -> tuple[Array, Array]:
    """Lengths, departures, arrivals (N, 3) of paths at a state (n,), and derivatives by it (N, 3, n).

    Parameters
    ----------
    root : (n, n), optional
        Derivatives of the state by numbers that it is a function of: then those are by these.
    """
    runtime.start()
    from gridslam.kernels.propagation.state_paths import trace_paths

    size = len(mean)
    path, slope = np.empty((len(table), 3)), np.empty((len(table), 3, size))
    spot = np.array([place[0], place[1], place[2], 0.0, 0.0])
    by = np.eye(size) if root is None else root
    trace_paths(head, np.ascontiguousarray(mean), by, spot, np.ascontiguousarray(table), path, slope)
    return path, slope


def is_wide(band: ArrayBand, belief: Belief, place: Array, table: Whole) -> NDArray[np.bool_]:
    """Which paths (N,) a belief predicts less well than within a wave of their correlation."""
    root = np.ascontiguousarray(belief.root)
    _, slope = paths_at(belief.mean, place, table, belief.layout.head, root)
    return _wide(slope, band)


def _wide(slope: Array, band: ArrayBand) -> NDArray[np.bool_]:
    """What `is_wide` says of paths (N,), by their derivatives (N, 3, n) by deviations of the belief."""
    return np.asarray((np.sqrt((slope**2).sum(-1)) * band.steepness > WIDE).any(-1))


def state_mode(band: ArrayBand, samples: Complex, prior: PathsPrior, noise: float) -> StateMode:
    """Find the mode by Gauss-Newton steps with the information of the whole snapshot (M151).

    Parameters
    ----------
    samples : (A, B, M) complex128
    noise : float
        Power of the noise in each sample.
    """
    posterior = _States(band, samples, prior, noise)
    numbers = np.zeros(len(posterior.precision))
    place = posterior.at(numbers)
    if posterior.is_wide(place):
        numbers, place = posterior.likeliest(numbers, place)
    return posterior.mode(*climb(posterior, numbers, place))


@dataclass(frozen=True, eq=False)
class _Place:
    """Paths (N + F, 3) of a state, by how much arrays turn them, slopes (3 N + 3 F, n), the log posterior."""

    path: Array
    turned: Array
    slope: Array
    paths: ArraySuperposition
    value: float


class _States:
    """Log posterior of a state in deviations of its prior, and of free paths; see `path_search.Posterior`."""

    def __init__(self, band: ArrayBand, samples: Complex, prior: PathsPrior, noise: float) -> None:
        self.band, self.samples, self.prior, self.noise = band, samples, prior, noise
        self.root, self.head = np.ascontiguousarray(prior.belief.root), prior.belief.layout.head
        self.size = len(self.root)
        self.matters = prior.weight > noise
        turns = TURNS if prior.phase_std else 0
        self.precision = np.concatenate(
            [np.ones(self.size), np.tile(FREE**2, len(prior.free)), np.ones(turns)]
        )

    def at(self, numbers: Array) -> _Place:
        prior, size, count = self.prior, self.size, len(self.prior.table)
        mean = prior.belief.mean + self.root @ numbers[:size]
        path, slope = paths_at(mean, prior.place, prior.table, self.head, self.root)
        turned = np.zeros((count + len(prior.free), 3))
        if len(numbers) > size:
            by_state, last = slope, size + prior.free.size
            path = np.concatenate([path, prior.free + numbers[size:last].reshape(-1, 3)])
            slope = np.zeros((len(path), 3, len(numbers)))
            slope[:count, :, :size] = by_state
            slope[count:, :, size:last] = np.eye(last - size).reshape(len(prior.free), 3, last - size)
            if prior.phase_std:
                slope[:, :, last:] = _turning(path, self.band, prior.phase_std)
                turned = slope[:, :, last:] @ numbers[last:]
                path = path + turned
        square = float(self.precision @ numbers**2)
        paths = superpose_arrays(self.band, self.samples, path, prior.weight, self.noise)
        value = paths.log_density - 0.5 * square
        return _Place(path, turned, slope.reshape(-1, len(numbers)), paths, value)

    def is_wide(self, place: _Place) -> bool:
        """Whether a path that matters is known less well than within a wave of its correlation."""
        known, slope = len(self.prior.table), place.slope.reshape(-1, 3, place.slope.shape[1])
        wide = _wide(slope[:known, :, : self.size], self.band)
        return bool(wide[self.matters[:known]].any())

    def likeliest(self, numbers: Array, place: _Place) -> tuple[Array, _Place]:
        """The likeliest of states drawn from the belief and of its mean."""
        for drawn in _points(self.size):
            tried = np.concatenate([drawn, numbers[self.size :]])
            trial = self.at(tried)
            if trial.value > place.value:
                numbers, place = tried, trial
        return numbers, place

    def slopes(self, numbers: Array, place: _Place) -> tuple[Array, Array]:
        gradient = place.slope.T @ place.paths.gradient.reshape(-1) - self.precision * numbers
        return gradient, self.information(place) + np.diag(self.precision)

    def information(self, place: _Place) -> Array:
        """Information of the snapshot about all numbers."""
        return np.asarray(place.slope.T @ place.paths.information @ place.slope)

    def shortened(self, place: _Place, step: Array) -> Array:
        moved = np.abs((place.slope @ step).reshape(-1, 3)) * self.band.steepness
        farthest = float(moved[self.matters].max(initial=0.0))
        return step * min(1.0, FARTHEST / max(farthest, 1e-12))

    def mode(self, numbers: Array, place: _Place) -> StateMode:
        """What is believed at a place."""
        information, size = self.information(place), self.size
        covariance = np.linalg.inv(information + np.diag(self.precision))
        mean = self.prior.belief.mean + self.root @ numbers[:size]
        mean[HEADING] = wrap(mean[HEADING])
        own = self.root @ covariance[:size, :size] @ self.root.T
        belief = replace(self.prior.belief, mean=mean, covariance=0.5 * (own + own.T))
        slope, count = place.slope.reshape(-1, 3, len(numbers)), self.prior.free.size
        free = np.asarray(covariance[size : size + count, size : size + count], np.float64)
        told = information[:size, :size]
        if self.prior.phase_std:  # of what is left of it where nobody knows how arrays turn paths
            by, own = information[:size, size + count :], information[size + count :, size + count :]
            told = told - by @ np.linalg.solve(own + np.eye(TURNS), by.T)
        return StateMode(
            belief, place.path, slope @ covariance @ np.swapaxes(slope, 1, 2), place.turned, _blocks(free),
            place.paths, numbers[:size], told, place.value,
        )  # fmt: skip


def _turning(path: Array, band: ArrayBand, phase_std: float) -> Array:
    """Derivatives of paths (N, 3) by what turns them, each in units of its deviation, (N, 3, TURNS).

    Slopes of phases that no plane tells have the inverse of the array's extent for a covariance: across a
    direction the array tells it by that extent, and no better by what it tells of others.
    """
    slope = np.zeros((len(path), 3, TURNS))
    for array, (angle, root) in enumerate(zip(path[:, 1:].T, band.extent_roots, strict=True)):
        across = np.stack([-np.sin(angle), np.cos(angle)], -1) @ root
        extent = np.maximum(squared(across).sum(1), LEAST_ACROSS * squared(root).sum())
        if extent.all():
            own = slice(2 * array, 2 * array + 2)
            slope[:, 1 + array, own] = phase_std * across / extent[:, None]
    return slope


@lru_cache(64)
def _points(size: int) -> Array:
    """Standard normal points, (STARTS, size)."""
    return np.random.default_rng(size).standard_normal((STARTS, size))
