"""Whether lines of sight cross: what distances say that are off by the same at every step, or places of
anchors that the scene has wrong.

A filter can't tell such an error from another place of its agent, and of everything that it maps. But two
anchors whose distances are too long put the agent at two places, whoever follows it. docs/model.md, (M262).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.health import reasons
from gridslam.inference.health.range_fits import (
    Crossing,
    Gaps,
    beyond_doubt,
    errors_of,
    fitted,
    things,
    words,
)
from gridslam.world.filter_model import FilterModel

LEAST_STEPS, EVERY = 15, 5
"""Steps looked at, with two anchors or more in sight, before anything is said; how often it is weighed."""
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
    most : float
        Largest sum of squared gaps of a step.
    late : tuple of RangeWatch
        The same of the latest `LATE_STEPS` full, and of those since; empty in files of earlier versions.
    """

    information: Array
    vector: Array
    total: float = 0.0
    count: float = 0.0
    steps: int = 0
    doubt: str = field(default="", metadata={"later": True})
    looks: tuple[int, ...] = field(default=(), metadata={"later": True})
    most: float = field(default=0.0, metadata={"later": True})
    late: tuple[RangeWatch, ...] = field(default=(), metadata={"later": True})

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
        if after.steps < LEAST_STEPS or after.steps % EVERY:
            return after
        return replace(after, doubt=after.conclusion(model) or after.lately(model))

    def _taken_in(self, gaps: Gaps, seen: Sequence[bool]) -> Self:
        """With the gaps of a step, and the anchors that were in sight."""
        looks = tuple(n + now for n, now in zip(self.looks or (0,) * len(seen), seen, strict=True))
        return replace(
            self, information=self.information + gaps.information, vector=self.vector + gaps.vector,
            total=self.total + gaps.total, count=self.count + gaps.numbers, steps=self.steps + 1,
            looks=looks, most=max(self.most, gaps.total),
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
        looks = tuple(a + b for a, b in zip(before.looks, now.looks, strict=True))
        both = replace(
            now, information=before.information + now.information, vector=before.vector + now.vector,
            total=before.total + now.total, count=before.count + now.count, steps=before.steps + now.steps,
            looks=looks, most=max(before.most, now.most),
        )  # fmt: skip
        said = both.conclusion(model) if before.steps else ""
        return reasons.of_late(said) if said else ""

    def conclusion(self, model: FilterModel) -> str:
        """What is wrong beyond doubt, in words."""
        gaps = Gaps(self.information, self.vector, self.total, self.count)
        fits = [fitted(gaps, thing)[0] for thing in things(self.looks, bool(self.information[-1, -1] > 0))]
        return words(beyond_doubt(fits, self.count, self.most), model)


def in_sight(slope: Array, anchors: int) -> list[bool]:
    """Which anchors are in sight at a step with slopes (n, 2, P)."""
    there: list[bool] = (slope[..., :anchors] != 0).any((0, 1)).tolist()
    return there
