"""Whether lines of sight cross: what distances say that are off by the same at every step, or places of
anchors that the scene has wrong.

A filter can't tell such an error from another place of its agent, and of everything that it maps. But two
anchors whose distances are too long put the agent at two places, whoever follows it. docs/model.md, (M262),
(M537).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from operator import sub
from typing import Self

import numpy as np

from gridslam.arrays import LATER, Array
from gridslam.inference.health import reasons
from gridslam.inference.health.range_fits import (
    Crossing,
    Fit,
    Gaps,
    beyond_doubt,
    errors_of,
    fitted,
    named_together,
    things,
    undecided,
)
from gridslam.world.filter_model import FilterModel

LEAST_STEPS, SETTLED_STEPS, EVERY = 6, 15, 5
"""Steps looked at, with two anchors or more in sight, before anything is said; up to which it is weighed at
each of them, and how often from then on."""
LATE_STEPS = 8
"""Steps looked at of the first half of what was heard of late, and of the second at most: clocks jump."""


@dataclass(frozen=True)
class RangeWatch:
    """What lines of sight that cross have said of distances so far.

    Attributes
    ----------
    information, vector, total, count
        Of all gaps so far, see `Gaps`.
    steps : int
        That were looked at, with two anchors or more in sight.
    doubt : str
        What is wrong, in words; empty if nothing is.
    looks : tuple of int, J
        Steps at which each anchor was one of those; empty in files of earlier versions.
    loudest : tuple of RangeWatch
        The same of the step of the largest gaps alone; none in files of earlier versions, and before any.
    late : tuple of RangeWatch
        The same of the latest `LATE_STEPS` full, and of those since; empty in files of earlier versions.
    """

    information: Array
    vector: Array
    total: float = 0.0
    count: float = 0.0
    steps: int = 0
    doubt: str = field(default="", metadata=LATER)
    looks: tuple[int, ...] = field(default=(), metadata=LATER)
    loudest: tuple[RangeWatch, ...] = field(default=(), metadata=LATER)
    late: tuple[RangeWatch, ...] = field(default=(), metadata=LATER)

    @classmethod
    def start(cls, anchors: int) -> Self:
        """Before anything was heard."""
        size = errors_of(anchors)
        return cls(np.zeros((size, size)), np.zeros(size), looks=(0,) * anchors)

    def crossed(self, crossing: Crossing, model: FilterModel) -> Self:
        """Take in where lines of sight cross at a step."""
        gaps = Gaps.of(crossing)
        if gaps.stray(model.senders):  # some came over walls
            return self
        seen = in_sight(crossing.slope, model.senders)
        after = replace(self._taken_in(gaps, seen), late=self._late(gaps, seen))
        if after.steps < LEAST_STEPS or (after.steps > SETTLED_STEPS and after.steps % EVERY):
            return after
        doubt = after.conclusion(model) or after.lately(model) or after.conclusion(model, decided=False)
        return replace(after, doubt=doubt)

    def _taken_in(self, gaps: Gaps, seen: Sequence[bool]) -> Self:
        """With the gaps of a step, and the anchors that were in sight."""
        one = RangeWatch(*gaps, steps=1, looks=tuple(map(int, seen)))
        return self._joined(replace(one, loudest=(one,)))

    def _joined(self, other: RangeWatch) -> Self:
        """With what others say."""
        looks = tuple(a + b for a, b in zip(self.looks or (0,) * len(other.looks), other.looks, strict=True))
        loudest = max([*self.loudest, *other.loudest], key=lambda one: one.total, default=None)
        return replace(
            self, information=self.information + other.information, vector=self.vector + other.vector,
            total=self.total + other.total, count=self.count + other.count, steps=self.steps + other.steps,
            looks=looks, loudest=() if loudest is None else (loudest,),
        )  # fmt: skip

    def _late(self, gaps: Gaps, seen: Sequence[bool]) -> tuple[RangeWatch, ...]:
        """What was heard of late, with the gaps of a step."""
        none = RangeWatch.start(len(seen))
        before, now = self.late or (none, none)
        now = now._taken_in(gaps, seen)
        return (now, none) if now.steps == LATE_STEPS else (before, now)

    def lately(self, model: FilterModel) -> str:
        """What has been wrong of late beyond doubt, in words: all of it may be right and wrong in turn."""
        before, now = self.late
        both = now._joined(before)
        said = both.conclusion(model) if before.steps else ""
        return reasons.of_late(said) if said else ""

    def conclusion(self, model: FilterModel, decided: bool = True) -> str:
        """What is wrong beyond doubt, in words.

        Parameters
        ----------
        decided : bool
            Whether only one thing may be; otherwise all that explain as much are named.
        """
        found = self._found(self._gaps, decided, model.place_stds)
        for one in self.loudest if found else ():  # which may be of paths over walls
            without = self._found(Gaps(*map(sub, self._gaps, one._gaps)), decided, model.place_stds)
            found = found if without and without[0].thing == found[0].thing else ()
        return named_together(found, model)

    @property
    def _gaps(self) -> Gaps:
        return Gaps(self.information, self.vector, self.total, self.count)

    def _found(self, gaps: Gaps, decided: bool, place_std: tuple[float, ...]) -> tuple[Fit, ...]:
        """What is wrong by the gaps of all steps, or of all but one, see `fitted`."""
        if gaps.numbers < 1:
            return ()
        may_be = things(self.looks, bool(self.information[-1, -1] > 0))
        fits = [fitted(gaps, thing, place_std)[0] for thing in may_be]
        return (beyond_doubt if decided else undecided)(fits, gaps.numbers)


def in_sight(slope: Array, anchors: int) -> list[bool]:
    """Which anchors are in sight at a step with slopes (n, 2, P)."""
    there: list[bool] = (slope[..., :anchors] != 0).any((0, 1)).tolist()
    return there
