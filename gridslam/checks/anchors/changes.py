"""What goes wrong while measuring: clocks that jump or drift, and anchors exchanged from a step on.

Told by where lines of sight of several anchors cross, so at more steps than the filter of `check` follows.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

from gridslam.checks.scene.range_words import clocks_advice
from gridslam.checks.sights.crossed import BOUNDS, Crossed, fit_of
from gridslam.checks.tables.unit_hypotheses import Suspicion
from gridslam.inference.health.range_fits import LEAST_OFFSET_M, Gaps, Thing
from gridslam.world.columns import Columns
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import Segments
from gridslam.world.radio import SPEED_OF_LIGHT

UNEXPLAINED, EXPLAINED = 0.5, 2.0
"""Misfit per number from which on anything is looked for, and up to which it is told."""
GAIN, ALIKE = 40.0, 10.0
"""Log likelihood ratios in nats: over all that doesn't change, and that tells one anchor from another."""
BREAKS, LEAST_LOOKS = 24, 12
"""Steps tried as the first wrong one, and at how many the anchor must have been in sight before and after."""
CROSSING = 1.0
"""Times as many crossings that an exchange must make: with other names fewer lines of sight cross."""
WITHOUT = 0.25
"""Share of a table without a crossing from which on anchors may be exchanged there."""


class _Change(NamedTuple):
    """How distances of an anchor go wrong.

    Attributes
    ----------
    misfit : float
    anchor : int
    since : int or None
        The first wrong step; None if they drift from the table's first one on.
    size : float
        Offset, m, or drift, m per step.
    """

    misfit: float
    anchor: int
    since: int | None
    size: float


def change(seen: Crossed, table: Columns, model: FilterModel, walls: Segments) -> Suspicion | None:
    """What has gone wrong meanwhile with one anchor or two, if it explains clearly more than what lasts.

    Parameters
    ----------
    seen : Crossed
        Where lines of sight cross by the table as it stands.
    table : dict of (K,) arrays
    walls : Segments
        The scene's.
    """
    unexplained = seen.fits[0].misfit > UNEXPLAINED * seen.numbers
    last = int(np.unique(table["step"])[: seen.heard][-1])
    misses = int(np.diff([*seen.steps, last]).max()) > WITHOUT * seen.heard
    found = _exchanged(seen, table, model, walls) if misses or unexplained else None
    return found or (_changed_clock(seen, model) if unexplained else None)


def _changed_clock(seen: Crossed, model: FilterModel) -> Suspicion | None:
    """The anchor whose distances jump or drift."""
    least = min(fit.misfit for fit in seen.fits)
    # misfits are bounded, so that they may be equal
    found = sorted([*_jumps(seen), *_drifts(seen)], key=lambda one: one.misfit)
    if not found or found[0].misfit > EXPLAINED * seen.numbers:
        return None
    best, scale = found[0], max(found[0].misfit / seen.numbers, 1.0)
    span = seen.steps[-1] - seen.steps[0] if best.since is None else 1
    if 0.5 * (least - best.misfit) < GAIN * scale or abs(best.size) * span < LEAST_OFFSET_M:
        return None
    near = [one for one in found[1:] if 0.5 * (one.misfit - best.misfit) < ALIKE * scale]
    text = "; or ".join(
        _words(one, model) for one in (best, *near) if one.anchor != best.anchor or one is best
    )
    reason = (
        f"lines of sight of two anchors or more cross at {len(seen.gaps)} steps; misfit per number "
        f"{least / seen.numbers:.1f} with what is wrong all the time, {best.misfit / seen.numbers:.1f} so"
    )
    return Suspicion("distance_m", "offset", text, not near, reason)


def _exchanged(seen: Crossed, table: Columns, model: FilterModel, walls: Segments) -> Suspicion | None:
    """The two anchors whose names are exchanged from a step on, if that explains clearly more."""
    found = []
    for pair in combinations(range(model.senders), 2):
        order = np.arange(model.senders)
        order[list(pair)] = pair[::-1]
        other = Crossed.of(table | {"anchor": order[table["anchor"]]}, model, walls)
        if other is not None:
            found.append((*_exchange(seen, other, pair), pair))
    if not found:
        return None
    gain, since, count, pair = max(found)
    if gain < GAIN:
        return None
    one, two = (model.anchor_names[number] for number in pair)
    text = (
        f"names exchanged from about step {since} on: {one} is the scene's {two}, {two} is the scene's {one}"
    )
    reason = (
        f"lines of sight of two anchors or more cross at {count} steps from there on; "
        f"log likelihood ratio {gain:.0f}"
    )
    return Suspicion("anchor", "names", text, True, reason)


