"""The bank of potential surfaces: existence, coefficient, rays; merging and pruning.

Owner of the kernel that finds duplicates.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.state.belief import AGENT, Belief, keep, slots, update
from gridslam.world.radio import REFLECTION_BINS

if TYPE_CHECKING:
    from gridslam.inference.state.polylines import Polylines
    from gridslam.inference.state.rays import Rays

Array = NDArray[np.float64]
BINS = len(REFLECTION_BINS)
FRESH_SINGLE, FRESH_DOUBLE, FRESH_BEARER = 0.5, 0.3, 0.98
"""Existence of a new surface's rays: single bounces, double bounces, and the ray that bore it."""
MOST_SURFACES = 24
CONFIRMED = ((60, 8), (25, 6), (5, 2))
"""Ages from which on a surface must have been seen so often."""
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

    def check(self, belief: Belief, places: int, sights: int) -> None:
        """Refuse a belief or anchors that this isn't the bank of: a kernel would read past its arrays."""
        count = len(self)
        if not (
            len(belief.mean) == AGENT + 2 * count
            and len(self.existence) == len(self.owner) == count
            and sights == places <= len(self.single)
            and self.single.shape[1:] == (count,)
            and self.double.shape[1:] == (count, count)
        ):
            raise ValueError("surfaces or anchors don't belong together")

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
        single, double = self.single[:, rows], self.double[:, rows][:, :, rows]
        return Bank(**chosen, single=np.ascontiguousarray(single), double=np.ascontiguousarray(double))

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
    bank.existence *= survival
    if walk:
        step = 0.5 * (walk * BINS) ** 2 * np.diff(bank.reflection)
        bank.reflection[:, :-1] += step
        bank.reflection[:, 1:] -= step
    bank.age += 1


def mark(bank: Bank, belief: Belief, rays: Rays, lines: Polylines, share: Array) -> None:
    """Remember, in place, which surfaces were seen by each anchor, and where they were hit.

    Parameters
    ----------
    lines : Polylines
        The rays as drawn at sampled states.
    share : (L,)
        Probability that the path caused a measurement, if it is possible; above one half it counts.
    """
    runtime.start()
    from gridslam.kernels.propagation.sightings import mark as launch

    rays.check(len(bank))
    if len(belief.lines) != len(bank) or not len(rays) == lines.count == len(share):
        raise ValueError("belief, bank, rays and what was drawn of them don't belong together")
    latest = runtime.scratch("latest", (len(bank),), np.int32)
    launch(belief.mean, rays.table, lines.seen, share, latest, bank.foot, bank.extent, bank.seen)


def prune(bank: Bank, belief: Belief, threshold: float) -> tuple[Bank, Belief]:
    """Drop unlikely surfaces; a birth must be confirmed by detections soon, and the number is bounded.

    Without confirmation a false birth hides: once its rays are believed blocked, no miss counts against it.
    """
    told = zip(bank.existence.tolist(), bank.age.tolist(), bank.seen.tolist(), strict=True)
    kept = [
        existence >= (max(threshold, 0.3) if age >= 3 and seen < 3 else threshold)
        and seen >= next((least for after, least in CONFIRMED if age >= after), 0)
        for existence, age, seen in told
    ]
    if all(kept) and len(kept) <= MOST_SURFACES:
        return bank, belief
    good = np.array(kept)
    if good.sum() > MOST_SURFACES:
        order = np.argsort(-bank.existence * good, kind="stable")
        good = np.zeros(len(bank), dtype=bool)
        good[order[:MOST_SURFACES]] = True
    return bank.take(good), keep(belief, good)


def merge(bank: Bank, belief: Belief) -> tuple[Bank, Belief]:
    """Merge duplicates into the older surface by the joint belief that both are one line.

    Two lines are one when they agree, within their joint covariance plus a centimetre, in angle and in
    offset at the place where the younger was hit.
    """
    runtime.start()
    from gridslam.kernels.management.tidying import duplicate

    if len(belief.lines) != len(bank):
        raise ValueError("belief and bank don't hold the same surfaces")
    for _ in range(MOST_SURFACES + 1):
        found, tie = runtime.scratch("duplicate", (2,), np.int32), runtime.scratch("tie", (2, 5))
        duplicate(belief.mean, belief.covariance, bank.foot, bank.owner, found, tie)
        older, younger = found.tolist()
        if older < 0:
            break
        jacobian = np.zeros((2, len(belief.mean)))
        jacobian[:, slots(older)], jacobian[:, slots(younger)] = tie[:, :2], tie[:, 2:4]
        belief = update(belief, jacobian, tie[None, :, 4], np.array([[1e-4, 1e-6]]), np.ones(1))
        bank.existence[older] = max(bank.existence[older], bank.existence[younger])
        bank.seen[older] = max(bank.seen[older], bank.seen[younger])
        bank.single[:, older] = np.maximum(bank.single[:, older], bank.single[:, younger])
        bank.double[:, older] = np.maximum(bank.double[:, older], bank.double[:, younger])
        bank.double[:, :, older] = np.maximum(bank.double[:, :, older], bank.double[:, :, younger])
        ends = np.stack([bank.extent[older], bank.extent[younger]])
        bank.extent[older] = [np.fmin.reduce(ends[:, 0]), np.fmax.reduce(ends[:, 1])]
        rest = np.arange(len(bank)) != younger
        bank, belief = bank.take(rest), keep(belief, rest)
    return bank, belief
