"""All estimates of a run over time, in one HDF5 file."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import TypeVar

import h5py
import numpy as np

from gridslam.errors import InputError
from gridslam.estimate_tables import HypothesisEstimate, PathEstimate, RingEstimate, SurfaceEstimate
from gridslam.estimates import Estimate
from gridslam.io.files import get, put, reading_h5, subgroup, writing_h5
from gridslam.maps.map_files import SURFACE_UNITS, read_owner

FORMAT = "gridslam-steps"
STEP_UNITS = {
    "step": "1",
    "time_s": "s",
    "position_m": "m",
    "velocity_mps": "m/s",
    "heading_rad": "rad",
    "covariance": "m^2, m^2/s, m rad, (m/s)^2, rad m/s, rad^2",
    "effective_sample_size": "1",
}
PATH_UNITS = {
    "anchor": "1",
    "surfaces": "1",
    "distance_m": "m",
    "aod_rad": "rad",
    "aoa_rad": "rad",
    "amplitude": "1",
    "existence": "1",
    "points": "m",
}
HYPOTHESIS_UNITS = {
    "weight": "1",
    "position_m": "m",
    "heading_rad": "rad",
    "position_cov_m2": "m^2",
    "surface_count": "1",
}
RING_UNITS = {"ring": "1", "anchor": "1", "existence": "1", "weight": "1", "position_m": "m"}
HEIGHTS = ("agent", "floor", "ceiling")
Pair = tuple[float, float]
Rows = TypeVar("Rows", HypothesisEstimate, RingEstimate)
TAILS = {
    "position_m": (2,),
    "velocity_mps": (2,),
    "covariance": (5, 5),
    "position_cov_m2": (2, 2),
    "sfv_m": (2,),
    "sfv_cov_m2": (2, 2),
    "line": (2,),
    "line_cov": (2, 2),
    "extent_m": (2,),
    "surfaces": (2,),
    "points": (4, 2),
}


def write_steps(path: str | os.PathLike[str], estimates: Sequence[Estimate]) -> None:
    """Write all estimates over time as HDF5.

    ``/steps/<name>`` has one row per step; ``/surfaces/<name>``, ``/paths/<name>`` and ``/hypotheses/<name>``
    hold the rows of all steps below one another, those of step ``n`` from ``offset[n]`` up to
    ``offset[n + 1]``; so does ``/rings/<name>``, where there are any. ``/heights/<name>`` has heights and
    their deviations, where they were unknown. How long a step took is left out, so that a run repeated gives
    the same file.

    Raises
    ------
    InputError
        The file can't be written.
    """
    with writing_h5(path, FORMAT) as file:
        steps, surfaces, paths = (file.create_group(name) for name in ("steps", "surfaces", "paths"))
        for name, unit in STEP_UNITS.items():
            rows = np.array([getattr(e, name) for e in estimates], np.int64 if name == "step" else np.float64)
            put(steps, name, rows.reshape(len(estimates), *TAILS.get(name, ())), unit)
        all_surfaces = SurfaceEstimate.stack([estimate.surfaces for estimate in estimates])
        all_paths = PathEstimate.stack([estimate.paths for estimate in estimates])
        put(surfaces, "offset", np.cumsum([0, *(len(e.surfaces) for e in estimates)]), "1")
        put(paths, "offset", np.cumsum([0, *(len(e.paths) for e in estimates)]), "1")
        detected = [np.zeros(0, bool), *(np.asarray(e.detected, bool) for e in estimates)]
        put(surfaces, "detected", np.concatenate(detected), "1")
        for name, unit in SURFACE_UNITS.items():
            put(surfaces, name, getattr(all_surfaces, name), unit)
        for name, unit in PATH_UNITS.items():
            put(paths, name, getattr(all_paths, name), unit)
        _write_tables(
            file, "hypotheses", HypothesisEstimate, HYPOTHESIS_UNITS, [e.hypotheses for e in estimates]
        )
        if any(len(e.rings) for e in estimates):
            _write_tables(file, "rings", RingEstimate, RING_UNITS, [e.rings for e in estimates])
        _write_pairs(file, "heights", [e.heights for e in estimates], "m")
        _write_pairs(file, "coefficients", [e.coefficients for e in estimates], "1")


def read_steps(path: str | os.PathLike[str]) -> list[Estimate]:
    """Read estimates written by `write_steps`.

    Raises
    ------
    InputError
        No such file, another format or version, contradicting datasets, or damaged.
    """
    with reading_h5(path, FORMAT) as file:
        steps, surfaces, paths = (subgroup(file, name) for name in ("steps", "surfaces", "paths"))
        count = len(get(steps, "step", (None,), "iu"))
        rows = _columns(steps, STEP_UNITS, count)
        surface_at, path_at = (_offsets(group, count) for group in (surfaces, paths))
        total, lines = int(surface_at[-1]), int(path_at[-1])
        own = [name for name in SURFACE_UNITS if name != "owner"]
        table = {name: get(surfaces, name, (total, *TAILS.get(name, ()))) for name in own}
        table["owner"] = read_owner(surfaces, total)
        route = _columns(paths, PATH_UNITS, lines)
        detected = get(surfaces, "detected", (total,), "b")
        rivals = _read_tables(file, "hypotheses", HypothesisEstimate, HYPOTHESIS_UNITS, count)
        unknown = _read_tables(file, "rings", RingEstimate, RING_UNITS, count)
        tall, reflected = (_read_pairs(file, group, count) for group in ("heights", "coefficients"))
    all_surfaces, all_paths = SurfaceEstimate(**table), PathEstimate(**route)
    return [
        Estimate(
            int(rows["step"][n]),
            float(rows["time_s"][n]),
            rows["position_m"][n],
            rows["velocity_mps"][n],
            float(rows["heading_rad"][n]),
            rows["covariance"][n],
            all_surfaces.take(slice(surface_at[n], surface_at[n + 1])),
            all_paths.take(slice(path_at[n], path_at[n + 1])),
            detected[surface_at[n] : surface_at[n + 1]],
            float(rows["effective_sample_size"][n]),
            math.nan,
            hypotheses=rivals[n],
            heights=tall[n],
            coefficients=reflected[n],
            rings=unknown[n],
        )
        for n in range(count)
    ]


def _write_tables(
    file: h5py.File, name: str, kind: type[Rows], units: dict[str, str], tables: list[Rows]
) -> None:
    """Tables of all steps below one another, and where each begins."""
    group, whole = file.create_group(name), kind.stack(tables)
    put(group, "offset", np.cumsum([0, *map(len, tables)]), "1")
    for column, unit in units.items():
        put(group, column, getattr(whole, column), unit)


def _read_tables(
    file: h5py.File, name: str, kind: type[Rows], units: dict[str, str], count: int
) -> list[Rows]:
    """The tables of every step; empty ones where a file holds none."""
    if name not in file:
        return [kind.empty()] * count
    group = subgroup(file, name)
    offset = _offsets(group, count)
    rows = int(offset[-1])
    whole = kind(**_columns(group, units, rows))
    return [whole.take(slice(offset[n], offset[n + 1])) for n in range(count)]


def _columns(group: h5py.Group, units: dict[str, str], rows: int) -> dict[str, np.ndarray]:
    return {column: get(group, column, (rows, *TAILS.get(column, ()))) for column in units}


def _write_pairs(file: h5py.File, name: str, steps: Sequence[Mapping[str, Pair]], unit: str) -> None:
    """Heights or coefficients and their deviations, of those that are known of at every step."""
    known = [what for what in HEIGHTS if all(what in step for step in steps)]
    if any(steps):
        group = file.create_group(name)
        for what in known:
            put(group, what, np.array([step[what] for step in steps]), unit)


def _read_pairs(file: h5py.File, name: str, count: int) -> list[dict[str, Pair]]:
    """Heights or coefficients of every step and their deviations; none where a file holds none."""
    if name not in file:
        return [{}] * count
    group = subgroup(file, name)
    rows = {what: get(group, what, (count, 2)).tolist() for what in HEIGHTS if what in group}
    return [{what: (row[n][0], row[n][1]) for what, row in rows.items()} for n in range(count)]


def _offsets(group: h5py.Group, count: int) -> np.ndarray:
    offset = get(group, "offset", (count + 1,), "iu")
    if offset[0] != 0 or (np.diff(offset) < 0).any():
        found = f"{group.file.filename}: offset"
        raise InputError(found, "offsets that fall", "offsets from 0 that never fall")
    return offset
