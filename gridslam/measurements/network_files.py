"""Files of several agents' measurements: CSV, MATLAB, HDF5.

Readers return what `NetworkMeasurements` is made of, by the names of its arguments.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import located
from gridslam.io.files import reading_h5, writing_h5
from gridslam.measurements import csv_table, hdf5_table, matlab
from gridslam.measurements.datasets import AGENTS
from gridslam.measurements.datasets import CLOCKS as TRUE_CLOCKS
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
        AGENTS.put(file, {"name": whole["agents"], "present": whole["present"]})
        for name, track in whole["tracks"].items():
            hdf5_table.put_track(file, track, f"truth/{name}")
        if clocks is not None:
            TRUE_CLOCKS.put(file, vars(clocks))


def read_h5(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read an HDF5 file, version 2, or version 1 with one agent of the name "agent1"."""
    with located(path), reading_h5(path, hdf5_table.KIND, hdf5_table.VERSIONS) as file:
        columns, table = hdf5_table.get_rows(file, str(path))
        names, present = ("agent1",), None
        tracks, clocks = dict[str, Trajectory](), None
        if "agents" in file:
            names, present = AGENTS.get(file).values()
            truth = file.get("truth", ())
            tracks = {name: hdf5_table.get_track(file, f"truth/{name}") for name in names if name in truth}
            clocks = ClockTruth(**TRUE_CLOCKS.get(file)) if CLOCKS in truth else None
        elif "truth" in file:
            tracks["agent1"] = hdf5_table.get_track(file)
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
