"""Anchors that stand elsewhere than the scene says, by where lines of sight of several cross."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gridslam.checks.unit_hypotheses import Suspicion
from gridslam.inference.health.crossings import crossing_of
from gridslam.inference.health.range_fits import (
    Crossing,
    Fit,
    Gaps,
    Thing,
    beyond_doubt,
    fitted,
    summed,
    things,
    words,
)
from gridslam.inference.health.range_watch import LEAST_STEPS, in_sight
from gridslam.inference.state.anchor_measurements import own_deviations, split_by_anchor
from gridslam.world.columns import VALUES, Columns
from gridslam.world.filter_model import FilterModel
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene

LONGEST = 1000
"""Steps that are looked at, of a long table the first."""
RIVALS = {"offset", "slant", "start", "turned"}
"""Kinds of suspicion that another place of an anchor may stand behind."""
ENOUGH = 0.7
"""Share of the steps at which they must cross, and of what is left at most, where a turn does as well."""
BOUNDS = (1000.0, 300.0, 100.0, 30.0, 10.0, 4.0, 4.0)
"""Misfit per number beyond which steps are left out of a fit, from round to round."""
COLUMNS = (
    "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude", "distance_std_m", "aod_std_rad", "aoa_std_rad",
)  # fmt: skip
"""What a crossing is worked out of."""


def with_places(
    found: list[Suspicion], table: Columns, scene: Scene, agent: str | None, cured: Columns | None = None
) -> list[Suspicion]:
    """Suspicions against the scene, with anchors that stand elsewhere instead of them, or beside them.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.line_of_sight_filter.explain`, in the order of steps.
    cured : dict of (K,) arrays, optional
        The same as the suspicions say that it should have been.
    """
    kinds = {item.kind for item in found}
    if not table.keys() >= set(VALUES):
        return found
    if not scene.agents or scene.clocks is not None or kinds - RIVALS:
        return found  # units come first, and clocks that nobody set stand for any distance
    model = scene.filter_model(agent)
    seen = _Crossed.of(table, model)
    if seen is None or (
        "turned" in kinds and cured is not None and seen.is_behind(_Crossed.of(cured, model))
    ):
        return found
    fits = beyond_doubt(seen.fits, seen.numbers)
    text = words(fits, model) if any(fit.thing.is_shift for fit in fits) else ""
    if not text:
        return found
    plain, best = (fit.misfit / seen.numbers for fit in (seen.fits[0], fits[0]))
    reason = (
        f"lines of sight of two anchors or more cross at {len(seen.gaps)} steps; misfit per number "
        f"{plain:.1f} as it stands, {best:.1f} so"
    )
    if fits[0].thing.is_shift:
        return [Suspicion("anchor", "place", text, len(fits) == 1, reason)]
    others = [replace(item, certain=False) for item in found if item.kind not in ("offset", "slant")]
    return [Suspicion("distance_m", "offset", text, False, reason), *others]


@dataclass(frozen=True, eq=False)
class _Crossed:
    """Steps at which lines of sight cross, and how well each thing that may be wrong explains them.

    Attributes
    ----------
    gaps : list of Gaps
    fits : list of Fit
        Of nothing first.
    """

    gaps: list[Gaps]
    fits: list[Fit]

    @classmethod
    def of(cls, table: Columns, model: FilterModel) -> _Crossed | None:
        """Those of a table; None where there are too few to tell anything."""
        crossings = list(_crossings(table, model))
        if len(crossings) < LEAST_STEPS:
            return None
        gaps = [Gaps.of(crossing) for crossing in crossings]
        looks = np.sum([in_sight(crossing.slope, model.senders) for crossing in crossings], 0).tolist()
        heights = any(step.information[-1, -1] > 0 for step in gaps)
        return cls(gaps, [_fit(gaps, thing) for thing in things(looks, heights)])

    @property
    def numbers(self) -> float:
        """In all gaps."""
        return sum(step.numbers for step in self.gaps)

    def is_behind(self, cured: _Crossed | None) -> bool:
        """Whether no place of an anchor explains more than a cure does, of as many steps."""
        if cured is None:
            return False
        own = min(fit.misfit for fit in self.fits if fit.thing.is_shift or not fit.thing.columns)
        few = len(self.gaps) < ENOUGH * len(cured.gaps)
        return few or own / self.numbers > ENOUGH * cured.fits[0].misfit / cured.numbers


def _crossings(table: Columns, model: FilterModel) -> Iterator[Crossing]:
    """Where lines of sight cross at a table's steps."""
    steps, begin = np.unique(table["step"], return_index=True)
    columns = {name: table[name] for name in COLUMNS if name in table}
    for step, first, end in zip(steps[:LONGEST], begin, [*begin[1:], len(table["step"])], strict=False):
        rows = slice(first, end)
        scan = Scan(int(step), float(step), **{name: values[rows] for name, values in columns.items()})
        scans = split_by_anchor(scan, model)
        crossing = crossing_of(scans, own_deviations(scans, model.radio), model)
        if crossing is not None:
            yield crossing


def _fit(gaps: Sequence[Gaps], thing: Thing) -> Fit:
    """The fit of something that may be wrong to the steps that it explains; the others cost a bound each.

    At some steps what is taken for a line of sight came over a wall.
    """
    kept = list(gaps)
    for bound in BOUNDS:
        fit, errors = fitted(summed(kept), thing)
        kept = [step for step in gaps if step.misfit(errors) <= bound * step.numbers] or kept
    misfit = sum(min(step.misfit(errors), BOUNDS[-1] * step.numbers) for step in gaps)
    return fit._replace(misfit=misfit)
