"""Maps of several agents made one: evidence adds up, surfaces seen twice become one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import softmax

from gridslam.errors import InputError
from gridslam.estimates import SurfaceEstimate
from gridslam.maps.feature_fusion import merge_features
from gridslam.maps.frames import require_one_frame
from gridslam.maps.map import Map
from gridslam.maps.map_files import LARGEST_CELLS
from gridslam.maps.run_identity import refuse_shared_runs
from gridslam.world.geometry import canonical, unit, wrap

MERGE_MAHALANOBIS = 3.0
MERGE_DISTANCE_M = 0.5
MERGE_SLACK = np.diag([0.01, 0.01]) ** 2
"""Added to the pooled covariance of two lines: 10 mrad and 1 cm."""


def fuse(maps: Iterable[Map], same_frame: bool = False, names: Sequence[str] | None = None) -> Map:
    """Fuse maps of the same frame, made independently of one another.

    The result covers all of them, with the finest of their cells. Log-likelihoods of occupancy and
    reflection add up; surfaces that agree are merged, and so are learned features; lists of the provenance
    are joined. The order of `maps` makes no difference.

    Parameters
    ----------
    maps : iterable of Map
        At least one.
    same_frame : bool
        The user's word that the maps are in one frame, where they share neither an anchor nor its name.
    names : sequence of str, optional
        What errors call the maps, e.g. their files; default: by their number.

    Returns
    -------
    Map
        Its surfaces are numbered anew.

    Raises
    ------
    InputError
        No map, maps whose frames differ or can't be compared, another mean free path, grids that are not on
        one lattice, or two maps that hold the evidence of the same run, be it that one was handed over to
        the agent of the other: it would count twice.
    """
    given = list(maps)
    if not given:
        raise InputError("fuse", "no map", "one or more maps")
    called = [f"map {number + 1}" for number in range(len(given))] if names is None else names
    require_one_frame(given, called, same_frame)
    refuse_shared_runs(given, called)
    ordered = sorted(given, key=_canonical_order)
    path = ordered[0].mean_free_path_m
    for grid in ordered:
        if abs(grid.mean_free_path_m - path) > 1e-6 * path:
            raise InputError(
                "fuse: mean free path", f"{grid.mean_free_path_m:g} m and {path:g} m", "the same in all"
            )
    cell = min(grid.cell_m for grid in ordered)
    origin = np.min([grid.origin_m for grid in ordered], axis=0)
    corner = np.max([grid.corner_m for grid in ordered], axis=0)
    columns, rows = (int(n) for n in np.rint((corner - origin) / cell))
    if rows * columns > LARGEST_CELLS:
        raise InputError(
            "fuse: extent", f"{rows} x {columns} cells together", f"at most {LARGEST_CELLS} cells"
        )
    sheets = [grid.resample(origin, cell, (rows, columns)) for grid in ordered]
    surfaces, posterior = merge_surfaces(ordered, 0.5 * (origin + corner))
    features, covariance = merge_features(ordered)
    return Map(
        origin,
        cell,
        np.add.reduce([sheet.evidence for sheet in sheets], dtype=np.float64),
        np.add.reduce([sheet.coefficient for sheet in sheets], dtype=np.float64),
        np.any([sheet.observed for sheet in sheets], axis=0),
        sheets[0].prior,
        surfaces,
        posterior,
        _joined([grid.provenance for grid in ordered]),
        features,
        covariance,
    )


def merge_surfaces(
    maps: Sequence[Map], centre_m: np.ndarray
) -> tuple[SurfaceEstimate | None, np.ndarray | None]:
    """Merge surfaces that agree: Mahalanobis distance below 3 and less than 0.5 m apart.

    Parameters
    ----------
    maps : sequence of Map
        The surfaces of one map are never merged with each other.
    centre_m : (2,) float64, m
        Point about which offsets are compared: far from the walls an offset would only follow the angle.

    Returns
    -------
    surfaces : SurfaceEstimate or None
        None if no map has surfaces.
    posterior : (S, BINS) float64 or None
        None if some map with surfaces has none.
    """
    tables = [grid.surfaces for grid in maps if grid.surfaces is not None]
    if not tables:
        return None, None
    rows = SurfaceEstimate.stack(tables)
    owner = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
    line, cov = _about(rows.line, rows.line_cov, centre_m)
    groups: list[list[int]] = []
    for new in range(len(rows)):
        distances = [
            np.inf if owner[new] in owner[group] else _distance(rows, line, cov, group[0], new, centre_m)
            for group in groups
        ]
        if distances and min(distances) < MERGE_MAHALANOBIS:
            groups[int(np.argmin(distances))].append(new)
        else:
            groups.append([new])
    merged = SurfaceEstimate.stack(
        [_merged(rows.take(group), line[group], cov[group], centre_m) for group in groups]
    )
    surfaces = replace(merged, identity=np.arange(len(groups)))
    posteriors = [grid.surface_reflection for grid in maps if grid.surfaces is not None]
    if any(posterior is None for posterior in posteriors):
        return surfaces, None
    log = np.log(np.concatenate([p for p in posteriors if p is not None]) + 1e-300)
    product = np.array([softmax(log[group].sum(axis=0)) for group in groups]).reshape(len(groups), -1)
    return surfaces, product if groups else log


def _about(line: np.ndarray, cov: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lines (S, 2) and covariances (S, 2, 2) with the offset counted from `centre` instead of the origin."""
    normal, tangent = unit(line[:, 0]), unit(line[:, 0] + 0.5 * np.pi)
    jacobian = np.tile(np.eye(2), (len(line), 1, 1))
    jacobian[:, 1, 0] = -tangent @ centre
    moved = np.stack([line[:, 0], line[:, 1] - normal @ centre], axis=-1)
    return moved, jacobian @ cov @ jacobian.swapaxes(-1, -2)


