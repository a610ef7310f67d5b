"""Map files: HDF5 to hand over, CSV for everything else; `nav2` has pictures for robots."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.special import logit

from gridslam.errors import InputError
from gridslam.estimate_tables import FeatureEstimate, SurfaceEstimate, SurfaceStretches
from gridslam.io.files import (
    cannot_write,
    get,
    get_attributes,
    put,
    put_attributes,
    reading_h5,
    subgroup,
    write_bytes,
    writing_h5,
)
from gridslam.maps.map_cells import LEVELS, MapCells, anchors_of
from gridslam.maps.walls import WallSegments
from gridslam.world.geometry import line_of_sfv
from gridslam.world.levels import COEFFICIENTS
from gridslam.world.radio import REFLECTION_BINS

FORMAT = "gridslam-map"
LARGEST_CELLS = 10_000_000
"""Refused above: the reflection beliefs alone would take a gigabyte."""
SURFACE_UNITS = {
    "identity": "1",
    "sfv_m": "m",
    "sfv_cov_m2": "m^2",
    "line": "rad, m",
    "line_cov": "rad^2, rad m, m^2",
    "reflection": "1",
    "reflection_var": "1",
    "existence": "1",
    "extent_m": "m",
    "owner": "1",
}
FEATURE_UNITS = {
    "identity": "1",
    "anchor": "1",
    "anchor_m": "m",
    "position_m": "m",
    "bias_m": "m",
    "variance": "sample^2",
    "noise": "sample^2",
    "covariance": "m^2, m sample^2, sample^4",
    "kind": "1",
    "steps_seen": "1",
    "last_step": "1",
}
FEATURE_TAILS: dict[str, tuple[int, ...]] = {"anchor_m": (2,), "position_m": (2,), "covariance": (4, 4)}


def write_map(grid: MapCells, path: str | os.PathLike[str]) -> None:
    """Write a map as HDF5, complete or not at all.

    ``/grid/{occupancy,observed,reflection,reflection_std}`` (ny, nx) with the attributes ``origin_m``,
    ``cell_m`` and ``prior``, beside them what a filter needs to go on: ``evidence`` (ny, nx) and, for the T
    cells with hits, ``coefficient_cell`` (T, 2) [iy, ix] and ``coefficient`` (T, BINS). ``/surfaces`` has one
    dataset per field of `SurfaceEstimate`, ``reflection_posterior`` (S, BINS) and ``joint_covariance`` (2 S,
    2 S) of all lines and, of methods without cells, ``stretch_surface`` (W,) and ``stretch_extent_m`` (W, 2);
    ``/features`` one per field of `FeatureEstimate` and ``joint_covariance`` (3 F, 3 F); ``/levels`` beliefs
    about floor and ceiling; ``/provenance`` attributes.

    Raises
    ------
    InputError
        The file can't be written.
    """
    with writing_h5(path, FORMAT) as file:
        put_map(grid, file)


def put_map(grid: MapCells, group: h5py.Group) -> None:
    """Write a map into a group of a file, as `write_map` has it."""
    cells = group.create_group("grid")
    put_attributes(
        cells, {"origin_m": grid.origin_m, "cell_m": float(grid.cell_m), "prior": float(grid.prior)}
    )
    for name in ("occupancy", "observed", "reflection", "reflection_std"):
        put(cells, name, getattr(grid, name), "1")
    put(cells, "evidence", grid.evidence, "nat")
    touched = grid.coefficient.any(axis=-1)
    put(cells, "coefficient_cell", np.argwhere(touched).astype(np.int32), "cell")
    put(cells, "coefficient", grid.coefficient[touched], "nat")
    if grid.surfaces is not None:
        surfaces = group.create_group("surfaces")
        for name, unit in SURFACE_UNITS.items():
            put(surfaces, name, getattr(grid.surfaces, name), unit)
        if grid.surface_reflection is not None:
            put(surfaces, "reflection_posterior", grid.surface_reflection, "1")
        if grid.stretches is not None:
            put(surfaces, "stretch_surface", grid.stretches.surface, "1")
            put(surfaces, "stretch_extent_m", grid.stretches.extent_m, "m")
        if grid.surface_covariance is not None:
            put(surfaces, "joint_covariance", grid.surface_covariance, SURFACE_UNITS["line_cov"])
    if grid.features is not None:
        features = group.create_group("features")
        for name, unit in FEATURE_UNITS.items():
            put(features, name, getattr(grid.features, name), unit)
        if grid.feature_covariance is not None:
            put(features, "joint_covariance", grid.feature_covariance, "m^2")
    for name, belief in grid.levels.items():
        put(group.require_group("levels"), name, belief, "1")
    put_attributes(group.create_group("provenance"), grid.provenance)


def read_map(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the fields of a `Map`; a file with the contract's datasets alone (from other software) is enough.

    Raises
    ------
    InputError
        No such file, another format or version, missing or contradicting datasets, or damaged.
    """
    with reading_h5(path, FORMAT) as file:
        return get_map(file, str(path))


