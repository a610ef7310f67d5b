"""What methods that map by surfaces hand on beside them: features of earlier maps, and paths left over.

docs/model.md, (M432).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.estimate_tables import FREE, SCATTERER, FeatureEstimate
from gridslam.inference.management.features.feature_tables import with_power
from gridslam.inference.management.features.places import Places, places_of
from gridslam.inference.management.features.surface_features import LEAST_STEPS
from gridslam.inference.scans.unexplained import Unexplained
from gridslam.maps.feature_rows import (
    ALIKE,
    ALIKE_M,
    TIED_M,
    chosen,
    numbered_after,
    of_anchor,
    own_covariance,
    stand_for,
    tied,
    together,
)
from gridslam.world.geometry import mirror, wrap

LEAST_WAY_M = 1.0
"""Way along which a place was heard before it counts as one."""
MOST_MISFIT = 4.0
"""Squared error per step, of two numbers, beyond which paths don't come from one place."""
AMBIGUOUS = 0.3
"""Deviation of a place's length, in that, unless it's a scatterer's: nothing tells it from an image."""
NEAR_M, NEAR_RAD = 0.5, 0.3
"""Within which two places say the same of a path."""


def left_features(
    known: Unexplained | None, earlier: FeatureEstimate | None, covariance: Array | None, lines: Array,
    anchors: Array, elements: int,
) -> tuple[FeatureEstimate | None, Array | None]:  # fmt: skip
    """Features that surfaces don't stand for: an earlier map's as they were, and what paths were left over.

    Parameters
    ----------
    known : Unexplained, optional
        What no surface explained.
    earlier, covariance : FeatureEstimate, (3 F, 3 F), optional
        Of an earlier map; default: each one's own covariance.
    lines : (S, 2)
        Of the surfaces that were found.
    anchors : (J, 2) m
    elements : int
        Antennas of the agent, over which amplitudes are added up.

    Returns
    -------
    (table, joint)
        None where there is nothing.
    """
    tables, squares = [], []
    if earlier is not None and len(earlier):
        joint = own_covariance(earlier) if covariance is None else covariance
        others, square = chosen(earlier, joint, np.flatnonzero(~are_images(earlier, lines)))
        tables.append(others)
        squares.append(square)
    if known is not None and len(known):
        fresh = unexplained_features(places_of(known, anchors, LEAST_STEPS), anchors, elements)
        fresh = fresh.take(~are_images(fresh, lines))
        if tables:
            fresh = numbered_after(_unlike(fresh, tables[0]), tables[0])
        tables.append(fresh)
        squares.append(own_covariance(fresh))
    table = FeatureEstimate.stack(tables)
    if not len(table):
        return (None, None) if earlier is None else (earlier.take(slice(0)), None)
    return table, together(squares)


def are_images(table: FeatureEstimate, lines: Array) -> NDArray[np.bool_]:
    """Features (F,) that can be their anchor's images in one of these lines (S, 2), or in two of them."""
    found = np.zeros(len(table), bool)
    if not len(lines):
        return found
    for n in range(len(table)):
        once = mirror(lines, table.anchor_m[n])
        twice = mirror(lines[None], once[:, None]).reshape(-1, 2)
        gap = np.column_stack(
            [table.position_m[n] - np.concatenate([once, twice]), np.zeros(len(once) + len(twice))]
        )
        gap[:, 2] = table.bias_m[n]
        square = table.covariance[n, :3, :3] + ALIKE_M**2 * np.eye(3)
        off = np.einsum("ni,ni->n", gap, np.linalg.solve(square, gap.T).T)
        found[n] = bool(off.min() < ALIKE**2)
    return found


def unexplained_features(known: Places, anchors: Array, elements: int) -> FeatureEstimate:
    """Places that were heard again and again along the agent's way, as features.

    Of two that say the same of a path, a scatterer and any other, the one that was heard more often.
    """
    (good,) = (
        (known.steps >= LEAST_STEPS) & (known.reach_m >= LEAST_WAY_M)
        & (known.misfit < MOST_MISFIT * known.steps)
    ).nonzero()  # fmt: skip
    good = good[np.lexsort((known.misfit[good], -known.steps[good]))]
    taken: list[int] = []
    for n in good.tolist():
        if not any(_say_the_same(known, n, other, anchors) for other in taken):
            taken.append(n)
    rows = [_feature(known, n, anchors[known.anchor[n]], elements) for n in taken]
    table = FeatureEstimate.stack(rows)
    return replace(table, identity=np.arange(len(table)))


def _say_the_same(known: Places, n: int, m: int, anchors: Array) -> bool:
    """Whether two places say the same of a path to where the first was heard."""
    if known.anchor[n] != known.anchor[m]:
        return False
    seen = [_path(known, row, known.agent_m[n], anchors[known.anchor[row]]) for row in (n, m)]
    far, turn = seen[0][0] - seen[1][0], wrap(seen[0][1] - seen[1][1])
    return bool(abs(far) < NEAR_M and abs(turn) < NEAR_RAD)


def _path(known: Places, n: int, agent_m: Array, anchor_m: Array) -> tuple[float, float]:
    """Length (m) and direction (rad) of a path from a place to the agent."""
    way = known.place_m[n] - agent_m
    extra = np.hypot(*(known.place_m[n] - anchor_m)) if known.tied[n] else 0.0
    return float(np.hypot(*way) + extra), float(np.arctan2(way[1], way[0]))


def _feature(known: Places, n: int, anchor_m: Array, elements: int) -> FeatureEstimate:
    """A place as a feature (a table of one row), as surely as its paths agreed, over a noise of 1."""
    square = np.zeros((3, 3))
    square[:2, :2] = known.covariance[n] * max(1.0, 0.5 * known.misfit[n] / known.steps[n]) + known.pose[n]
    extra, kind = 0.0, FREE
    if known.tied[n]:
        (extra, by_place), kind = tied(known.place_m[n], anchor_m), SCATTERER
        slope = np.zeros((3, 3))
        slope[:, :2] = by_place
        square = slope @ square @ slope.T
        square[2, 2] += TIED_M**2
    else:  # the longer it is beside its way, the nearer it is
        way = known.place_m[n] - known.agent_m[n]
        moved = np.append(-way, np.hypot(*way)) * AMBIGUOUS
        square += np.outer(moved, moved)
    power = known.power[n] / elements
    return FeatureEstimate(
        np.zeros(1, np.int64), known.anchor[[n]], anchor_m[None], known.place_m[[n]], np.array([extra]),
        np.array([power]), np.ones(1), with_power(square, power)[None], np.array([kind]), known.steps[[n]],
        known.last_step[[n]],
    )  # fmt: skip


def _unlike(fresh: FeatureEstimate, known: FeatureEstimate) -> FeatureEstimate:
    """Those features that none of the known ones of the same anchor can be."""
    return fresh.take([
        n for n in range(len(fresh))
        if not stand_for(known, np.flatnonzero(of_anchor(known, fresh.anchor_m[n])), fresh, n)
    ])  # fmt: skip
