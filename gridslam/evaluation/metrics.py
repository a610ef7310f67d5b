"""How good a run is: errors of the track, distances between sets, scores of the map.

The definitions are those of ``run.json``. Whatever lacks its truth is None, never a guess.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from gridslam.errors import InputError
from gridslam.maps.map import Map
from gridslam.simulation.image_source import TruePaths
from gridslam.wording import time_span
from gridslam.world.geometry import Segments, distance_to_segments, wrap
from gridslam.world.trajectory import Trajectory

OSPA_CUTOFF_M = 5.0
DIVERGED_M = 0.5
SETTLED_STEP = 10
HITS = 10
"""True hits from which on a cell counts as a wall that the map should show."""
CUTS_AT_ONCE, CELLS_AT_ONCE = 2**18, 2**16
"""Places where legs meet grid lines, and cells whose walls are asked for, at once: some 2 MB a column."""


def rmse(error: ArrayLike) -> float:
    """Root mean square of the lengths of errors (N,) or (N, D); NaN without any."""
    error = np.asarray(error, float)
    square = error**2 if error.ndim == 1 else (error**2).sum(axis=-1)
    return float(np.sqrt(square.mean())) if len(square) else float("nan")


def p95(error: ArrayLike) -> float:
    """95th percentile of the lengths of errors (N,) or (N, D); NaN without any."""
    error = np.asarray(error, float)
    length = np.abs(error) if error.ndim == 1 else np.linalg.norm(error, axis=-1)
    return float(np.percentile(length, 95)) if len(length) else float("nan")


def diverged(position_error: ArrayLike) -> bool:
    """Whether any position error (N, 2), m, exceeds 0.5 m after step 10."""
    late = np.linalg.norm(np.asarray(position_error, float)[SETTLED_STEP + 1 :], axis=-1)
    return bool((late > DIVERGED_M).any())


def track_errors(estimate: Trajectory, truth: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Errors of a track against the truth, which is interpolated to the estimate's times.

    Returns
    -------
    position : (N, 2) float64, m
    heading : (N,) float64, rad
        Wrapped to (-pi, pi].

    Raises
    ------
    InputError
        The truth doesn't cover the estimate's times.
    """
    slack = 1e-6 * max(1.0, float(np.ptp(truth.time_s)))  # not of the times: they may count from 1970
    if estimate.time_s[0] < truth.time_s[0] - slack or estimate.time_s[-1] > truth.time_s[-1] + slack:
        found = f"times {time_span(truth.time_s[0], truth.time_s[-1])}"
        needed = time_span(estimate.time_s[0], estimate.time_s[-1])
        raise InputError("truth", found, f"at least {needed}")
    position = [np.interp(estimate.time_s, truth.time_s, coordinate) for coordinate in truth.position_m.T]
    heading = np.interp(estimate.time_s, truth.time_s, np.unwrap(truth.heading_rad))
    return estimate.position_m - np.stack(position, axis=-1), wrap(estimate.heading_rad - heading)


def ospa(estimates: ArrayLike, truth: ArrayLike, cutoff: float = 5.0, order: float = 1.0) -> float:
    """Optimal subpattern assignment distance of two point sets, normalised by the larger one.

    Parameters
    ----------
    estimates, truth : (M, D) and (N, D) float, m
    cutoff : float, m
        Largest distance that counts; also the price of a missing or a surplus point.
    order : float
        At least 1.

    Returns
    -------
    float
        Between 0 (equal sets) and `cutoff`; 0 for two empty sets.
    """
    total, _, larger = _assignment(estimates, truth, cutoff, order, cutoff**order)
    return float((total / larger) ** (1 / order)) if larger else 0.0


def gospa(estimates: ArrayLike, truth: ArrayLike, cutoff: float = 2.0, order: float = 1.0) -> float:
    """Generalised OSPA (alpha = 2): localisation errors plus ``cutoff**order / 2`` per missed or false point.

    Parameters
    ----------
    estimates, truth : (M, D) and (N, D) float, m
    cutoff : float, m
    order : float
        At least 1.
    """
    total, _, _ = _assignment(estimates, truth, cutoff, order, 0.5 * cutoff**order)
    return float(total ** (1 / order))


def _assignment(
    estimates: ArrayLike, truth: ArrayLike, cutoff: float, order: float, surplus: float
) -> tuple[float, int, int]:
    """Cheapest assignment: its cost, the sizes of the smaller and of the larger set."""
    from scipy.optimize import linear_sum_assignment

    a, b = np.atleast_2d(np.asarray(estimates, float)), np.atleast_2d(np.asarray(truth, float))
    count_a, count_b = (len(x) if x.size else 0 for x in (a, b))
    smaller, larger = sorted((count_a, count_b))
    if not smaller:
        return larger * surplus, smaller, larger
    distance = np.linalg.norm(a[:, None] - b[None], axis=-1)
    cost = np.minimum(distance, cutoff) ** order
    matched = cost[linear_sum_assignment(cost)].sum()
    return float(matched + (larger - smaller) * surplus), smaller, larger


