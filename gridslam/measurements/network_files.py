"""Files of several agents' measurements: CSV, MATLAB, HDF5.

Readers return what `NetworkMeasurements` is made of, by the names of its arguments.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from gridslam.errors import located
from gridslam.io.files import get, put, reading_h5, subgroup, writing_h5
from gridslam.measurements import csv_table, hdf5_table, matlab
from gridslam.measurements.table import Measurements
from gridslam.world.clocks import ClockTruth
from gridslam.world.columns import Columns, fill_missing
from gridslam.world.trajectory import Trajectory

CLOCKS = "clocks"
"""Group of the clocks beside those of the agents' tracks."""


def read_csv(
    path: str | os.PathLike[str], anchors: Sequence[str], agents: Sequence[str] | None, pseudo: bool,
    alone: str | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Read a CSV file; see `NetworkMeasurements.load`."""
    with located(path):
        columns, names, whose = csv_table.read_csv(path, anchors, True, pseudo, agents, True, alone)
        return _collected(columns, {"anchors": names, "unlabelled": True, "pseudo": pseudo}, whose)


def read_mat(
    path: str | os.PathLike[str], anchors: Sequence[str], agents: Sequence[str] | None, pseudo: bool
) -> dict[str, Any]:
    """Read a MATLAB file; see `NetworkMeasurements.load`."""
    with located(path):
        columns, names, whose = matlab.read_network_mat(path, anchors, agents, pseudo=pseudo)
        return _collected(columns, {"anchors": names, "unlabelled": True, "pseudo": pseudo}, whose)


def write_h5(path: str | os.PathLike[str], columns: Columns, whole: Mapping[str, Any]) -> None:
    """Write rows and all that `NetworkMeasurements` is made of as HDF5, version 2."""
    table, clocks = whole["table"], whole["clocks"]
    with writing_h5(path, hdf5_table.KIND, 2) as file:
        hdf5_table.put_rows(file, columns, {f.name: getattr(table, f.name) for f in fields(Measurements)})
        agents = file.create_group("agents")
        put(agents, "name", np.array(whole["agents"], dtype=h5py.string_dtype()), "text")
        put(agents, "present", np.asarray(whole["present"]), "step")
        for name, track in whole["tracks"].items():
            hdf5_table.put_track(file.create_group(f"truth/{name}"), track)
        if clocks is not None:
            group = file.create_group(f"truth/{CLOCKS}")
            put(group, "device", np.array(clocks.device, dtype=h5py.string_dtype()), "text")
            put(group, "time_s", clocks.time_s, "s")
            put(group, "offset_s", clocks.offset_s, "s")


def read_h5(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read an HDF5 file, version 2, or version 1 with one agent of the name "agent1"."""
    with located(path), reading_h5(path, hdf5_table.KIND, hdf5_table.VERSIONS) as file:
        columns, table = hdf5_table.get_rows(file, str(path))
        names, present = ("agent1",), None
        tracks, clocks = dict[str, Trajectory](), None
        if "agents" in file:
            group = subgroup(file, "agents")
            names = tuple(name.decode("utf-8") for name in get(group, "name", (None,), "O"))
            if "present" in group:
                present = get(group, "present", (len(names), 2), "iu")
            for name in names:
                if name in file.get("truth", ()):
                    tracks[name] = hdf5_table.get_track(subgroup(file, f"truth/{name}"))
            clocks = _clocks(subgroup(file, f"truth/{CLOCKS}")) if f"truth/{CLOCKS}" in file else None
        elif "truth" in file:
            tracks["agent1"] = hdf5_table.get_track(subgroup(file, "truth"))
        columns.setdefault("agent", np.zeros(len(columns["step"]), np.intp))
        return _collected(columns, table, names, present, tracks, clocks)


def _collected(
    columns: Columns,
    table: dict[str, Any],
    agents: tuple[str, ...],
    present: NDArray[np.intp] | None = None,
    tracks: Mapping[str, Trajectory] | None = None,
    clocks: ClockTruth | None = None,
) -> dict[str, Any]:
    """Measurements of the agents of a file."""
    agent = columns.pop("agent")
    rows: dict[str, Any] = {**table, **fill_missing(columns)}
    listed = sorted(set(agent.tolist())) if present is None else list(range(len(agents)))
    place = np.full(max(len(agents), int(agent.max(initial=0)) + 1), -1)
    place[listed] = np.arange(len(listed))
    names = tuple(agents[i] for i in listed if i < len(agents))
    return {
        "agents": names, "table": Measurements(**rows), "agent": place[agent], "present": present,
        "tracks": tracks or {}, "clocks": clocks,
    }  # fmt: skip


def _clocks(group: h5py.Group) -> ClockTruth:
    names = tuple(name.decode("utf-8") for name in get(group, "device", (None,), "O"))
    time = get(group, "time_s", (None,))
    return ClockTruth(names, time, get(group, "offset_s", (len(time), len(names))))
