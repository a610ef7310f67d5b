"""What may be wrong with distances and anchors, fitted to crossing lines of sight; docs/model.md, (M262)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cache, lru_cache
from typing import NamedTuple, Self

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.health import reasons
from gridslam.world.filter_model import FilterModel, fixed

TURN_RAD, MOST_OFFSET_M, MOST_SHIFT_M, MOST_HEIGHT_M = 0.05, 1.5, 1.0, 3.0
"""Deviations of an anchor's orientation, and of what may be wrong."""
STRAY = 9.0
"""Misfit per number beyond which places can't be those of lines of sight, whatever is wrong."""
LEAST_LOOKS, LEAST_LOOKS_ELSEWHERE = 4, 12
"""Steps at which an anchor must have been in sight with others for its offset to be told, and its place: one
may stray, and a few may come over the same wall."""
LEAST_OFFSET_M, LEAST_SHIFT_M, LEAST_HEIGHT_M = 0.3, 0.3, 0.7
"""What is told of at least: drawings and receivers are off by less."""
CERTAIN, CLEAR, MISFIT = 20.0, 10.0, 3.0
"""Log likelihood ratio to no error, and to the next best, in nats; misfit per number that may be left."""
SIMPLER = 10.0
"""Nats by which another place of an anchor, two numbers, must explain more than an error of one number."""
FARTHEST_M = 3.0
"""Shift beyond which what is heard of an anchor rather comes over a wall, all the time."""
MOST_NAMED = 2
"""Anchors, one of which may stand elsewhere, that are named: of two, only the way between them shows."""


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


class Gaps(NamedTuple):
    """What the gaps between such places say of what may be wrong, of a step or of several; they add up.

    Attributes
    ----------
    information : (P, P)
        About offsets (J, m), turns of anchors (J, rad), their shifts (J, 2, m) and the square of a height
        that the scene lacks (m^2); P is `errors_of` their number.
    vector : (P,)
        Information times what it says.
    total : float
        Sum of squared, normalised gaps if nothing is wrong.
    numbers : float
        In it.
    """

    information: Array
    vector: Array
    total: float
    numbers: float

    @classmethod
    def of(cls, crossing: Crossing) -> Self:
        """Those of a step, its agent's place eliminated."""
        place, precision, slope = crossing
        pull = precision @ slope  # (n, 2, P)
        whole, both = precision.sum(0), pull.sum(0)
        seen = (precision @ place[..., None])[..., 0]
        gap = place - np.linalg.solve(whole, seen.sum(0))
        weighed = (precision @ gap[..., None])[..., 0]
        information = np.einsum("nip,niq->pq", slope, pull) - both.T @ np.linalg.solve(whole, both)
        vector, total = np.einsum("nip,ni->p", slope, weighed), float((gap * weighed).sum())
        return cls(information, vector, total, 2.0 * len(place) - 2)

    def stray(self, anchors: int) -> bool:
        """Whether neither offsets, turns and a height together nor one anchor's place explain a step."""
        return min(self._left(anchors)) > STRAY * self.numbers

    def _left(self, anchors: int) -> Iterator[float]:
        turns, prior = range(anchors, 2 * anchors), _open(anchors)
        moved = np.flatnonzero(self.information[2 * anchors : -1 : 2, 2 * anchors : -1 : 2].diagonal())
        beside = [*range(2 * anchors), errors_of(anchors) - 1]
        for rows in (beside, *([*shift_of(int(j), anchors), *turns] for j in moved)):
            own = np.ix_(rows, rows)
            pull = self.vector[rows]
            yield self.total - float(pull @ np.linalg.solve(self.information[own] + prior[own], pull))

    def misfit(self, errors: Array) -> float:
        """What is left of the squared gaps with errors (P,)."""
        return self.total - float(2 * self.vector @ errors - errors @ self.information @ errors)


