"""One correlated Gaussian belief about the agent and all surfaces (docs/model.md, (M15)).

Separate beliefs forget that the map was built from the agent's own error. Here agent and surfaces stay
correlated: the state is [x, y, vx, vy, heading, angle_1, offset_1, angle_2, ...], see `layout`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs, dsygv

from gridslam.arrays import LATER, Array, replace
from gridslam.inference.beliefs.layout import HEADING, PER_LINE, StateLayout
from gridslam.world.geometry import wrap

LEAST_RIDGE = 1e-12
"""Added to correlations, since a view is singular where clocks are known."""
Kind = TypeVar("Kind", bound="Belief")


@dataclass(frozen=True)
class Belief:
    """Gaussian belief about one agent, and what it shares with all that it hears.

    Attributes
    ----------
    mean : (N,) float64
        N = 5 + 2 S, or 5 + J + 2 S with clocks, or 5 + G + 2 S with rises.
    covariance : (N, N) float64
    clocks : int
        How many differences of clocks follow the agent's pose: J, or 0 if clocks are known.
    rises : int
        How many rises do so instead: G, or 0 if heights are known.
    """

    mean: Array
    covariance: Array
    clocks: int = 0
    rises: int = field(default=0, kw_only=True, metadata=LATER)

    @cached_property
    def layout(self) -> StateLayout:
        """Where things stand in it."""
        return StateLayout.of_view(len(self.mean), self.clocks, self.rises)

    def copy(self) -> Belief:
        """The belief in arrays of its own."""
        return replace(self, mean=self.mean.copy(), covariance=self.covariance.copy())

    @property
    def lines(self) -> Array:
        """Mean lines of the surfaces, (S, 2): normal angle (rad) and offset (m)."""
        return self.mean[self.layout.lines].reshape(-1, 2)

    def late(self, anchors: NDArray[np.intp] | int) -> Array:
        """By how much clocks lengthen the distances of anchors (...,), m; 0 where they are known."""
        known = np.zeros(np.shape(anchors))
        return np.asarray(self.mean[self.layout.anchor_clocks][anchors]) if self.clocks else known

    @property
    def higher(self) -> Array:
        """By how much anchors are higher above the agent than is told, by rises (G,) m."""
        return np.asarray(self.mean[self.layout.heights])

    @property
    def root(self) -> Array:
        """Lower triangular root of the covariance (Cholesky's), which may be singular, (N, N).

        Unlike eigenvectors or their signs it is a continuous function of a regular covariance: particles of
        two computers whose rounding differs stay next to each other.
        """
        root, failed = dpotrf(self.covariance, lower=1, clean=1)
        if failed:
            values, vectors = np.linalg.eigh(self.covariance)
            _, upper = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0))).T)
            root = upper.T * np.where(np.diagonal(upper) < 0, -1.0, 1.0)
        return np.asarray(root)


def predict(
    belief: Belief, dt: float, acceleration: float, heading: float, shift: float, feet: Array,
    wider: Array | float = 1.0,
) -> Belief:  # fmt: skip
    """Near-constant velocity, random-walk heading, and jitter of every surface at its wall.

    [Li2026grid], section IV-A; docs/model.md, (M16), (M17).

    Parameters
    ----------
    dt, acceleration, heading, shift : float; s, m/s^2, rad, m
        `shift` is the jitter of a surface along its normal at the point where it is hit.
    feet : (S,) m
        Tangential coordinate of the place where each surface is hit, about which it turns.
    wider : (S, 2) or float
        How many times as far each surface shifts, and turns.
    """
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    move_agent(mean, covariance, 0, dt, acceleration, heading)
    after = replace(belief, mean=mean, covariance=covariance)
    if not len(feet):
        return after
    # a turn by w about the point at tangential coordinate t changes the offset by t w
    further, around = (wider[:, 0], wider[:, 1]) if isinstance(wider, np.ndarray) else (wider, wider)
    slid, turn = (shift * further) ** 2, (shift / 5.0 * around) ** 2
    lever = turn * feet
    angle, below, right, offset = line_entries(after)
    angle += turn
    below += lever
    right += lever
    offset += lever * feet + slid
    return after


def move_agent(
    mean: Array, covariance: Array, first: int, dt: float, acceleration: float, heading: float
) -> None:  # fmt: skip
    """Near-constant velocity, random-walk heading of the agent whose entries begin at `first`; in place.

    Parameters
    ----------
    mean, covariance : (N,), (N, N)
        Of the joint belief; changed.
    dt, acceleration, heading : float; s, m/s^2, rad
        The step's length; deviation of the acceleration within it, and of the heading's walk over it.
    """
    carry(mean, covariance, slice(first, first + 2), slice(first + 2, first + 4), dt)
    place, speed = 0.5 * acceleration * dt**2, acceleration * dt
    for axis in (first, first + 1):
        covariance[axis, axis] += place**2
        covariance[axis + 2, axis + 2] += speed**2
        covariance[axis, axis + 2] += place * speed
        covariance[axis + 2, axis] += place * speed
    covariance[first + HEADING, first + HEADING] += heading**2


def carry(mean: Array, covariance: Array, what: Any, by: Any, dt: float) -> None:
    """Let entries `what` move by their rates, the entries `by`, in place."""
    mean[what] += dt * mean[by]
    covariance[what] += dt * covariance[by]
    covariance[:, what] += dt * covariance[:, by]


def line_entries(belief: Belief) -> tuple[Array, Array, Array, Array]:
    """Of every line the variance of its angle, both its covariances with the offset, and the offset's (S,).

    They are views, of a covariance in one piece.
    """
    size, entries = len(belief.mean), belief.covariance.reshape(-1)
    angle, on = belief.layout.head * (size + 1), 2 * (size + 1)
    starts = angle, angle + size, angle + 1, angle + size + 1
    first, below, right, last = (entries[start::on] for start in starts)
    return first, below, right, last


def update(
    belief: Belief,
    jacobian: Array,
    residuals: Array,
    noises: Array,
    weights: Array,
    bend: Array | float = 0.0,
) -> Belief:
    """Moment-matched update with one path that several measurements (or none) may have come from.

    Parameters
    ----------
    jacobian : (D, N)
        Derivative of the path's parameters by the state.
    residuals : (M, D)
        Measured minus predicted.
    noises : (M, D)
        Variances of the measurements.
    weights : (M,)
        Probability of each association; the rest, ``1 - sum``, is that of none.
    bend : (D, D), optional
        Covariance of what the derivative leaves out of the path's parameters.
    """
    spread = belief.covariance @ jacobian.T
    core = jacobian @ spread + bend
    shift = np.zeros(len(belief.mean))
    inner = np.zeros_like(core)
    outer = np.zeros((len(shift), len(shift)))
    for residual, noise, weight in zip(residuals, noises, weights, strict=True):
        inverse = np.linalg.inv(core + np.diag(noise))
        step = spread @ (inverse @ residual)
        shift += weight * step
        inner += weight * inverse
        outer += weight * np.outer(step, step)
    covariance = belief.covariance - spread @ inner @ spread.T + outer - np.outer(shift, shift)
    mean = belief.mean + shift
    mean[HEADING] = wrap(mean[HEADING])
    return replace(belief, mean=mean, covariance=0.5 * (covariance + covariance.T))


def give_birth(belief: Belief, line: Array, by_state: Array, by_measurement: Array, noise: Array) -> Belief:
    """Append a surface that is a function of the state and of a measurement.

    Parameters
    ----------
    line : (2,)
    by_state : (2, N)
        Derivative of the line by the state so far: this keeps the new surface correlated with its maker.
    by_measurement : (2, D)
    noise : (D,)
        Variances of the measurement.
    """
    cross = by_state @ belief.covariance
    own = cross @ by_state.T + by_measurement @ np.diag(noise) @ by_measurement.T
    covariance = np.block([[belief.covariance, cross.T], [cross, own]])
    return replace(
        belief, mean=np.concatenate([belief.mean, line]), covariance=0.5 * (covariance + covariance.T)
    )


def append(belief: Belief, line: Array, covariance: Array) -> Belief:
    """Append a surface that is independent of the rest."""
    size = len(belief.mean)
    joint = np.zeros((size + 2, size + 2))
    joint[:size, :size], joint[size:, size:] = belief.covariance, covariance
    return replace(belief, mean=np.concatenate([belief.mean, line]), covariance=joint)


def keep(belief: Belief, surfaces: NDArray[np.bool_]) -> Belief:
    """Marginalise out the surfaces that aren't kept."""
    rows = np.concatenate([np.ones(belief.layout.head, dtype=bool), np.repeat(surfaces, 2)])
    return replace(belief, mean=belief.mean[rows], covariance=belief.covariance[np.ix_(rows, rows)])


def separated(belief: Belief) -> Belief:
    """The belief without its correlations: agent and surfaces apart, as the papers keep them.

    Every belief keeps its marginal, and forgets whose errors it was built from.
    """
    owner = belief.layout.owner
    return replace(belief, covariance=belief.covariance * (owner[:, None] == owner))


def lines_covariance(belief: Belief, surfaces: NDArray[np.bool_]) -> Array:
    """Joint covariance of some lines (2 S, 2 S), as they are written for users: with offsets of 0 or more."""
    rows, sign = lines_as_written(belief, surfaces)
    return np.asarray(belief.covariance[np.ix_(rows, rows)] * np.outer(sign, sign))


def lines_as_written(belief: Belief, surfaces: NDArray[np.bool_]) -> tuple[NDArray[np.intp], Array]:
    """Entries (2 S,) of some lines in a belief, and their signs for users, whose offsets are 0 or more."""
    rows = belief.layout.head + np.flatnonzero(np.repeat(surfaces, PER_LINE))
    sign = np.ones((len(belief.lines), PER_LINE))
    sign[belief.lines[:, 1] < 0, 1] = -1.0
    return rows, sign[surfaces].ravel()


def with_lines(belief: Kind, covariance: Array) -> Kind:
    """The belief with another covariance (2 S, 2 S) of its lines, which nothing else is correlated with."""
    joint = belief.covariance.copy()
    joint[belief.layout.lines, belief.layout.lines] = covariance
    return replace(belief, covariance=joint)


def solved(covariance: Array, right: Array) -> Array:
    """Covariance^-1 right, of a covariance that may be singular and whose entries differ in size."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0))
    scale[scale == 0] = 1.0
    even, own = covariance / np.outer(scale, scale), np.diag_indices(len(covariance))
    for jitter in (0.0, LEAST_RIDGE, 1e3 * LEAST_RIDGE, 1e6 * LEAST_RIDGE):
        even[own] += jitter
        root, failed = dpotrf(even, lower=1, clean=0)
        if not failed:
            return np.asarray(dpotrs(root, right / scale[:, None], lower=1)[0] / scale[:, None])
    return np.asarray(np.linalg.pinv(even, hermitian=True) @ (right / scale[:, None]) / scale[:, None])


def diagonal_together(covariance: Array, other: Array) -> tuple[Array, Array]:
    """Variances (N,) and a frame F (N, N) in which one covariance is diagonal, F' C F, and another one is 1.

    Raises
    ------
    numpy.linalg.LinAlgError
        The other isn't positive definite.
    """
    value, frame, trouble = dsygv(covariance, other)
    if trouble:
        raise np.linalg.LinAlgError("covariance isn't positive definite")
    return value, frame