def _exchange(seen: Crossed, other: Crossed, pair: tuple[int, int]) -> tuple[float, int, int]:
    """Log likelihood ratio of an exchange from the best first step on, that step, and how many tell of it."""
    costs = [_costs(one) for one in (seen, other)]
    steps = sorted(costs[0].keys() | costs[1].keys())
    own, swapped = (np.array([cost.get(step, BOUNDS[-1]) for step in steps]) for cost in costs)
    # to leave names as they are costs nothing; each later first step leaves one more as it was
    gains = 0.5 * np.append(np.cumsum((own - swapped)[::-1])[::-1], 0.0)
    first = int(gains.argmax())
    since = steps[first - 1] + 1 if first else steps[0]  # where lines of sight no longer crossed as told
    there = [
        bool(row[list(pair)].any()) and step >= since
        for step, row in zip(other.steps, other.sights, strict=True)
    ]
    before, after = (sum(step >= since for step in one.steps) for one in (seen, other))
    fits = first < len(steps) and np.median(swapped[first:]) <= EXPLAINED and after >= CROSSING * before
    enough = sum(there) >= LEAST_LOOKS and first > 0
    return (float(gains[first]) if fits and enough else 0.0), since, sum(there)


def _costs(seen: Crossed) -> dict[int, float]:
    """Misfit of each step, bounded per number, at the numbers that it has."""
    nothing = np.zeros(len(seen.gaps[0].vector))
    each = zip(seen.steps, seen.gaps, strict=True)
    return {step: min(gaps.misfit(nothing) / gaps.numbers, BOUNDS[-1]) for step, gaps in each}


def _jumps(seen: Crossed) -> list[_Change]:
    """The best first wrong step of each anchor, to within the few that are tried."""
    gaps, sights, found = seen.gaps, seen.sights, list[_Change]()
    tried = np.unique(np.linspace(LEAST_LOOKS, len(gaps) - LEAST_LOOKS, BREAKS).astype(int))
    tried = tried[(tried >= LEAST_LOOKS) & (tried < len(gaps))]
    before = {first: fit_of(gaps[:first], Thing(())).misfit for first in tried.tolist()}
    for anchor in range(sights.shape[1]):
        own = list[_Change]()
        for first, misfit in before.items():
            if min(sights[:first, anchor].sum(), sights[first:, anchor].sum()) >= LEAST_LOOKS:
                after = fit_of(gaps[first:], Thing((anchor,)))
                own.append(_Change(misfit + after.misfit, anchor, seen.steps[first], after.size[0]))
        found += [min(own)] if own else []
    return found


def _drifts(seen: Crossed) -> list[_Change]:
    """The best drift of each anchor, from the first step on."""
    found = list[_Change]()
    for anchor in np.flatnonzero(seen.sights.sum(0) >= 2 * LEAST_LOOKS).tolist():
        each = zip(seen.steps, seen.gaps, strict=True)
        growing = [_scaled(gaps, anchor, step - seen.steps[0]) for step, gaps in each]
        best = fit_of(growing, Thing((anchor,)))
        found.append(_Change(best.misfit, anchor, None, best.size[0]))
    return found


def _scaled(gaps: Gaps, entry: int, times: float) -> Gaps:
    """Gaps about an error that is `times` as large as the size that is looked for: that of a drift grows.

    Parameters
    ----------
    entry : int
        Place of the error in `Gaps.vector`.
    """
    scale = np.ones(len(gaps.vector))
    scale[entry] = times
    return gaps._replace(information=gaps.information * scale[:, None] * scale, vector=gaps.vector * scale)


def _words(best: _Change, model: FilterModel) -> str:
    name, much = model.anchor_names[best.anchor], abs(best.size)
    if best.since is None:
        way = "grow" if best.size > 0 else "shrink"
        return (
            f"distances of anchor {name} {way} by {100 * much:.1f} cm a step more than they should, as by "
            "a clock that drifts; give the scene [clocks] with anchor_prior_ns and drift_prior_ppb, or "
            "correct them"
        )
    way, cure = ("long", "subtract") if best.size > 0 else ("short", "add")
    time = f"{much / SPEED_OF_LIGHT * 1e9:.1f} ns"
    return (
        f"distances of anchor {name} are {much:.2f} m ({time}) too {way} from about step {best.since} on, "
        f"as by a clock that jumps; {cure} it there, or {clocks_advice(best.size)}"
    )