class Thing(NamedTuple):
    """Something that may be wrong.

    Attributes
    ----------
    columns : tuple of int
        Entries of the errors; none if nothing is wrong.
    alike : bool
        Whether they are the same for all anchors.
    """

    columns: tuple[int, ...]
    alike: bool = False

    @property
    def is_shift(self) -> bool:
        """Whether an anchor stands elsewhere."""
        return len(self.columns) == 2 and not self.alike

    def is_height(self, size: int) -> bool:
        """Whether it is a height that the scene lacks, of P errors in all."""
        return self.columns == (size - 1,)

    def anchor(self, anchors: int) -> int:
        """Which anchor a shift is of."""
        return (self.columns[0] - 2 * anchors) // 2


class Fit(NamedTuple):
    """How well one thing that may be wrong explains the gaps.

    Attributes
    ----------
    thing : Thing
    misfit : float
        What is left of the squared, normalised gaps.
    size : tuple of float
        Offset, m, or square of a height, m^2, or both numbers of a shift, m.
    """

    thing: Thing
    misfit: float
    size: tuple[float, ...]


def errors_of(anchors: int) -> int:
    """How many numbers may be wrong: P."""
    return 4 * anchors + 1


def shift_of(anchor: int, anchors: int) -> tuple[int, int]:
    """The entries of an anchor's shift."""
    first = 2 * (anchors + anchor)
    return first, first + 1


def things(looks: Sequence[int], heights: bool) -> Iterator[Thing]:
    """What may be wrong, nothing first, with anchors that were in sight with others at so many steps (J,)."""
    anchors = len(looks)
    used = [j for j in range(anchors) if looks[j] >= LEAST_LOOKS]
    yield Thing(())
    if used:
        yield Thing(tuple(used), True)
    for j in used if len(used) > 1 else ():
        yield Thing((j,))
        if looks[j] >= LEAST_LOOKS_ELSEWHERE:
            yield Thing(shift_of(j, anchors))
    if heights:
        yield Thing((errors_of(anchors) - 1,))


def fitted(
    gaps: Gaps, thing: Thing, place_std: tuple[float, ...] = (), turn_std: tuple[float, ...] = ()
) -> tuple[Fit, Array]:
    """The fit of something that may be wrong, turns left open, and the errors (P,) that it comes to.

    Parameters
    ----------
    place_std : tuple of float, J
        Deviations of the anchors' places (m): shifts that these allow for are no news; none: all are known.
    turn_std : tuple of float, J
        Those of their orientations (rad), where `TURN_RAD` isn't enough.
    """
    shape, prior = _shape(len(gaps.vector), thing, place_std, turn_std)
    pull = shape @ gaps.vector
    size = np.linalg.solve(shape @ gaps.information @ shape.T + prior, pull)
    if thing.is_height(len(gaps.vector)) and size[0] < 0:  # no height has such a square: none at all
        fit, errors = fitted(gaps, Thing(()), place_std, turn_std)
        return Fit(thing, fit.misfit, (0.0,)), errors
    own = (1 if thing.alike else len(thing.columns)) if thing.columns else 0
    return Fit(thing, gaps.total - float(pull @ size), tuple(size[:own].tolist())), shape.T @ size


def beyond_doubt(fits: Sequence[Fit], count: float) -> tuple[Fit, ...]:
    """What is wrong, the simplest first, and anchors that stand elsewhere as other readings; or nothing."""
    found = undecided(fits, count)
    return found if all(fit.thing.is_shift for fit in found[1:]) else ()


def undecided(fits: Sequence[Fit], count: float) -> tuple[Fit, ...]:
    """What is wrong, as of `beyond_doubt`, with all else that explains as much beside it."""
    scale = max(min(fit.misfit for fit in fits) / count, 1.0)
    ranked = sorted(fits, key=lambda fit: fit.misfit + 2 * SIMPLER * scale * fit.thing.is_shift)
    best, plain = ranked[0], next(fit for fit in fits if not fit.thing.columns)
    if best is plain or best.misfit > MISFIT * count:
        return ()
    if best.thing.is_shift and math.hypot(*best.size) > FARTHEST_M:  # its image by a wall
        return ()
    if 0.5 * (plain.misfit - best.misfit) < CERTAIN * scale:
        return ()
    near = [fit for fit in ranked[1:] if 0.5 * (fit.misfit - best.misfit) < CLEAR * scale]
    return (best, *(fit for fit in near if not fit.thing.is_shift or math.hypot(*fit.size) <= FARTHEST_M))


