"""Learned features of several maps made one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gridslam.estimate_tables import FeatureEstimate
from gridslam.maps.feature_rows import SAME_PLACE_M, places_and_lengths

if TYPE_CHECKING:
    from gridslam.maps.map_cells import MapCells

MERGE_MAHALANOBIS = 3.0
SLACK_M = 0.02
"""Added to the deviations of two features' places and extra lengths."""


def merge_features(maps: Sequence[MapCells]) -> tuple[FeatureEstimate | None, np.ndarray | None]:
    """Features of all maps; those of one anchor that agree in place and extra length become one.

    Returns
    -------
    features : FeatureEstimate or None
        None if no map has any. Powers are in units of the first map's samples, by their noise.
    covariance : (3 F, 3 F) or None
        Of all together, where one map alone has features; else None: each has its own.
    """
    given = [grid for grid in maps if grid.features is not None and len(grid.features)]
    if not given:
        tables = [grid.features for grid in maps if grid.features is not None]
        return (tables[0] if tables else None), None
    first = given[0]
    assert first.features is not None
    if len(given) == 1:
        return first.features, first.feature_covariance
    level = first.features.noise[0]
    rows = FeatureEstimate.stack([_scaled(grid.features, level) for grid in given if grid.features])
    owner = np.repeat(np.arange(len(given)), [len(grid.features or ()) for grid in given])
    groups: list[list[int]] = []
    for new in range(len(rows)):
        gaps = [np.inf if owner[new] in owner[group] else _distance(rows, group[0], new) for group in groups]
        if gaps and min(gaps) < MERGE_MAHALANOBIS:
            groups[int(np.argmin(gaps))].append(new)
        else:
            groups.append([new])
    merged = FeatureEstimate.stack([_merged(rows.take(group)) for group in groups])
    return replace(merged, identity=np.arange(len(groups))), None


def _scaled(table: FeatureEstimate, level: float) -> FeatureEstimate:
    """The table in units of samples whose noise has this power, as far as its own is known."""
    ratio = level / table.noise
    ratio = np.where(np.isfinite(ratio) & (ratio > 0), ratio, 1.0)
    covariance = table.covariance.copy()
    covariance[:, 3, 3] *= ratio**2
    return replace(
        table, variance=table.variance * ratio, noise=np.full(len(table), level), covariance=covariance
    )


def _distance(rows: FeatureEstimate, old: int, new: int) -> float:
    """Mahalanobis distance of two features, infinite if they are of different anchors."""
    if np.hypot(*(rows.anchor_m[old] - rows.anchor_m[new])) > SAME_PLACE_M:
        return float(np.inf)
    place = places_and_lengths(rows)
    gap = place[new] - place[old]
    square = rows.covariance[old, :3, :3] + rows.covariance[new, :3, :3] + SLACK_M**2 * np.eye(3)
    return float(np.sqrt(gap @ np.linalg.solve(square, gap)))


def _merged(rows: FeatureEstimate) -> FeatureEstimate:
    """One feature (a table of one row) from estimates of the same, weighted by their covariances."""
    if len(rows) == 1:
        return rows
    every = places_and_lengths(rows)
    place, square = every[0], rows.covariance[0, :3, :3]
    for other, own in zip(every[1:], rows.covariance[1:, :3, :3], strict=True):
        gain = square @ np.linalg.inv(square + own + 1e-12 * np.eye(3))
        place, square = place + gain @ (other - place), square - gain @ square
    weight = np.maximum(rows.steps_seen, 1)
    covariance = np.zeros((1, 4, 4))
    covariance[0, :3, :3] = 0.5 * (square + square.T)
    covariance[0, 3, 3] = rows.covariance[:, 3, 3].min()
    most = rows.take([int(np.argmax(rows.steps_seen))])
    return replace(
        most, position_m=place[None, :2], bias_m=place[2:], covariance=covariance,
        variance=np.array([np.average(rows.variance, weights=weight)]),
        steps_seen=np.array([rows.steps_seen.sum()]), last_step=np.array([rows.last_step.max()]),
    )  # fmt: skip
