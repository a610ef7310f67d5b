"""Whether lines of sight cross: what distances say that are off by the same at every step.

A filter can't tell such an offset from another place of its agent, and of everything that it maps. But two
anchors whose distances are too long put the agent at two places, whoever follows it. docs/model.md, (M262).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from typing import NamedTuple, Self

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.health import reasons
from gridslam.world.filter_model import FilterModel, fixed

TURN_RAD, MOST_OFFSET_M, MOST_HEIGHT_M = 0.05, 5.0, 3.0
"""Deviations of an anchor's orientation, and of what may be wrong at most."""
STRAY = 9.0
"""Misfit per number beyond which places can't be those of lines of sight, whatever is wrong."""
LEAST_STEPS, EVERY = 15, 5
"""Steps looked at, with two anchors or more in sight, before anything is said; how often it is weighed."""
LEAST_LOOKS = 4
"""Steps at which an anchor must have been in sight with others for its offset to be told: one may stray."""
LEAST_OFFSET_M, LEAST_HEIGHT_M = 0.3, 0.7
"""What is told of at least, as `gridslam check` does: drawings and receivers are off by less."""
CERTAIN, CLEAR, MISFIT = 20.0, 10.0, 3.0
"""Log likelihood ratio to no offset, and to the next best, in nats; misfit per number that may be left."""


class Crossing(NamedTuple):
    """Where lines of sight of one step put the agent, and how that moves with what may be wrong.

    Attributes
    ----------
    place : (n, 2) m
    precision : (n, 2, 2)
    slope : (n, 2, P)
    """

    place: Array
    precision: Array
    slope: Array


@dataclass(frozen=True)
class RangeWatch:
    """What lines of sight that cross have said of distances so far.

    Attributes
    ----------
    information : (P, P)
        About offsets (J, m), turns of anchors (J, rad) and the square of a height that the scene lacks (m^2).
    vector : (P,)
        Information times what it says.
    total : float
        Sum of squared, normalised gaps between places if nothing is wrong.
    count : float
        Numbers in it.
    steps : int
        That were looked at, with two anchors or more in sight.
    doubt : str
        What is wrong, in words; empty if nothing is.
    looks : tuple of int, J
        Steps at which each anchor was one of those; empty in files of earlier versions.
    """

    information: Array
    vector: Array
    total: float = 0.0
    count: float = 0.0
    steps: int = 0
    doubt: str = field(default="", metadata={"later": True})
    looks: tuple[int, ...] = field(default=(), metadata={"later": True})

    @classmethod
    def start(cls, anchors: int) -> Self:
        """Before anything was heard."""
        size = 2 * anchors + 1
        return cls(np.zeros((size, size)), np.zeros(size), looks=(0,) * anchors)

    def crossed(self, crossing: Crossing, model: FilterModel) -> Self:
        """Take in where lines of sight cross at a step."""
        place, precision, slope = crossing
        pull = precision @ slope  # (n, 2, P)
        whole, both = precision.sum(0), pull.sum(0)
        seen = (precision @ place[..., None])[..., 0]
        mean = np.linalg.solve(whole, seen.sum(0))
        gap = place - mean
        weighed = (precision @ gap[..., None])[..., 0]
        information = np.einsum("nip,niq->pq", slope, pull) - both.T @ np.linalg.solve(whole, both)
        vector, total = np.einsum("nip,ni->p", slope, weighed), float((gap * weighed).sum())
        count = 2 * len(place) - 2
        left = total - float(vector @ np.linalg.solve(information + _open(model.senders), vector))
        if left > STRAY * count:  # some of it came over walls
            return self
        after = replace(
            self, information=self.information + information, vector=self.vector + vector,
            total=self.total + total, count=self.count + count, steps=self.steps + 1,
            looks=self._looks(slope, model.senders),
        )  # fmt: skip
        if after.steps < LEAST_STEPS or after.steps % EVERY:
            return after
        return replace(after, doubt=after.conclusion(model))

    def _looks(self, slope: Array, anchors: int) -> tuple[int, ...]:
        """Steps at which each anchor was in sight with others, this one too, whose slopes are (n, 2, P)."""
        there = (slope[..., :anchors] != 0).any((0, 1)).tolist()
        return tuple(looks + now for looks, now in zip(self.looks or (0,) * anchors, there, strict=True))

    def conclusion(self, model: FilterModel) -> str:
        """What is wrong beyond doubt, in words."""
        fits = sorted(self._fits(model), key=lambda fit: fit.misfit)
        best, plain = fits[0], next(fit for fit in fits if not fit.columns)
        scale = max(best.misfit / self.count, 1.0)
        if best is plain or best.misfit > MISFIT * self.count:
            return ""
        if 0.5 * (plain.misfit - best.misfit) < CERTAIN * scale:
            return ""
        if 0.5 * (fits[1].misfit - best.misfit) < CLEAR * scale:
            return ""
        return _words(best, model)

    def _fits(self, model: FilterModel) -> Iterator[Fit]:
        """How well each thing that may be wrong explains the gaps, turns left open."""
        anchors = model.senders
        used = [j for j in range(anchors) if self.looks[j] >= LEAST_LOOKS]
        yield self._fit((), False)
        if used:
            yield self._fit(tuple(used), True)
        for j in used if len(used) > 1 else ():
            yield self._fit((j,), False)
        if self.information[-1, -1] > 0:
            yield self._fit((2 * anchors,), False)

    def _fit(self, columns: tuple[int, ...], alike: bool) -> Fit:
        """The fit of some entries, all `alike` or each by itself."""
        shape, prior = _thing(len(self.vector), columns, alike)
        pull = shape @ self.vector
        size_m = np.linalg.solve(shape @ self.information @ shape.T + prior, pull)
        return Fit(columns, alike, self.total - float(pull @ size_m), float(size_m[0]))