def words(found: Sequence[Fit], model: FilterModel) -> str:
    """What is wrong, for a person, with all readings; empty if it is too small to tell of."""
    if not found:
        return ""
    anchors, best = model.senders, found[0]
    shifts = [fit for fit in found if fit.thing.is_shift]
    places = [model.places[fit.thing.anchor(anchors), :2] + model.origin_m + fit.size for fit in shifts]
    names = [model.anchor_names[fit.thing.anchor(anchors)] for fit in shifts]
    elsewhere = reasons.shifted(names, places) if len(shifts) <= MOST_NAMED else reasons.ONE_ELSEWHERE
    far = any(math.hypot(*fit.size) >= LEAST_SHIFT_M for fit in shifts)
    if best.thing.is_shift:
        return elsewhere if far else ""
    (size,) = best.size
    if best.thing.is_height(errors_of(anchors)):
        text = reasons.height(size**0.5) if size >= LEAST_HEIGHT_M**2 else ""
    else:
        whose = "all anchors" if best.thing.alike else f"anchor {model.anchor_names[best.thing.columns[0]]}"
        text = reasons.offset(whose, size) if far or abs(size) >= LEAST_OFFSET_M else ""
    return f"{text}, or {elsewhere}" if text and far else text


def named_together(fits: Sequence[Fit], model: FilterModel) -> str:
    """What is wrong, with all that explains as much; empty if the best is too small to tell of."""
    shifts = sorted((fit for fit in fits if fit.thing.is_shift), key=lambda fit: fit.thing.columns)
    numbers = [fit for fit in fits if not fit.thing.is_shift]
    if not numbers or (fits[0] is numbers[0] and len(numbers) == 1):
        return words(fits, model)
    best, *others = fits
    # in the same order from look to look, so that a run's notes count them as one
    rest = sorted(others, key=lambda fit: (fit.thing.is_shift, not fit.thing.alike, fit.thing.columns))
    each = [words(shifts if fit.thing.is_shift else (fit,), model) for fit in (best, *rest)]
    return ", or ".join(dict.fromkeys(filter(None, each))) if each[0] else ""


@cache
def _open(anchors: int) -> Array:
    """Information (P, P) about what may be wrong before anything was heard."""
    each = [MOST_OFFSET_M, TURN_RAD, MOST_SHIFT_M, MOST_HEIGHT_M**2]
    std = np.repeat(each, [anchors, anchors, 2 * anchors, 1])
    return fixed(np.diag(std**-2.0))


@lru_cache(256)
def _shape(
    size: int, thing: Thing, place_std: tuple[float, ...], turn_std: tuple[float, ...]
) -> tuple[Array, Array]:
    """What of P entries one thing that may be wrong moves, turns and told shifts beside it, (D, P), and its
    prior (D, D)."""
    anchors, each = size // 4, np.eye(size)
    own = each[list(thing.columns)].reshape(-1, size)
    unsure = [j for j, std in enumerate(place_std) if std > 0]
    shifts = [column for j in unsure for column in shift_of(j, anchors)]
    shape = np.concatenate([
        own.sum(0, keepdims=True) if thing.alike else own, each[anchors : 2 * anchors], each[shifts]
    ])  # fmt: skip
    told = [place_std[j] ** -2 for j in unsure for _ in range(2)]
    free = len(shape) - anchors - len(told)
    turns = [max(TURN_RAD, std) ** -2 for std in turn_std or [0.0] * anchors]
    return fixed(shape), fixed(np.diag([1e-9] * free + turns + told))
