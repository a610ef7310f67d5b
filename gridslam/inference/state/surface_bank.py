"""The bank of potential surfaces: existence, coefficient, rays, and where they were hit."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.state.rays import P_APPEAR, P_STAY
from gridslam.world.radio import BINS

FRESH_SINGLE, FRESH_DOUBLE, FRESH_BEARER = 0.5, 0.3, 0.98
"""Existence of a new surface's rays: single bounces, double bounces, and the ray that bore it."""
RESTING = P_APPEAR / (P_APPEAR + 1 - P_STAY)
"""Existence of a ray of which nothing was told for long."""
ANGLES = 8
"""Sums of what the angles of single bounces say of a surface."""
SETTLED = 100
"""Age and number of sightings of a surface that an earlier agent left."""
FORMS = 11
"""Numbers of a wall and of a point that are fitted to what is heard of a surface."""
MOST_MOVED = 0.25
"""Share of a coefficient's bin that goes over to either neighbour in one step of its walk at most."""
WIDEST_WALK = 10.0
"""Deviation of a coefficient's walk over a step from which on its belief is uniform after it."""


def _flat(values: dict[str, Any]) -> Array:
    """The walks of an earlier version's surfaces: those of flat walls, (S, 2)."""
    return np.zeros((values["identity"].size, 2))


def _not_known(values: dict[str, Any]) -> Array:
    """The outermost hits of an earlier version's surfaces, which it didn't keep, (S, 8)."""
    return np.full((values["identity"].size, 8), np.nan)


def _none_weighed(values: dict[str, Any]) -> Array:
    """The angles of an earlier version's surfaces, which it didn't weigh so, (S, J, 8)."""
    return np.zeros((values["identity"].size, len(values["single"]), ANGLES))


def _none_fitted(values: dict[str, Any]) -> Array:
    """The forms of an earlier version's surfaces, which it didn't fit, (S, 11)."""
    return np.zeros((values["identity"].size, FORMS))


@dataclass(frozen=True, eq=False)
class SurfaceBank:
    """Potential surfaces, aligned with the lines in a `Belief`.

    Attributes
    ----------
    identity : (S,) int64
    existence : (S,) float64
    reflection : (S, BINS) float64
        Belief over `REFLECTION_BINS`; rows sum to 1.
    age : (S,) float64
        Chances to be seen since birth: steps, each with the probability that a single bounce is detected.
    seen : (S,) int
        Detections, one per step and anchor at most.
    single : (J, S) float64
        Existence of the single-bounce ray from each anchor.
    double : (J, S, S) float64
        Existence of the ray over (last, first).
    extent : (S, 2) float64, m
        Tangential stretch that was hit, its ends by the line as it is believed now.
    outermost : (S, 8) float64, m
        The paths that hit lowest and highest: from where (x, y) and to where each went, its other bounce
        unfolded; NaN where an end is another agent's.
    foot : (S,) float64, m
        Tangential coordinate of the latest hit.
    owner : (S,) int
        The one anchor that a surface serves (a virtual anchor); -1 for all.
    walk : (S, 2) float64
        Log of how many times as far as a flat wall's line each shifts, and turns, from step to step; where it
        is below 0, as far.
    angles : (S, J, 8) float64
        Sums over all single bounces so far, by anchor, see `messages.mirrors`. Of departures, weights
        (1/rad^2), and by how much they missed a mirror's, times weights (1/rad); of arrivals the same; what
        departures cost (nats) if a mirror, and if a right corner of two walls sends them; and how they lie
        beside that corner's, as vectors (x, y) as long as the weights.
    forms : (S, 11) float64
        A wall that stays, and a point that scatters, as fitted to the same, see `messages.scatterers`: of the
        wall angle (rad), offset (m) and covariance (three numbers), of the point x, y (m) and covariance, and
        the log odds of the wall (nats). Zeros: nothing was fitted yet.
    """

    identity: NDArray[np.int64]
    existence: Array
    reflection: Array
    age: Array
    seen: NDArray[np.int64]
    single: Array
    double: Array
    extent: Array = field(metadata={"blank": True})
    foot: Array
    owner: NDArray[np.int64]
    walk: Array = field(metadata={"later": _flat})
    outermost: Array = field(metadata={"later": _not_known, "blank": True})
    angles: Array = field(metadata={"later": _none_weighed})
    forms: Array = field(metadata={"later": _none_fitted})

    def __len__(self) -> int:
        return len(self.identity)

    def check(self, belief: Belief, places: int, sights: int) -> None:
        """Refuse a belief or anchors that this isn't the bank of: a kernel would read past its arrays."""
        count = len(self)
        if not (
            belief.layout.surfaces == count
            and len(self.existence) == len(self.owner) == count
            and sights == places <= len(self.single)
            and self.single.shape[1:] == (count,)
            and self.double.shape[1:] == (count, count)
        ):
            raise ValueError("surfaces or anchors don't belong together")

    @classmethod
    def empty(cls, links: int, anchors: int | None = None) -> SurfaceBank:
        """A bank without surfaces; of several agents, so many links are those of how many anchors."""
        none, whole = np.zeros(0), np.zeros(0, np.int64)
        return cls(
            whole, none, np.zeros((0, BINS)), none.copy(), whole.copy(), np.zeros((links, 0)),
            np.zeros((links, 0, 0)), np.zeros((0, 2)), none.copy(), whole.copy(), np.zeros((0, 2)),
            np.zeros((0, 8)), np.zeros((0, links if anchors is None else anchors, ANGLES)),
            np.zeros((0, FORMS)),
        )  # fmt: skip

    @property
    def likeliest_ray(self) -> Array:
        """Existence of the likeliest ray over each surface, (S,)."""
        every = np.concatenate([self.single, self.double.max(1, initial=0), self.double.max(2, initial=0)])
        likeliest: Array = every.max(0, initial=0)
        return likeliest

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> SurfaceBank:
        """Keep some of the surfaces."""
        parts = {f.name: getattr(self, f.name) for f in fields(self)}
        chosen = {name: part[rows] for name, part in parts.items() if name not in ("single", "double")}
        single, double = self.single[:, rows], self.double[:, rows][:, :, rows]
        return SurfaceBank(**chosen, single=np.ascontiguousarray(single), double=np.ascontiguousarray(double))

    def joined(self, other: SurfaceBank) -> SurfaceBank:
        """These surfaces, then those of another bank; nothing was told for long of rays over one of each."""
        count, whole = len(self), len(self) + len(other)
        columns = [f.name for f in fields(self) if f.name not in ("single", "double")]
        parts = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in columns}
        double = np.full((len(self.double), whole, whole), RESTING)
        double[:, :count, :count], double[:, count:, count:] = self.double, other.double
        return SurfaceBank(**parts, single=np.concatenate([self.single, other.single], 1), double=double)

    def add(
        self,
        identity: int,
        existence: float,
        reflection: Array,
        foot: float,
        bearer: tuple[int, int, int],
        owner: int = -1,
        age: float = 0.0,
        seen: int = 0,
        extent: Array | None = None,
    ) -> SurfaceBank:
        """Append a new surface.

        Parameters
        ----------
        reflection : (BINS,)
            Belief over its coefficient.
        foot : float, m
            Tangential coordinate of where it is taken to be hit.
        bearer : tuple of int
            Anchor, and rows of the surfaces hit last and first, of the ray that bore it; -1 for itself.
        owner : int
            The one anchor that it serves; -1 for all.
        age, seen : float, int
            See the attributes.
        extent : (2,) m, optional
            Tangential stretch that was hit; default: unknown, NaN.
        """
        count, anchors = len(self), len(self.single)
        single, double = np.empty((anchors, count + 1)), np.empty((anchors, count + 1, count + 1))
        single[:, :count], single[:, count] = self.single, FRESH_SINGLE
        double[:], double[:, :count, :count] = FRESH_DOUBLE, self.double
        anchor, last, first = (count if b == -1 else b for b in bearer)
        if last == first:
            single[anchor, count] = FRESH_BEARER
        else:
            double[anchor, last, first] = FRESH_BEARER
        return SurfaceBank(
            _longer(self.identity, identity),
            _longer(self.existence, existence),
            _longer(self.reflection, reflection),
            _longer(self.age, age),
            _longer(self.seen, seen),
            single,
            double,
            _longer(self.extent, np.nan if extent is None else extent),
            _longer(self.foot, foot),
            _longer(self.owner, owner),
            _longer(self.walk, 0.0),
            _longer(self.outermost, np.nan),
            _longer(self.angles, 0.0),
            _longer(self.forms, 0.0),
        )


