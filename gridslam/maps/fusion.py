"""Maps of several agents made one: evidence adds up, surfaces seen twice become one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import softmax

from gridslam.errors import InputError
from gridslam.estimate_tables import SurfaceEstimate, SurfaceStretches
from gridslam.maps.feature_fusion import merge_features
from gridslam.maps.frames import refuse_lost, require_map, require_one_frame
from gridslam.maps.lattices import covering
from gridslam.maps.line_fusion import JointLines
from gridslam.maps.map import Map
from gridslam.maps.map_cells import blocks_of
from gridslam.maps.map_files import LARGEST_CELLS
from gridslam.maps.run_identity import refuse_shared_runs
from gridslam.maps.stretches import stretches_of
from gridslam.world.geometry import canonical, unit, wrap
from gridslam.world.levels import COEFFICIENTS

MERGE_MAHALANOBIS = 3.0
MERGE_DISTANCE_M = 0.5
MERGE_SLACK = np.diag([0.01, 0.01]) ** 2
"""Added to the pooled covariance of two lines: 10 mrad and 1 cm."""


def fuse(maps: Iterable[Map], same_frame: bool = False, names: Sequence[str] | None = None) -> Map:
    """Fuse maps of the same frame, made independently of one another.

    The result covers all of them, with the finest of their cells, to which the others are resampled
    (`Map.resample`). Log-likelihoods of occupancy and
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
        No map, one of a lost agent, maps whose frames differ or can't be compared, another mean free path,
        or two maps that hold the evidence of the same run, be it that one was handed over to the agent of the
        other: it would count twice.
    """
    if isinstance(maps, str) or not isinstance(maps, Iterable):
        raise InputError("fuse", type(maps).__name__, "maps, as [gs.Map.load(path), ...]")
    given = list(maps)
    if not given:
        raise InputError("fuse", "no map", "one or more maps")
    called = [f"map {number + 1}" for number in range(len(given))] if names is None else names
    for grid, name in zip(given, called, strict=True):
        require_map(grid, name)
    refuse_lost(given, called)
    require_one_frame(given, called, same_frame)
    refuse_shared_runs(given, called)
    ordered = sorted(given, key=_canonical_order)
    path = ordered[0].mean_free_path_m
    for grid in ordered:
        if abs(grid.mean_free_path_m - path) > 1e-6 * path:
            raise InputError(
                "fuse: mean free path", f"{grid.mean_free_path_m:g} m and {path:g} m", "the same in all"
            )
    finest = min(ordered, key=lambda grid: grid.cell_m)  # whose cells stay where they are
    cell, low = finest.cell_m, np.min([grid.origin_m for grid in ordered], axis=0)
    corner = np.max([grid.corner_m for grid in ordered], axis=0)
    origin, (rows, columns) = covering((finest.origin_m, cell), low, corner)
    if rows * columns > LARGEST_CELLS:
        raise InputError(
            "fuse: extent", f"{rows} x {columns} cells together", f"at most {LARGEST_CELLS} cells"
        )
    resampled = [grid.resample(origin, cell, (rows, columns)) for grid in ordered]
    surfaces, posterior, joint = merge_surfaces(ordered, 0.5 * (origin + corner))
    features, covariance = merge_features(ordered)
    return Map(
        origin,
        cell,
        np.add.reduce([one.evidence for one in resampled], dtype=np.float64),
        np.add.reduce([one.coefficient for one in resampled], dtype=np.float64),
        np.any([one.observed for one in resampled], axis=0),
        resampled[0].prior,
        surfaces,
        posterior,
        _joined([grid.provenance for grid in ordered]),
        features,
        covariance,
        joint,
        _surest(ordered),
        _stretches(ordered, surfaces),
    )


def _stretches(maps: Sequence[Map], united: SurfaceEstimate | None) -> SurfaceStretches | None:
    """Walls of maps whose cells don't tell them; None where each map's cells do, or don't know better."""
    if united is None or all(grid.stretches is None for grid in maps):
        return None
    walls = [grid.wall_segments().ends_m for grid in maps]
    return stretches_of(np.concatenate(walls), united)


