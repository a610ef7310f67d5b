"""The bank of potential surfaces: existence, coefficient, rays; merging and pruning."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import canonical, unit, wrap
from gridslam.inference.belief import Belief, keep, slots, update
from gridslam.signal import REFLECTION_BINS

if TYPE_CHECKING:
    from gridslam.inference.polylines import Polylines
    from gridslam.inference.rays import Rays

Array = NDArray[np.float64]
BINS = len(REFLECTION_BINS)
FRESH_SINGLE, FRESH_DOUBLE, FRESH_BEARER = 0.5, 0.3, 0.98
"""Existence of a new surface's rays: single bounces, double bounces, and the ray that bore it."""
MOST_SURFACES = 24
SETTLED = 100
"""Age and number of sightings of a surface that an earlier agent left."""


@dataclass
class Bank:
    """Potential surfaces, aligned with the lines in a `Belief`.

    Attributes
    ----------
    identity : (S,) int64
    existence : (S,) float64
    reflection : (S, BINS) float64
        Belief over `REFLECTION_BINS`; rows sum to 1.
    age, seen : (S,) int
        Steps since birth; detections, one per step and anchor at most.
    single : (J, S) float64
        Existence of the single-bounce ray from each anchor.
    double : (J, S, S) float64
        Existence of the ray over (last, first).
    extent : (S, 2) float64, m
        Tangential stretch that was hit.
    foot : (S,) float64, m
        Tangential coordinate of the latest hit.
    owner : (S,) int
        The one anchor that a surface serves (a virtual anchor); -1 for all.
    """

    identity: NDArray[np.int64]
    existence: Array
    reflection: Array
    age: NDArray[np.int64]
    seen: NDArray[np.int64]
    single: Array
    double: Array
    extent: Array
    foot: Array
    owner: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.identity)

    @classmethod
    def empty(cls, anchors: int) -> Bank:
        """Bank without surfaces."""
        none, whole = np.zeros(0), np.zeros(0, np.int64)
        return cls(
            whole, none, np.zeros((0, BINS)), whole.copy(), whole.copy(), np.zeros((anchors, 0)),
            np.zeros((anchors, 0, 0)), np.zeros((0, 2)), none.copy(), whole.copy(),
        )  # fmt: skip

    def take(self, rows: NDArray[np.bool_]) -> Bank:
        """Keep some of the surfaces."""
        parts = {f.name: getattr(self, f.name) for f in fields(self)}
        chosen = {name: part[rows] for name, part in parts.items() if name not in ("single", "double")}
        return Bank(**chosen, single=self.single[:, rows], double=self.double[:, rows][:, :, rows])

    def add(
        self,
        identity: int,
        existence: float,
        reflection: Array,
        foot: float,
        bearer: tuple[int, int, int],
        owner: int = -1,
    ) -> Bank:
        """Append a new surface; `bearer` is (anchor, last, first) of the ray that bore it, -1 for itself."""
        count, anchors = len(self), len(self.single)
        single = np.concatenate([self.single, np.full((anchors, 1), FRESH_SINGLE)], 1)
        double = np.full((anchors, count + 1, count + 1), FRESH_DOUBLE)
        double[:, :count, :count] = self.double
        anchor, last, first = (count if b == -1 else b for b in bearer)
        if last == first:
            single[anchor, count] = FRESH_BEARER
        else:
            double[anchor, last, first] = FRESH_BEARER
        return Bank(
            np.append(self.identity, identity),
            np.append(self.existence, existence),
            np.concatenate([self.reflection, reflection[None]]),
            np.append(self.age, 0),
            np.append(self.seen, 0),
            single,
            double,
            np.concatenate([self.extent, np.full((1, 2), np.nan)]),
            np.append(self.foot, foot),
            np.append(self.owner, owner),
        )


def evolve(bank: Bank, survival: float, walk: float) -> None:
    """Surfaces survive, and their coefficients walk by `walk` per step (paper 003, section III-C)."""
    bank.existence = bank.existence * survival
    spread = (walk * BINS) ** 2 / 2
    step = spread * (bank.reflection[:, 1:] - bank.reflection[:, :-1])
    bank.reflection = bank.reflection.copy()
    bank.reflection[:, :-1] += step
    bank.reflection[:, 1:] -= step
    bank.age = bank.age + 1


def exist(bank: Bank, rays: Rays, chance: Array, worth: Array) -> None:
    """Update the surfaces' existence by all paths of one anchor (model.md, section 2.2).

    Parameters
    ----------
    chance : (L,)
        Existence of the ray times V.
    worth : (L,)
        Mean of ``sum_m nu_m g_m + 1 - p_d`` of every path.
    """
    whole = chance * worth + 1 - chance
    log = np.zeros(len(bank))
    for own, other in ((rays.last, rays.first), (rays.first, rays.last)):
        rows = np.flatnonzero((rays.bounces == 2) | ((rays.bounces == 1) & (own is rays.last)))
        single = rays.bounces[rows] == 1
        partner = np.where(single, 1.0, bank.existence[other[rows]])
        factor = np.log(np.maximum(partner * whole[rows] + 1 - partner, 1e-12))
        np.add.at(log, own[rows], factor)
    odds = np.log(np.maximum(bank.existence, 1e-12)) - np.log(np.maximum(1 - bank.existence, 1e-9)) + log
    bank.existence = np.clip(1 / (1 + np.exp(-np.clip(odds, -40, 40))), 0, 1 - 1e-7)