def get_map(group: h5py.Group, where: str) -> dict[str, Any]:
    """The fields of a `Map` in a group of a file, see `read_map`; errors call it `where`."""
    cells = subgroup(group, "grid")
    frame: dict[str, Any] = get_attributes(cells)
    for name, kind in (("origin_m", list), ("cell_m", float), ("prior", float)):
        if not isinstance(frame.get(name), kind):
            raise InputError(f"{where}: /grid {name}", f"{frame.get(name)}", "a number (origin_m: two)")
    observed = get(cells, "observed", (None, None), "b")
    if observed.size > LARGEST_CELLS:
        raise InputError(f"{where}: /grid", f"{observed.size} cells", f"at most {LARGEST_CELLS}")
    evidence, coefficient = _read_beliefs(cells, observed, frame["prior"])
    surfaces, posterior, joint = (
        _read_surfaces(subgroup(group, "surfaces")) if "surfaces" in group else (None, None, None)
    )
    return {
        "origin_m": np.asarray(frame["origin_m"]),
        "cell_m": frame["cell_m"],
        "evidence": evidence,
        "coefficient": coefficient,
        "observed": observed,
        "prior": frame["prior"],
        "surfaces": surfaces,
        "surface_reflection": posterior,
        "surface_covariance": joint,
        "provenance": get_attributes(subgroup(group, "provenance")) if "provenance" in group else {},
        **(_read_features(group) if "features" in group else {}),
        "levels": _read_levels(group),
        "stretches": _read_stretches(group["surfaces"]) if "surfaces" in group else None,
    }


def _read_beliefs(cells: h5py.Group, observed: np.ndarray, prior: float) -> tuple[np.ndarray, np.ndarray]:
    """Evidence (ny, nx) and reflection log-likelihoods (ny, nx, BINS), from the pictures if need be."""
    cube = np.zeros((*observed.shape, len(REFLECTION_BINS)), np.float32)
    if "evidence" in cells:
        where = get(cells, "coefficient_cell", (None, 2), "i")
        rows = get(cells, "coefficient", (len(where), len(REFLECTION_BINS)), "f")
        if len(where) and (where.min() < 0 or (where >= observed.shape).any()):
            raise InputError(
                f"{cells.file.filename}: /grid/coefficient_cell", "cells off the grid", "[iy, ix]"
            )
        cube[where[:, 0], where[:, 1]] = rows
        evidence = get(cells, "evidence", observed.shape, "f")
        if not (np.isfinite(evidence).all() and np.isfinite(rows).all()):
            raise InputError(f"{cells.file.filename}: /grid", "evidence that isn't finite", "finite numbers")
        return evidence, cube
    occupancy, mean, std = (
        get(cells, name, observed.shape, "f").astype(float)
        for name in ("occupancy", "reflection", "reflection_std")
    )
    occupancy = np.where(observed & ~np.isnan(occupancy), occupancy, prior)
    evidence = logit(np.clip(occupancy, 1e-6, 1 - 1e-6)) - logit(np.clip(prior, 1e-6, 1 - 1e-6))
    hit = ~np.isnan(mean) & ~np.isnan(std)
    cube[hit] = -0.5 * ((REFLECTION_BINS - mean[hit, None]) / np.maximum(std[hit, None], 0.01)) ** 2
    return evidence, cube


