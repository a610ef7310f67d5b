"""Map files: HDF5 to hand over, CSV for everything else; `nav2` has pictures for robots."""

from __future__ import annotations

import csv
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
    get_attributes,
    put_attributes,
    reading_h5,
    subgroup,
    write_bytes,
    writing_h5,
)
from gridslam.io.foreign import begins_as, refuse_foreign_text
from gridslam.maps.map_anchors import MapAnchors
from gridslam.maps.map_cells import MapCells, anchors_of
from gridslam.maps.map_datasets import ANCHORS, FEATURES, GRID, LEVEL_BELIEFS, MAP, SURFACES
from gridslam.maps.walls import WallSegments
from gridslam.world.geometry import line_of_sfv
from gridslam.world.radio import REFLECTION_BINS

LARGEST_CELLS = 10_000_000
"""Refused above: the reflection beliefs alone would take a gigabyte."""
PICTURES = ("occupancy", "reflection", "reflection_std")
"""Of a grid, which stand for its beliefs in maps of other programs."""


def write_map(grid: MapCells, path: str | os.PathLike[str]) -> None:
    """Write a map as HDF5, complete or not at all: the datasets of `gridslam.maps.map_datasets`.

    Raises
    ------
    InputError
        The file can't be written.
    """
    with writing_h5(path, MAP.kind) as file:
        put_map(grid, file)


def put_map(grid: MapCells, group: h5py.Group) -> None:
    """Write a map into a group of a file, as `write_map` has it."""
    touched = grid.coefficient.any(axis=-1)
    cells = {name: getattr(grid, name) for name in (*PICTURES, "observed", "evidence")}
    cells |= {f"@{name}": getattr(grid, name) for name in ("origin_m", "cell_m", "prior")}
    hits = {"coefficient_cell": np.argwhere(touched), "coefficient": grid.coefficient[touched]}
    GRID.put(group, cells | hits)
    if grid.surfaces is not None:
        beside = {
            "reflection_posterior": grid.surface_reflection,
            "joint_covariance": grid.surface_covariance,
        }
        if grid.stretches is not None:
            beside |= {
                "stretch_surface": grid.stretches.surface,
                "stretch_extent_m": grid.stretches.extent_m,
            }
        SURFACES.put(group, vars(grid.surfaces) | beside)
    if grid.features is not None:
        FEATURES.put(group, vars(grid.features) | {"joint_covariance": grid.feature_covariance})
    if grid.anchors is not None:
        ANCHORS.put(group, vars(grid.anchors) | {"@names": grid.anchors.names})
    if grid.levels:
        LEVEL_BELIEFS.put(group, grid.levels)
    put_attributes(group.create_group("provenance"), grid.provenance)


