"""HDF5 files of measurement tables."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np

from gridslam.errors import InputError
from gridslam.io.files import get, put, reading_h5, subgroup, writing_h5
from gridslam.measurements.simulated import simulated_of
from gridslam.world.columns import ONE_AGENT, OPTIONAL, UNITS, VALUES, Columns, check_columns
from gridslam.world.trajectory import Trajectory

KIND, VERSIONS = "gridslam-measurements", (1, 2)


def write_h5(path: str | os.PathLike[str], columns: Columns, table: Mapping[str, Any]) -> None:
    """Write a table with its anchors, number of steps, interval and truth as HDF5.

    It is version 1, which earlier versions read, unless labels or the sign of distances ask for version 2.
    """
    version = 2 if table["unlabelled"] or table["pseudo"] else 1
    with writing_h5(path, KIND, version) as file:
        put_rows(file, columns, table)
        if table["truth"] is not None:
            put_track(file.create_group("truth"), table["truth"])


def put_rows(file: h5py.File, columns: Columns, table: Mapping[str, Any]) -> None:
    """Write rows and anchors of a table into an open file."""
    rows = file.create_group("measurements")
    rows.attrs["steps"], rows.attrs["interval_s"] = table["steps"], table["interval_s"]
    for name in ("unlabelled", "pseudo"):
        if table[name]:
            rows.attrs[name] = True
    if table["simulated"] is not None:
        table["simulated"].put(rows)
    for name, values in columns.items():
        put(rows, name, values, UNITS[name])
    anchors = file.create_group("anchors")
    put(anchors, "name", np.array(table["anchors"], dtype=h5py.string_dtype()), "text")
    if table["anchor_position_m"] is not None:
        put(anchors, "position_m", table["anchor_position_m"], "m")
    if table["anchor_orientation_rad"] is not None:
        put(anchors, "orientation_rad", table["anchor_orientation_rad"], "rad")


def put_track(group: h5py.Group, track: Trajectory) -> None:
    """Write a true track into a group."""
    for name, unit in (("time_s", "s"), ("position_m", "m"), ("velocity_mps", "m/s"), ("heading_rad", "rad")):
        put(group, name, getattr(track, name), unit)
    if track.height_m is not None:
        put(group, "height_m", track.height_m, "m")


def read_h5(path: str | os.PathLike[str], checked: bool = True) -> dict[str, Any]:
    """Read and check an HDF5 table: all arguments of `Measurements` (the columns that the file has).

    Parameters
    ----------
    path : path
    checked : bool
        Whether the content of the rows is checked too.

    Raises
    ------
    InputError
        Not such a file, cut short, columns that don't match or any fault of a row.
    """
    with reading_h5(path, KIND, VERSIONS) as file:
        if "agents" in file and len(get(subgroup(file, "agents"), "name", (None,), "O")) != 1:
            found = f"{len(file['agents/name'])} agents"
            raise InputError(f"{path}: /agents", found, ONE_AGENT)
        rows, table = get_rows(file, str(path), checked)
        rows.pop("agent", None)
        if "truth" in file:
            truth = subgroup(file, "truth")
            tracks = [name for name in truth if name != "clocks" and isinstance(truth[name], h5py.Group)]
            table["truth"] = get_track(subgroup(truth, tracks[0]) if tracks else truth)
        return table | rows


def get_rows(file: h5py.File, path: str, checked: bool = True) -> tuple[Columns, dict[str, Any]]:
    """Rows and anchors of an open file: its columns, and other arguments of `Measurements`.

    Raises
    ------
    InputError
        Columns that don't match, or any fault of a row.
    """
    group, rows = subgroup(file, "anchors"), subgroup(file, "measurements")
    names = tuple(name.decode("utf-8") for name in get(group, "name", (None,), "O"))
    if not names:
        raise InputError(f"{path}: /anchors/name", "no anchors", "at least one")
    count = len(get(rows, "step", (None,), "iu"))
    keys = ("step", "anchor", *(["agent"] if "agent" in rows else []))
    columns = {name: get(rows, name, (count,), "iu") for name in keys}
    present = [name for name in (*VALUES, *OPTIONAL) if name in rows]
    if not set(present) & set(VALUES):
        raise InputError(f"{path}: /measurements", "no measured column", f"at least one of {VALUES}")
    for name in ("time_s", *present):
        columns[name] = get(rows, name, (count,)).astype(np.float64)
    flags = {name: bool(rows.attrs.get(name, False)) for name in ("unlabelled", "pseudo")}
    if checked:
        place = "{}: /measurements/{}[{}]".format
        check_columns(
            columns,
            len(names),
            lambda row, name: place(path, name, row),
            flags["unlabelled"],
            flags["pseudo"],
        )
    positions = None
    if "position_m" in group:
        high = getattr(group["position_m"], "shape", ())[1:] == (3,)
        positions = get(group, "position_m", (len(names), 3 if high else 2))
    facings = get(group, "orientation_rad", (len(names),)) if "orientation_rad" in group else None
    return columns, flags | {
        "anchors": names,
        "anchor_position_m": positions,
        "anchor_orientation_rad": facings,
        "steps": int(rows.attrs.get("steps", 0)),
        "interval_s": float(rows.attrs.get("interval_s", 0)),
        "truth": None,
        "simulated": simulated_of(rows),
    }


def get_track(group: h5py.Group) -> Trajectory:
    """A true track out of a group.

    Raises
    ------
    InputError
        Arrays that don't belong together.
    """
    time = get(group, "time_s", (None,))
    shapes: dict[str, tuple[int, ...]] = {
        "position_m": (len(time), 2),
        "velocity_mps": (len(time), 2),
        "heading_rad": (len(time),),
    }
    high = get(group, "height_m", (len(time),)) if "height_m" in group else None
    place, speed, heading = (get(group, name, shape) for name, shape in shapes.items())
    return Trajectory(time, place, speed, heading, high)