def _read_surfaces(group: h5py.Group) -> tuple[SurfaceEstimate, np.ndarray | None, np.ndarray | None]:
    """Surfaces and, where stored, the posterior (S, BINS) of their coefficients and their joint covariance.

    Files of earlier versions and other software have none of the latter: their surfaces are independent.
    """
    tails = {"sfv_m": (2,), "sfv_cov_m2": (2, 2), "line": (2,), "line_cov": (2, 2), "extent_m": (2,)}
    count = len(get(group, "sfv_m", (None, 2)))
    own = ("sfv_m", "sfv_cov_m2", "reflection", "reflection_var", "existence", "extent_m")
    table = {name: get(group, name, (count, *tails.get(name, ()))) for name in own}
    if "line" in group:
        table |= {
            name: get(group, name, (count, *tails.get(name, ()))) for name in ("identity", "line", "line_cov")
        }
    else:
        line = line_of_sfv(table["sfv_m"])
        normal = np.stack([np.cos(line[:, 0]), np.sin(line[:, 0])], axis=-1)
        length = np.maximum(2 * line[:, 1], 1e-9)[:, None]
        turn = np.stack([-normal[:, 1], normal[:, 0]], axis=-1) / length
        jacobian = np.stack([turn, 0.5 * normal], axis=-2)
        cov = jacobian @ table["sfv_cov_m2"] @ jacobian.swapaxes(-1, -2)
        table |= {"identity": np.arange(count), "line": line, "line_cov": cov}
    table["owner"] = read_owner(group, count)
    posterior = (
        get(group, "reflection_posterior", (count, len(REFLECTION_BINS)), "f")
        if "reflection_posterior" in group
        else None
    )
    joint = (
        get(group, "joint_covariance", (2 * count, 2 * count), "f") if "joint_covariance" in group else None
    )
    return SurfaceEstimate(**table), posterior, joint


def _read_features(file: h5py.Group) -> dict[str, Any]:
    """Learned features and, where stored, their joint covariance.

    `identity` and `noise` may be missing, and `anchor_m` where the provenance names the anchors.
    """
    group = subgroup(file, "features")
    count = len(get(group, "position_m", (None, 2)))
    whole = ("identity", "anchor", "kind", "steps_seen", "last_step")
    table: dict[str, Any] = {"identity": np.arange(count)}
    for name in FEATURE_UNITS:
        if name in group or name not in ("identity", "noise", "anchor_m"):
            kind = "iu" if name in whole else "f"
            table[name] = get(group, name, (count, *FEATURE_TAILS.get(name, ())), kind)
    table.setdefault("noise", np.full(count, np.nan))
    for name in ("position_m", "bias_m", "variance", "covariance"):
        if not np.isfinite(table[name]).all():
            raise InputError(f"{group.file.filename}: /features/{name}", "NaN or infinity", "finite numbers")
    if (table["variance"] < 0).any() or (table["anchor"] < 0).any():
        raise InputError(f"{group.file.filename}: /features", "negative powers or anchors", "0 or more")
    if "anchor_m" not in table:
        known = get_attributes(subgroup(file, "provenance")) if "provenance" in file else {}
        place = np.array([where for _, where in anchors_of(known)], float).reshape(-1, 2)
        if count and table["anchor"].max() >= len(place):
            allowed = "anchor_m, or anchors of the provenance"
            raise InputError(f"{group.file.filename}: /features/anchor", "anchors without a place", allowed)
        table["anchor_m"] = place[table["anchor"]]
    joint = get(group, "joint_covariance", (3 * count, 3 * count)) if "joint_covariance" in group else None
    return {"features": FeatureEstimate(**table), "feature_covariance": joint}