def _facing(line: np.ndarray, cov: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """The same line (2,) with its normal within 90 degrees of `angle`, unwrapped next to it."""
    turn = float(wrap(line[0] - angle))
    if abs(turn) <= 0.5 * np.pi:
        return np.array([angle + turn, line[1]]), cov
    flip = np.diag([1.0, -1.0])
    return np.array([angle + float(wrap(turn + np.pi)), -line[1]]), flip @ cov @ flip


def _distance(
    rows: SurfaceEstimate, line: np.ndarray, cov: np.ndarray, old: int, new: int, centre: np.ndarray
) -> float:
    """Mahalanobis distance of two surfaces, infinite if they are too far apart."""
    other, other_cov = _facing(line[new], cov[new], line[old, 0])
    for a, b in ((old, new), (new, old)):
        foot = line[a, 1] * unit(line[a, 0])
        stretch = rows.take([a]).ends_m[0] - centre
        points = np.where(np.isnan(stretch), foot, stretch)
        if np.abs(points @ unit(line[b, 0]) - line[b, 1]).max() >= MERGE_DISTANCE_M:
            return np.inf
    difference = other - line[old]
    return float(np.sqrt(difference @ np.linalg.solve(cov[old] + other_cov + MERGE_SLACK, difference)))


def _merged(rows: SurfaceEstimate, line: np.ndarray, cov: np.ndarray, centre: np.ndarray) -> SurfaceEstimate:
    """One surface (a table of one row) from estimates of the same wall, weighted by their covariances."""
    if len(rows) == 1:
        return rows
    mean, spread = line[0], cov[0]
    for other, other_cov in zip(line[1:], cov[1:], strict=True):
        other, other_cov = _facing(other, other_cov, mean[0])
        gain = spread @ np.linalg.inv(spread + other_cov + 1e-12 * np.eye(2))
        mean, spread = mean + gain @ (other - mean), spread - gain @ spread
    place, uncertainty = _about(mean[None], spread[None], -centre)
    if place[0, 1] < 0:
        turned, uncertainty[0] = _facing(place[0], uncertainty[0], place[0, 0] + np.pi)
        place = turned[None]
    along = rows.ends_m.reshape(-1, 2) @ unit(place[0, 0] + 0.5 * np.pi)
    known = along[~np.isnan(along)]
    weight = 1 / np.maximum(rows.reflection_var, 1e-9)
    return SurfaceEstimate.from_lines(
        canonical(place),
        0.5 * (uncertainty + uncertainty.swapaxes(-1, -2)),
        np.array([np.average(rows.reflection, weights=weight)]),
        np.array([1 / weight.sum()]),
        np.array([1 - np.prod(1 - rows.existence)]),
        np.array([[known.min(), known.max()]]) if len(known) else None,
    )


def _canonical_order(grid: Map) -> tuple[str, bytes, bytes]:
    """Sorting key that makes the sums of `fuse` independent of the order of its maps, bit for bit."""
    surfaces = b"" if grid.surfaces is None else grid.surfaces.line.tobytes()
    head = repr((grid.origin_m.tolist(), grid.cell_m, sorted(grid.provenance.items())))
    return head, grid.evidence.tobytes(), surfaces


def _joined(records: Sequence[dict]) -> dict:
    """Provenance of the fused map: lists one after another, single values kept where all agree."""
    joined: dict = {}
    for key in sorted({key for record in records for key in record}):
        values = [record[key] for record in records if key in record]
        if any(isinstance(value, list) for value in values):
            joined[key] = [
                item for value in values for item in (value if isinstance(value, list) else [value])
            ]
        else:
            joined[key] = values[0] if all(value == values[0] for value in values) else values
    return joined