def map_scores(grid: Map, segments: Segments, paths: TruePaths) -> dict[str, float | None]:
    """Score a map against the true walls and the cells that true paths hit and crossed.

    Returns
    -------
    dict
        ``occupied_recall``: share of the cells hit at least 10 times that are occupied within one cell.
        ``occupied_precision``: share of the occupied cells within two cells of a true wall.
        ``free_recall``: share of the cells crossed, farther than 1.5 cells from a wall, called free.
        ``free_precision``: share of the cells called free that hold no wall.
        ``auc``: of the occupancy (the prior where unobserved), over those hit and those crossed cells.
        None where a share is taken of no cell at all.
    """
    hit = hit_counts(grid, paths) >= HITS
    start, end, _ = paths.legs
    beside, near = within_walls(grid, segments, (1.5 * grid.cell_m, 2 * grid.cell_m))
    crossed = crossed_cells(grid, start, end) & ~beside
    wall = crossed_cells(grid, segments.start, segments.end)
    return {
        "occupied_precision": _share(near[grid.occupied]),
        "occupied_recall": _share(_grown(grid.occupied)[hit]),
        "free_precision": _share(~wall[grid.free]),
        "free_recall": _share(grid.free[crossed]),
        "auc": area_under_curve(_scores(grid, hit), _scores(grid, crossed)),
    }


def _scores(grid: Map, cells: np.ndarray) -> np.ndarray:
    """Occupancy of marked cells, the prior where unobserved."""
    return np.where(grid.observed[cells], grid.occupancy[cells], grid.prior)


def reflection_mae(grid: Map, segments: Segments) -> float | None:
    """Mean error of the reflection coefficients of occupied cells within two cells of a true wall.

    Each is compared with the nearest wall piece; None if there is no such cell. Walls that don't reflect
    aren't asked for.
    """
    cell = np.argwhere(grid.occupied & ~np.isnan(grid.reflection))
    if not len(cell) or not len(segments):
        return None
    centre = grid.origin_m + (cell[:, ::-1] + 0.5) * grid.cell_m
    distance = distance_to_segments(centre, segments.start, segments.end)
    near = distance.min(axis=-1) <= 2 * grid.cell_m
    truth = segments.reflection[distance.argmin(axis=-1)]
    near &= truth > 0
    if not near.any():
        return None
    return float(np.abs(grid.reflection[cell[:, 0], cell[:, 1]] - truth)[near].mean())


def area_under_curve(positive: ArrayLike, negative: ArrayLike) -> float | None:
    """Area under the ROC curve: chance that a positive scores above a negative, ties half. None if empty."""
    positive, negative = np.asarray(positive), np.sort(negative)
    if not len(positive) or not len(negative):
        return None
    below, up_to = (np.searchsorted(negative, positive, side) for side in ("left", "right"))
    return float((below.sum() + up_to.sum()) / 2 / (len(positive) * len(negative)))


def hit_counts(grid: Map, paths: TruePaths) -> np.ndarray:
    """How often true paths hit each cell: (ny, nx) int64."""
    points = paths.points[:, 1:3].reshape(-1, 2)
    cell, inside = grid.index(points)
    flat = np.ravel_multi_index(tuple(cell[inside].T), grid.shape)
    return np.bincount(flat, minlength=grid.observed.size).reshape(grid.shape)


def within_walls(grid: Map, segments: Segments, reaches_m: Sequence[float]) -> np.ndarray:
    """Cells whose centres are at most each of `reaches_m` (R,), m, from a wall: (R, ny, nx) bool."""
    x, y = (grid.origin_m[axis] + (np.arange(grid.shape[1 - axis]) + 0.5) * grid.cell_m for axis in (0, 1))
    near, rows = np.zeros((len(reaches_m), *grid.shape), bool), max(1, CELLS_AT_ONCE // grid.shape[1])
    for first in range(0, grid.shape[0], rows):
        centre = np.stack(np.meshgrid(x, y[first : first + rows]), axis=-1)
        for start, end in zip(segments.start, segments.end, strict=True):
            distance = distance_to_segments(centre, start[None], end[None])[..., 0]
            for cells, reach in zip(near, reaches_m, strict=True):
                cells[first : first + rows] |= distance <= reach
    return near


def crossed_cells(grid: Map, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Cells that straight legs (K, 2) to (K, 2), m, pass through: (ny, nx) bool, without sampling.

    A leg is cut at every grid line that it crosses; the middle of each piece lies in one cell.
    """
    crossed = np.zeros(grid.shape, bool)
    lines = [grid.origin_m[axis] + np.arange(grid.shape[1 - axis] + 1) * grid.cell_m for axis in (0, 1)]
    legs = max(1, CUTS_AT_ONCE // sum(grid.shape))  # each is cut at every line
    for first in range(0, len(start), legs):
        a, span = start[first : first + legs], (end - start)[first : first + legs]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            cuts = [(lines[axis] - a[:, axis, None]) / span[:, axis, None] for axis in (0, 1)]
        ends = np.tile([0.0, 1.0], (len(a), 1))
        share = np.sort(np.clip(np.nan_to_num(np.concatenate([ends, *cuts], axis=1)), 0, 1), axis=1)
        middle = 0.5 * (share[:, 1:] + share[:, :-1])
        whose, piece = np.nonzero(np.diff(share, axis=1) > 0)
        cell, inside = grid.index(a[whose] + middle[whose, piece][:, None] * span[whose])
        crossed[cell[inside, 0], cell[inside, 1]] = True
    return crossed


def _grown(cells: np.ndarray) -> np.ndarray:
    """Cells (ny, nx) with all their eight neighbours."""
    padded = np.pad(cells, 1)
    wide = padded[:, :-2] | padded[:, 1:-1] | padded[:, 2:]
    return wide[:-2] | wide[1:-1] | wide[2:]


def _share(flags: np.ndarray) -> float | None:
    return float(flags.mean()) if flags.size else None