def _read_levels(file: h5py.Group) -> dict[str, np.ndarray]:
    """Beliefs (50,) about coefficients of floor and ceiling, where stored."""
    group = subgroup(file, "levels") if "levels" in file else {}
    return {name: get(group, name, (len(COEFFICIENTS),), "f") for name in LEVELS if name in group}


def _read_stretches(group: h5py.Group) -> SurfaceStretches | None:
    """Where paths were reflected by surfaces, where stored."""
    if "stretch_surface" not in group:
        return None
    row = get(group, "stretch_surface", (None,), "i")
    return SurfaceStretches(row, get(group, "stretch_extent_m", (len(row), 2)))


def read_owner(group: h5py.Group, count: int) -> np.ndarray:
    """Owning anchors of `count` surfaces; files of earlier versions and other software have none: -1."""
    return get(group, "owner", (count,), "i") if "owner" in group else np.full(count, -1, np.int64)


def write_csv(grid: MapCells, directory: str | os.PathLike[str], walls: WallSegments) -> None:
    """Write ``cells.csv`` (observed cells by their centres), ``surfaces.csv`` and, if any, ``features.csv``.

    Surfaces have one row per stretch where there is a wall, and one without ends where there is none; of
    coefficients of which nothing was learned the cells are empty.

    Raises
    ------
    InputError
        The folder can't be written to.
    """
    folder = folder_of(directory)
    cell = np.argwhere(grid.observed)
    centre = grid.origin_m + (cell[:, ::-1] + 0.5) * grid.cell_m
    pictures = [picture[grid.observed] for picture in (grid.occupancy, grid.reflection, grid.reflection_std)]
    rows = np.column_stack([centre, *pictures])
    _csv(folder / "cells.csv", "x_m,y_m,occupancy,reflection,reflection_std", rows)
    surfaces = grid.surfaces if grid.surfaces is not None else SurfaceEstimate.empty()
    names = "identity,normal_rad,offset_m,sfv_x_m,sfv_y_m,reflection,reflection_var,existence"
    names += ",start_x_m,start_y_m,end_x_m,end_y_m"
    moments = np.column_stack([surfaces.reflection, surfaces.reflection_var])
    moments = np.where(surfaces.reflection_learned[:, None], moments, np.nan)
    columns = [surfaces.identity, surfaces.line, surfaces.sfv_m, moments]
    table = np.column_stack([*columns, surfaces.existence])
    without = np.setdiff1d(np.arange(len(surfaces)), walls.surface)
    row = np.concatenate([walls.surface, without])
    ends = np.concatenate([walls.ends_m.reshape(-1, 4), np.full((len(without), 4), np.nan)])
    order = np.argsort(row, kind="stable")
    rows = np.column_stack([table[row], ends])[order]
    _csv(folder / "surfaces.csv", names, rows)
    if grid.features is not None:
        found = grid.features
        names = "identity,anchor,anchor_x_m,anchor_y_m,x_m,y_m,bias_m,power,x_std_m,y_std_m,bias_std_m,kind"
        names += ",steps_seen"
        deviation = np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2)[:, :3], 0))
        place = [found.identity, found.anchor, found.anchor_m, found.position_m, found.bias_m]
        rest = [found.variance, deviation, found.kind, found.steps_seen]
        _csv(folder / "features.csv", names, np.column_stack([*place, *rest]))


def _csv(path: Path, names: str, rows: np.ndarray) -> None:
    buffer = io.StringIO()
    np.savetxt(buffer, rows, fmt="%.9g", delimiter=",", header=names, comments="")
    write_bytes(path, buffer.getvalue().replace("nan", "").encode("ascii"))


def file_of(path: str | os.PathLike[str]) -> Path:
    """A map's file; a run's folder stands for the map in it."""
    inside = Path(path) / "map.h5"
    return inside if inside.is_file() else Path(path)


def folder_of(directory: str | os.PathLike[str]) -> Path:
    """A folder, made if need be.

    Raises
    ------
    InputError
        It can't be made.
    """
    folder = Path(directory)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error
    return folder