def _longer(rows: NDArray[Any], last: float | Array) -> NDArray[Any]:
    """The rows, and one more."""
    longer = np.empty((len(rows) + 1, *rows.shape[1:]), rows.dtype)
    longer[:-1], longer[-1] = rows, last
    return longer


def evolve(
    bank: SurfaceBank, survival: float, coefficient_std: float, chance: Array | float = 1.0
) -> SurfaceBank:
    """Surfaces survive, coefficients walk: [Li2026grid], eqs. (4), (5), section IV-A.

    Parameters
    ----------
    coefficient_std : float
        Standard deviation of a coefficient's random walk over a step.
    chance : (S,) or float
        Probability that each will be detected at this step, if it is there and in sight.
    """
    reflection = diffused(bank.reflection, coefficient_std)
    return replace(bank, existence=bank.existence * survival, reflection=reflection, age=bank.age + chance)


def diffused(belief: Array, std: float) -> Array:
    """Beliefs over `REFLECTION_BINS` (S, BINS) after a random walk of deviation `std`, none beyond its ends.

    A step to either neighbour has the probability `rate`, half the variance in bins squared: a quarter at
    most, so that none is left with less than nothing; a wider walk takes several steps. docs/model.md, (M19).
    """
    rate = 0.5 * (min(std, WIDEST_WALK) * BINS) ** 2
    if not rate:
        return belief
    if rate > MOST_MOVED:
        return belief @ _steps(rate)
    step = rate * (belief[:, 1:] - belief[:, :-1])
    belief = belief.copy()
    belief[:, :-1] += step
    belief[:, 1:] -= step
    return belief


@lru_cache(8)
def _steps(rate: float) -> Array:
    """Transition over as many steps as make `rate` together, (BINS, BINS); its rows sum to 1."""
    count = math.ceil(rate / MOST_MOVED)
    part = np.full(BINS - 1, rate / count)
    one = np.diag(part, 1) + np.diag(part, -1)
    np.fill_diagonal(one, 1 - one.sum(1))
    return np.linalg.matrix_power(one, count)