def read_map(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the fields of a `Map`; a file with the contract's datasets alone (from other software) is enough.

    Raises
    ------
    InputError
        No such file, another format or version, missing or contradicting datasets, or damaged.
    """
    with reading_h5(path, MAP.kind, MAP.versions) as file:
        return get_map(file)


def get_map(group: h5py.Group) -> dict[str, Any]:
    """The fields of a `Map` in a group of a file, see `read_map`."""
    sizes: dict[str, int] = {}
    cells = GRID.get(group, sizes, ("@origin_m", "@cell_m", "@prior", "observed"))
    observed, prior = cells["observed"], cells["@prior"]
    if observed.size > LARGEST_CELLS:
        where = f"{group.file.filename}: {group.name.rstrip('/')}/grid"
        raise InputError(where, f"{observed.size} cells", f"at most {LARGEST_CELLS}")
    evidence, coefficient = _read_beliefs(group, sizes, observed, prior)
    provenance = get_attributes(subgroup(group, "provenance")) if "provenance" in group else {}
    return {
        "origin_m": cells["@origin_m"],
        "cell_m": cells["@cell_m"],
        "evidence": evidence,
        "coefficient": coefficient,
        "observed": observed,
        "prior": prior,
        "provenance": provenance,
        **(_read_surfaces(group) if "surfaces" in group else {}),
        **(_read_features(group, provenance) if "features" in group else {}),
        "anchors": _read_anchors(group) if "anchors" in group else None,
        "levels": {name: one for name, one in LEVEL_BELIEFS.get(group).items() if one is not None},
    }


def _read_beliefs(
    group: h5py.Group, sizes: dict[str, int], observed: np.ndarray, prior: float
) -> tuple[np.ndarray, np.ndarray]:
    """Evidence (ny, nx) and reflection log-likelihoods (ny, nx, BINS), from the pictures if need be."""
    cube = np.zeros((*observed.shape, len(REFLECTION_BINS)), np.float32)
    cells = GRID.get(group, sizes, ("evidence", "coefficient_cell", "coefficient"))
    if cells["evidence"] is not None:
        where, rows = (require(cells, name, group, "grid") for name in ("coefficient_cell", "coefficient"))
        if (where >= observed.shape).any():
            raise InputError(
                f"{group.file.filename}: /grid/coefficient_cell", "cells off the grid", "[iy, ix]"
            )
        cube[where[:, 0], where[:, 1]] = rows
        return cells["evidence"], cube
    pictures = GRID.get(group, sizes, PICTURES)
    occupancy, mean, std = (require(pictures, name, group, "grid").astype(float) for name in PICTURES)
    occupancy = np.where(observed & ~np.isnan(occupancy), occupancy, prior)
    evidence = logit(np.clip(occupancy, 1e-6, 1 - 1e-6)) - logit(np.clip(prior, 1e-6, 1 - 1e-6))
    hit = ~np.isnan(mean) & ~np.isnan(std)
    cube[hit] = -0.5 * ((REFLECTION_BINS - mean[hit, None]) / np.maximum(std[hit, None], 0.01)) ** 2
    return evidence, cube


def require(found: dict[str, Any], name: str, group: h5py.Group, of: str) -> np.ndarray:
    """What was read under a name, which has to be there because something else is, or isn't."""
    if found[name] is None:
        where = f"{group.file.filename}: {group.name.rstrip('/')}/{of}/{name}"
        raise InputError(where, "no dataset", "a dataset of this name")
    return np.asarray(found[name])


def surfaces_of(found: dict[str, Any]) -> SurfaceEstimate:
    """Surfaces as their datasets have them; lines of files of other software follow from feature vectors."""
    table = {name: found[name] for name in SurfaceEstimate.columns()}
    count = len(table["sfv_m"])
    if table["identity"] is None:
        table["identity"] = np.arange(count)
    if table["line"] is None:
        table["line"] = line_of_sfv(table["sfv_m"])
    if table["line_cov"] is None:
        line = line_of_sfv(table["sfv_m"])
        normal = np.stack([np.cos(line[:, 0]), np.sin(line[:, 0])], axis=-1)
        length = np.maximum(2 * line[:, 1], 1e-9)[:, None]
        turn = np.stack([-normal[:, 1], normal[:, 0]], axis=-1) / length
        jacobian = np.stack([turn, 0.5 * normal], axis=-2)
        table["line_cov"] = jacobian @ table["sfv_cov_m2"] @ jacobian.swapaxes(-1, -2)
    if table["owner"] is None:
        table["owner"] = np.full(count, -1, np.int64)
    return SurfaceEstimate(**table)


def _read_surfaces(group: h5py.Group) -> dict[str, Any]:
    """Surfaces and, where stored, posteriors of coefficients, joint covariance and stretches."""
    found = SURFACES.get(group)
    stretches = None
    if found["stretch_surface"] is not None:
        extent = require(found, "stretch_extent_m", group, "surfaces")
        stretches = SurfaceStretches(found["stretch_surface"], extent)
    return {
        "surfaces": surfaces_of(found),
        "surface_reflection": found["reflection_posterior"],
        "surface_covariance": found["joint_covariance"],
        "stretches": stretches,
    }


def _read_features(group: h5py.Group, provenance: dict[str, Any]) -> dict[str, Any]:
    """Learned features and, where stored, their joint covariance.

    `identity` and `noise` may be missing, and `anchor_m` where the provenance names the anchors.
    """
    found = FEATURES.get(group)
    table = {name: found[name] for name in FeatureEstimate.columns()}
    count = len(table["position_m"])
    if table["identity"] is None:
        table["identity"] = np.arange(count)
    if table["noise"] is None:
        table["noise"] = np.full(count, np.nan)
    if table["anchor_m"] is None:
        place = np.array([where for _, where in anchors_of(provenance)], float).reshape(-1, 2)
        if count and table["anchor"].max() >= len(place):
            allowed = "anchor_m, or anchors of the provenance"
            raise InputError(f"{group.file.filename}: /features/anchor", "anchors without a place", allowed)
        table["anchor_m"] = place[table["anchor"]]
    return {"features": FeatureEstimate(**table), "feature_covariance": found["joint_covariance"]}


def _read_anchors(group: h5py.Group) -> MapAnchors:
    """Where anchors stand, as it was learned with the surfaces."""
    found = ANCHORS.get(group)
    return MapAnchors(found.pop("@names"), **found)


def write_csv(grid: MapCells, directory: str | os.PathLike[str], walls: WallSegments) -> None:
    """Write ``cells.csv`` (observed cells by their centres), ``surfaces.csv`` and, if any, ``features.csv``
    and ``anchors.csv``.

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
    if grid.anchors is not None:
        _anchors_csv(grid.anchors, folder / "anchors.csv")


def _anchors_csv(anchors: MapAnchors, path: Path) -> None:
    buffer = io.StringIO()
    rows = csv.writer(buffer, lineterminator="\n")
    names = "anchor,x_m,y_m,orientation_rad,x_std_m,y_std_m,orientation_std_rad"
    rows.writerow(names.split(","))
    for name, *numbers in zip(anchors.names, *anchors.columns, strict=True):
        rows.writerow([name, *(f"{number:.12g}" for number in numbers)])
    refuse_foreign_text(path, "a folder without tables of others", begins_as(names))
    write_bytes(path, buffer.getvalue().encode())


def _csv(path: Path, names: str, rows: np.ndarray) -> None:
    buffer = io.StringIO()
    np.savetxt(buffer, rows, fmt="%.12g", delimiter=",", header=names, comments="")
    refuse_foreign_text(path, "a folder without tables of others", begins_as(names))
    write_bytes(path, buffer.getvalue().replace("nan", "").encode("ascii"))


def file_of(path: str | os.PathLike[str]) -> Path:
    """A map's file; a run's folder stands for the map in it."""
    inside = Path(path) / "map.h5"
    return inside if inside.is_file() or Path(path).is_dir() else Path(path)


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
