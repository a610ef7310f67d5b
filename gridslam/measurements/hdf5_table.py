"""HDF5 files of measurement tables."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import h5py

from gridslam.errors import InputError
from gridslam.io.files import reading_h5, subgroup, writing_h5
from gridslam.measurements.datasets import AGENTS, ANCHORS, MEASUREMENTS, ROWS, TRACK
from gridslam.measurements.simulated import simulated_of
from gridslam.world.columns import ONE_AGENT, OPTIONAL, VALUES, Columns, check_columns
from gridslam.world.trajectory import Trajectory

KIND, VERSIONS = MEASUREMENTS.kind, MEASUREMENTS.versions


def write_h5(path: str | os.PathLike[str], columns: Columns, table: Mapping[str, Any]) -> None:
    """Write a table with its anchors, number of steps, interval and truth as HDF5.

    It is version 1, which earlier versions read, unless labels or the sign of distances ask for version 2.
    """
    version = 2 if table["unlabelled"] or table["pseudo"] else 1
    with writing_h5(path, KIND, version) as file:
        put_rows(file, columns, table)
        if table["truth"] is not None:
            put_track(file, table["truth"])


def put_rows(file: h5py.File, columns: Columns, table: Mapping[str, Any]) -> None:
    """Write rows and anchors of a table into an open file."""
    told = {f"@{name}": table[name] for name in ("steps", "interval_s")}
    told |= {f"@{name}": True for name in ("unlabelled", "pseudo") if table[name]}
    simulated = {} if table["simulated"] is None else table["simulated"].attributes
    ROWS.put(file, told | simulated | columns)
    placed = {name: table[f"anchor_{name}"] for name in ("position_m", "orientation_rad")}
    ANCHORS.put(file, {"name": table["anchors"]} | placed)


def put_track(file: h5py.Group, track: Trajectory, name: str = TRACK.name) -> None:
    """Write a true track into a group."""
    replace(TRACK, name=name).put(file, vars(track))


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
        agents = AGENTS.get(file, names=("name",))["name"]
        if agents is not None and len(agents) != 1:
            raise InputError(f"{path}: /agents", f"{len(agents)} agents", ONE_AGENT)
        rows, table = get_rows(file, str(path), checked)
        rows.pop("agent", None)
        if "truth" in file:
            truth = subgroup(file, "truth")
            tracks = [name for name in truth if name != "clocks" and isinstance(truth[name], h5py.Group)]
            table["truth"] = get_track(file, f"truth/{tracks[0]}" if tracks else "truth")
        return table | rows


def get_rows(file: h5py.File, path: str, checked: bool = True) -> tuple[Columns, dict[str, Any]]:
    """Rows and anchors of an open file: its columns, and other arguments of `Measurements`.

    Raises
    ------
    InputError
        Columns that don't match, or any fault of a row.
    """
    sizes: dict[str, int] = {}
    anchors = ANCHORS.get(file, sizes)
    names = anchors["name"]
    if not names:
        raise InputError(f"{path}: /anchors/name", "no anchors", "at least one")
    keys = ROWS.get(file, sizes, ("step", "anchor", "agent"))
    found = ROWS.get(file, sizes, ("time_s", *VALUES, *OPTIONAL), checked=False)
    columns: Columns = {name: values for name, values in (keys | found).items() if values is not None}
    if not columns.keys() & set(VALUES):
        raise InputError(f"{path}: /measurements", "no measured column", f"at least one of {VALUES}")
    told = ROWS.get(file, sizes, ("@steps", "@interval_s", "@unlabelled", "@pseudo"))
    flags = {name: bool(told[f"@{name}"]) for name in ("unlabelled", "pseudo")}
    if checked:
        place = "{}: /measurements/{}[{}]".format
        check_columns(
            columns,
            len(names),
            lambda row, name: place(path, name, row),
            flags["unlabelled"],
            flags["pseudo"],
        )
    return columns, flags | {
        "anchors": names,
        "anchor_position_m": anchors["position_m"],
        "anchor_orientation_rad": anchors["orientation_rad"],
        "steps": told["@steps"] or 0,
        "interval_s": told["@interval_s"] or 0.0,
        "truth": None,
        "simulated": simulated_of(subgroup(file, ROWS.name)),
    }


def get_track(file: h5py.Group, name: str = TRACK.name) -> Trajectory:
    """A true track out of a group that is there.

    Raises
    ------
    InputError
        Arrays that don't belong together.
    """
    return Trajectory(**replace(TRACK, name=name).get(file))