def _surest(maps: Sequence[Map]) -> dict[str, np.ndarray]:
    """Of floor and ceiling the belief of the map that is surest: the prior that all have is in each."""
    found: dict[str, np.ndarray] = {}
    for belief in (dict(grid.levels) for grid in maps):
        for name, row in belief.items():
            if name not in found or _variance(row) < _variance(found[name]):
                found[name] = row
    return found


def _variance(belief: np.ndarray) -> float:
    """Of a belief over coefficients."""
    return float(belief @ COEFFICIENTS**2 - (belief @ COEFFICIENTS) ** 2)


def merge_surfaces(
    maps: Sequence[Map], centre_m: np.ndarray
) -> tuple[SurfaceEstimate | None, np.ndarray | None, np.ndarray | None]:
    """Merge surfaces that agree: Mahalanobis distance below 3 and less than 0.5 m apart.

    The surfaces of a map that knows their joint covariance are one Gaussian: where some of them are known
    better, thanks to another map, so are those that they are correlated with.

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
    joint : (2 S, 2 S) float64 or None
        Of all lines; None if no map has one.
    """
    tables = [grid.surfaces for grid in maps if grid.surfaces is not None]
    if not tables:
        return None, None, None
    rows = SurfaceEstimate.stack(tables)
    owner = np.repeat(np.arange(len(tables)), [len(table) for table in tables])
    lines = JointLines(rows.line, _together(maps)).about(centre_m)
    line, cov = lines.line, lines.own
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
    surfaces, covariance = _merged(rows, groups, lines, centre_m)
    correlated = any(grid.surface_covariance is not None for grid in maps)
    joint = covariance if correlated else None
    posteriors = [grid.surface_reflection for grid in maps if grid.surfaces is not None]
    if any(posterior is None for posterior in posteriors):
        return surfaces, None, joint
    log = np.log(np.concatenate([p for p in posteriors if p is not None]) + 1e-300)
    product = np.array([softmax(log[group].sum(axis=0)) for group in groups]).reshape(len(groups), -1)
    return surfaces, product if groups else log, joint


def _together(maps: Sequence[Map]) -> np.ndarray:
    """Covariance of the lines of all maps, which are independent of one another."""
    own = [grid.lines_covariance for grid in maps if grid.surfaces is not None]
    return np.asarray(block_diag(*(one for one in own if one.size)).reshape(sum(map(len, own)), -1))


def _facing(line: np.ndarray, cov: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """A line (2,), and its covariance, with its normal within 90 degrees of `angle`, unwrapped next to it."""
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


def _merged(
    rows: SurfaceEstimate, groups: list[list[int]], lines: JointLines, centre: np.ndarray
) -> tuple[SurfaceEstimate, np.ndarray]:
    """One surface of each group of estimates of the same wall, and the covariance of all."""
    united, moved = lines.united(groups)
    united = united.about(-centre)
    united = united.turned(moved & (united.line[:, 1] < 0))
    covariance = 0.5 * (united.covariance + united.covariance.T)
    own = blocks_of(covariance)
    merged = [
        _united(rows.take(group), united.line[g], own[g]) if moved[g] else rows.take(group)
        for g, group in enumerate(groups)
    ]
    surfaces = replace(SurfaceEstimate.stack(merged), identity=np.arange(len(groups)))
    for g in np.flatnonzero(~moved).tolist():  # as it was to the last bit
        covariance[2 * g : 2 * g + 2, 2 * g : 2 * g + 2] = surfaces.line_cov[g]
    return surfaces, covariance


def _united(rows: SurfaceEstimate, place: np.ndarray, uncertainty: np.ndarray) -> SurfaceEstimate:
    """One surface (a table of one row) at a line (2,), of estimates of the same wall."""
    along = rows.ends_m.reshape(-1, 2) @ unit(place[0] + 0.5 * np.pi)
    known = along[~np.isnan(along)]
    weight = 1 / np.maximum(rows.reflection_var, 1e-9)
    alone = len(rows) == 1
    return SurfaceEstimate.from_lines(
        canonical(place[None]),
        uncertainty[None],
        np.array([np.average(rows.reflection, weights=weight)]),
        rows.reflection_var if alone else np.array([1 / weight.sum()]),
        rows.existence if alone else np.array([1 - np.prod(1 - rows.existence)]),
        np.array([[known.min(), known.max()]]) if len(known) else None,
        owner=rows.owner if alone else None,
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