class Fit(NamedTuple):
    """How well one thing that may be wrong explains the gaps.

    Attributes
    ----------
    columns : tuple of int
        Entries of `RangeWatch`; none if nothing is wrong.
    alike : bool
        Whether it is the same for all anchors.
    misfit : float
        What is left of the squared, normalised gaps.
    size : float
        Offset, m, or square of a height, m^2.
    """

    columns: tuple[int, ...]
    alike: bool
    misfit: float
    size: float


@cache
def _open(anchors: int) -> Array:
    """Information (P, P) about what may be wrong before anything was heard."""
    std = np.repeat([MOST_OFFSET_M, TURN_RAD, MOST_HEIGHT_M**2], [anchors, anchors, 1])
    return fixed(np.diag(std**-2.0))


@lru_cache(64)
def _thing(size: int, columns: tuple[int, ...], alike: bool) -> tuple[Array, Array]:
    """What of P entries one thing that may be wrong moves, turns beside it, (D, P), and its prior (D, D)."""
    turns = np.eye(size)[size // 2 : -1]
    own = np.eye(size)[list(columns)].reshape(-1, size)
    shape = np.concatenate([own.sum(0, keepdims=True) if alike else own, turns])
    prior = np.diag([1e-9] * (len(shape) - len(turns)) + [TURN_RAD**-2] * len(turns))
    return fixed(shape), fixed(prior)


def _words(fit: Fit, model: FilterModel) -> str:
    """What is wrong, for a person; empty if it is too small to tell of."""
    if fit.columns == (2 * model.senders,):
        if fit.size < LEAST_HEIGHT_M**2:
            return ""
        return reasons.height(fit.size**0.5)
    if abs(fit.size) < LEAST_OFFSET_M:
        return ""
    whose = "all anchors" if fit.alike else f"anchor {model.anchor_names[fit.columns[0]]}"
    return reasons.offset(whose, fit.size)