def mark(bank: Bank, belief: Belief, rays: Rays, lines: Polylines, share: Array) -> None:
    """Remember which surfaces were seen by each anchor, and where they were hit.

    Parameters
    ----------
    lines : Polylines
        The rays as drawn at sampled states.
    share : (L,)
        Probability that the path caused a measurement; above one half it counts.
    """
    rows = np.flatnonzero((share > 0.5) & (rays.bounces > 0))
    if not len(rows):
        return
    surface = np.stack([rays.last[rows], rays.first[rows]], -1).ravel()
    middle = lines.corners[rows].mean(1)
    double = rays.bounces[rows, None] == 2
    points = np.stack([np.where(double, middle[:, 2], middle[:, 1]), middle[:, 1]], 1).reshape(-1, 2)
    along = (points * unit(belief.lines[surface, 0] + 0.5 * np.pi)).sum(1)
    bank.foot[surface] = along
    np.fmin.at(bank.extent[:, 0], surface, along)
    np.fmax.at(bank.extent[:, 1], surface, along)
    anchors = len(bank.single)
    bank.seen += np.bincount(
        np.unique(surface * anchors + np.repeat(rays.anchor[rows], 2)) // anchors, minlength=len(bank)
    )


def prune(bank: Bank, belief: Belief, threshold: float) -> tuple[Bank, Belief]:
    """Drop unlikely surfaces; a birth must be confirmed by detections soon, and the number is bounded.

    Without confirmation a false birth hides: once its rays are believed blocked, no miss counts against it.
    """
    floor = np.where((bank.age >= 3) & (bank.seen < 3), max(threshold, 0.3), threshold)
    confirmed = bank.seen >= np.select([bank.age >= 60, bank.age >= 25, bank.age >= 5], [8, 6, 2], 0)
    good = (bank.existence >= floor) & confirmed
    if good.sum() > MOST_SURFACES:
        order = np.argsort(-bank.existence * good, kind="stable")
        good = np.zeros(len(bank), dtype=bool)
        good[order[:MOST_SURFACES]] = True
    return (bank, belief) if good.all() else (bank.take(good), keep(belief, good))


def merge(bank: Bank, belief: Belief, middle: Array) -> tuple[Bank, Belief]:
    """Merge duplicates into the older surface by the joint belief that both are one line.

    Two lines are one when they agree, within their joint covariance plus a centimetre, in angle and in
    offset near `middle` (2,), a point of the region.
    """
    pair = 0
    while True:
        found = _duplicate(bank, belief, middle)
        if found is None or pair > MOST_SURFACES:
            return bank, belief
        older, younger, jacobian, residual = found
        belief = update(belief, jacobian, residual[None], np.array([[1e-4, 1e-6]]), np.ones(1))
        bank.existence[older] = max(bank.existence[older], bank.existence[younger])
        bank.seen[older] = max(bank.seen[older], bank.seen[younger])
        bank.single[:, older] = np.maximum(bank.single[:, older], bank.single[:, younger])
        bank.double[:, older] = np.maximum(bank.double[:, older], bank.double[:, younger])
        bank.double[:, :, older] = np.maximum(bank.double[:, :, older], bank.double[:, :, younger])
        ends = np.stack([bank.extent[older], bank.extent[younger]])
        bank.extent[older] = [np.fmin.reduce(ends[:, 0]), np.fmax.reduce(ends[:, 1])]
        rest = np.arange(len(bank)) != younger
        bank, belief = bank.take(rest), keep(belief, rest)
        pair += 1


def _duplicate(bank: Bank, belief: Belief, middle: Array) -> tuple[int, int, Array, Array] | None:
    lines = belief.lines
    turns = wrap(lines[None, :, 0] - lines[:, None, 0])
    flips = np.where(np.abs(turns) > np.pi / 2, -1.0, 1.0)  # the same line written with the opposite normal
    turns = wrap(turns + np.where(flips < 0, np.pi, 0.0))
    normals = unit(lines[:, 0])
    tangents = np.stack([-normals[:, 1], normals[:, 0]], -1)
    places = lines[:, 1:] * normals + bank.foot[:, None] * tangents
    gaps = flips * (places @ normals.T - lines[:, 1])
    near = (np.abs(turns) <= 0.5) & (np.abs(gaps) <= 0.5) & (bank.owner[:, None] == bank.owner)
    for younger in range(len(bank) - 1, 0, -1):
        normal, tangent, place = normals[younger], tangents[younger], places[younger]
        for older in np.flatnonzero(near[younger, :younger]).tolist():
            turn, flip, gap = turns[younger, older], flips[younger, older], gaps[younger, older]
            other = normals[older]
            # derivative of (gap at the place, turn); the place itself moves with the younger line
            jacobian = np.zeros((2, len(belief.mean)))
            o, y = slots(older), slots(younger)
            side = np.array([-other[1], other[0]])
            jacobian[0, o] = flip * np.array([place @ side, -1.0])
            by_turn = lines[younger, 1] * tangent - bank.foot[younger] * normal
            jacobian[0, y] = [flip * (other @ by_turn), flip * (normal @ other)]
            jacobian[1, o[0]], jacobian[1, y[0]] = 1.0, -1.0
            residual = -np.array([gap, turn])
            spread = jacobian @ belief.covariance @ jacobian.T + np.diag([1e-4, 2.5e-5])
            if residual @ np.linalg.solve(spread, residual) < 9.0:
                return older, younger, jacobian, residual
    return None


def canonical_lines(belief: Belief) -> tuple[Array, Array]:
    """Lines with offset >= 0 and their covariances, for users."""
    lines = belief.lines
    index = slots(np.arange(len(lines)))
    covariance = belief.covariance[index[:, :, None], index[:, None, :]]
    flip = np.where(lines[:, 1] < 0, -1.0, 1.0)
    sign = np.stack([np.ones_like(flip), flip], -1)
    return canonical(lines), covariance * sign[:, :, None] * sign[:, None, :]
