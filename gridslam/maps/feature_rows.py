"""What is asked of rows of learned features: whose they are, where they stand, which of them can be one.

A joint covariance is of x, y, b (m) of all features, (3 F, 3 F), and of the angles and offsets of all lines.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from gridslam.arrays import Array
from gridslam.estimate_tables import FeatureEstimate

SAME_PLACE_M = 0.01
"""Anchors are surveyed better than this."""
ALIKE, ALIKE_M = 3.0, 0.3
"""Deviations, and metres on top, within which two images or features count as one."""
TIED_M = 0.1
"""Deviation of a scatterer's extra length from what its place says."""
ENTRIES, OF_LINE = 3, 2
"""Numbers of a feature, x, y, b; of a line, angle and offset."""
Indices = NDArray[np.int64]


class Numbered(Protocol):
    """A table whose rows keep a number."""

    @property
    def identity(self) -> np.ndarray:
        """Of every row, (n,)."""
        ...


def entries(rows: Indices, size: int = ENTRIES) -> Indices:
    """Where the numbers of these rows stand among those of all, (n size,)."""
    each: Indices = (size * rows[:, None] + np.arange(size)).ravel()
    return each


def together(squares: Iterable[Array]) -> Array:
    """Joint covariance of independent rows (n, s, s), (n s, n s); of none, (0, 0)."""
    return np.asarray(block_diag(np.zeros((0, 0)), *squares))


def own_covariance(table: FeatureEstimate) -> Array:
    """Joint covariance (3 F, 3 F) of features that are independent."""
    return together(table.covariance[:, :3, :3])


def places_and_lengths(table: FeatureEstimate) -> Array:
    """x, y, b (m) of all features, (F, 3)."""
    return np.column_stack([table.position_m, table.bias_m])


def chosen(table: FeatureEstimate, joint: Array, rows: Indices) -> tuple[FeatureEstimate, Array]:
    """Some features and the covariance of theirs."""
    each = entries(rows)
    return table.take(rows), joint[np.ix_(each, each)]


def row_of(table: Numbered, identity: int) -> int:
    """The row of a number that is in a table."""
    return int(np.flatnonzero(table.identity == identity)[0])


def numbered_after(table: FeatureEstimate, earlier: FeatureEstimate) -> FeatureEstimate:
    """A table whose features have numbers beyond those of another's."""
    return replace(table, identity=earlier.identity.max(initial=-1) + 1 + np.arange(len(table)))


def of_anchor(table: FeatureEstimate, anchor_m: Array) -> NDArray[np.bool_]:
    """Features (F,) of the anchor that stands at a place (2,), m."""
    return np.asarray(np.hypot(*(table.anchor_m - anchor_m).T) < SAME_PLACE_M)


def owners(table: FeatureEstimate, anchors: Array) -> Indices:
    """Which of some anchors (J, 2), m, each feature is of, (F,); -1: none."""
    gap = np.linalg.norm(table.anchor_m[:, None] - anchors, axis=-1).reshape(len(table), len(anchors))
    near: Indices = np.where(gap.min(1, initial=np.inf) < SAME_PLACE_M, gap.argmin(1), -1)
    return near


def stand_for(table: FeatureEstimate, rows: Indices, other: FeatureEstimate, row: int = 0) -> bool:
    """Whether some of a table's rows, of the same anchor, can be a row of another table."""
    gap = places_and_lengths(table)[rows] - places_and_lengths(other)[row]
    square = table.covariance[rows, :3, :3] + other.covariance[row, :3, :3] + ALIKE_M**2 * np.eye(3)
    off = np.einsum("ni,ni->n", gap, np.linalg.solve(square, gap[..., None])[..., 0])
    return bool((off < ALIKE**2).any())


def tied(place_m: Array, anchor_m: Array) -> tuple[float, Array]:
    """Extra length b (m) of a scatterer at a place, that to the anchor; slopes (3, 2) of x, y, b by x, y."""
    way = place_m - anchor_m
    far = float(np.hypot(*way))
    return far, np.vstack([np.eye(2), way / max(far, 1e-6)])
