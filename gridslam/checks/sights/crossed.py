"""Where lines of sight of several anchors cross at steps of a table, and what may be wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.scene.views import in_view
from gridslam.inference.health.crossings import crossing_of
from gridslam.inference.health.range_fits import Crossing, Fit, Gaps, Thing, fitted, things
from gridslam.inference.health.range_watch import SETTLED_STEPS, in_sight
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.scans.deviations import own_deviations
from gridslam.world.columns import Columns
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import Segments, level_of, unit
from gridslam.world.scan import Scan

LONGEST = 1000
"""Steps that are looked at, of a long table the first."""
ENOUGH = 0.7
"""Share of the steps at which they must cross, and of what is left at most, where a turn does as well."""
BOUNDS = (1000.0, 300.0, 100.0, 30.0, 10.0, 4.0, 4.0)
"""Misfit per number beyond which steps are left out of a fit, from round to round."""
COLUMNS = (
    "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude", "distance_std_m", "aod_std_rad", "aoa_std_rad",
)  # fmt: skip
"""What a crossing is worked out of."""


@dataclass(frozen=True, eq=False)
class Crossed:
    """Steps at which lines of sight cross.

    Attributes
    ----------
    steps : list of int
    gaps : list of Gaps
    sights : (N, J) bool
        Which anchors were in sight.
    heard : int
        How many steps were looked at.
    place_std, turn_std : tuple of float
        Deviations of the anchors' places and orientations, see `range_fits.fitted`.
    """

    steps: list[int]
    gaps: list[Gaps]
    sights: NDArray[np.bool_]
    heard: int
    place_std: tuple[float, ...] = ()
    turn_std: tuple[float, ...] = ()

    @classmethod
    def of(cls, table: Columns, model: FilterModel, walls: Segments) -> Crossed | None:
        """Those of a table in the order of steps; None where there are too few to tell anything.

        Parameters
        ----------
        table : dict of (K,) arrays
            Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
        walls : Segments
            The scene's: what they hide is no line of sight. Among many anchors some path over a wall always
            agrees with another one's heading.
        """
        crossings = list(_crossings(table, model, walls))
        if len(crossings) < SETTLED_STEPS:
            return None
        gaps = [Gaps.of(crossing) for _, crossing in crossings]
        sights = np.array([in_sight(crossing.slope, model.senders) for _, crossing in crossings])
        return cls(
            [step for step, _ in crossings],
            gaps,
            sights,
            min(len(np.unique(table["step"])), LONGEST),
            model.place_stds,
            tuple(model.orientation_std.tolist()),
        )

    @cached_property
    def fits(self) -> list[Fit]:
        """How well each thing explains them that may be wrong all the time; nothing first."""
        heights = any(step.information[-1, -1] > 0 for step in self.gaps)
        may_be = things(self.sights.sum(0).tolist(), heights)
        return [fit_of(self.gaps, thing, self.place_std, self.turn_std) for thing in may_be]

    @property
    def numbers(self) -> float:
        """In all gaps."""
        return sum(step.numbers for step in self.gaps)

    def is_behind(self, cured: Crossed | None) -> bool:
        """Whether no place of an anchor explains more than a cure does, of as many steps."""
        if cured is None:
            return False
        own = min(fit.misfit for fit in self.fits if fit.thing.is_shift or not fit.thing.columns)
        few = len(self.gaps) < ENOUGH * len(cured.gaps)
        return few or own / self.numbers > ENOUGH * cured.fits[0].misfit / cured.numbers


def _crossings(table: Columns, model: FilterModel, walls: Segments) -> Iterator[tuple[int, Crossing]]:
    """A table's steps at which lines of sight cross, and where."""
    order = np.lexsort((table["anchor"], table["step"]))
    table = {name: values[order] for name, values in table.items()}
    clear = _clear(table, model, walls)
    steps, begin = np.unique(table["step"], return_index=True)
    columns = {name: table[name] for name in COLUMNS if name in table}
    pairs = np.unique(np.stack([table["step"], table["anchor"]])[:, clear], axis=1)
    told, anchors = np.unique(pairs[0], return_counts=True)
    cross = np.isin(steps, told[anchors > 1])  # at others fewer than two anchors can be in sight
    ends = [*begin[1:], len(table["step"])]
    for step, first, end, may in list(zip(steps, begin, ends, cross, strict=True))[:LONGEST]:
        if not may:
            continue
        rows = slice(first, end)
        scan = Scan(int(step), float(step), **{name: values[rows] for name, values in columns.items()})
        scans = split_by_anchor(scan, model)
        crossing = crossing_of(scans, own_deviations(scans, model.radio), model, clear[rows])
        if crossing is not None:
            yield int(step), crossing


def _clear(table: Columns, model: FilterModel, walls: Segments) -> NDArray[np.bool_]:
    """Which rows of a table can be lines of sight: of places that no wall hides from their anchor."""
    anchor = model.places[table["anchor"]]
    with np.errstate(invalid="ignore"):
        level = level_of(table["distance_m"], anchor[:, 3])
        place: Array = anchor[:, :2] + level[:, None] * unit(table["aod_rad"] + anchor[:, 2])
    return in_view(anchor[:, :2], place, walls)


def fit_of(
    gaps: Sequence[Gaps], thing: Thing, place_std: tuple[float, ...] = (), turn_std: tuple[float, ...] = ()
) -> Fit:
    """The fit of something that may be wrong to the steps that it explains; the others cost a bound each.

    At some steps what is taken for a line of sight came over a wall. Of deviations see `fitted`.
    """
    information, vector = (
        np.array([step.information for step in gaps]),
        np.array([step.vector for step in gaps]),
    )
    total, numbers = np.array([step.total for step in gaps]), np.array([step.numbers for step in gaps])
    kept, left = np.ones(len(gaps), dtype=bool), total
    for bound in BOUNDS:
        every = Gaps(information[kept].sum(0), vector[kept].sum(0), total[kept].sum(), numbers[kept].sum())
        fit, errors = fitted(every, thing, place_std, turn_std)
        left = total - 2 * vector @ errors + information @ errors @ errors  # `Gaps.misfit` of each step
        within = left <= bound * numbers
        kept = within if within.any() else kept
    return fit._replace(misfit=float(np.minimum(left, BOUNDS[-1] * numbers).sum()))
