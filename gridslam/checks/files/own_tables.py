"""What `check` says of tables and records that the project writes: CSV, JSON, clocks, checkpoints."""

from __future__ import annotations

import csv
import json
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.errors import InputError
from gridslam.io.files import get_attributes, reading_h5, subgroup
from gridslam.runs.network_files import read_clocks
from gridslam.runs.track_tables import COLUMNS
from gridslam.systems import checkpoint
from gridslam.systems.registry import METHODS, method_class
from gridslam.wording import counted
from gridslam.world.radio import SPEED_OF_LIGHT

LARGEST_BYTES = 2**28
TABLES = {
    ("step", "time_s", "device", "offset_s", "offset_std_s"): "offsets of clocks",
    COLUMNS: "a track",
    ("x_m", "y_m", "occupancy", "reflection", "reflection_std"): "observed cells of a map",
    ("identity", "normal_rad", "offset_m", "sfv_x_m"): "surfaces of a map",
    ("identity", "anchor", "anchor_x_m", "anchor_y_m", "x_m", "y_m", "bias_m"): "features of a map",
    ("scene", "case", "agent", "seed", "first", "last"): "runs of a disturbed filter",
}
"""What tables of the project are, by the columns that they begin with; a study has another rule."""
STUDY = {"nees_in_band": "methods", "position_nees_low": "steps", "position_std_m": "runs"}
"""What the rows of a study's tables are, by a column that only that table has."""


def is_own_table(path: Path) -> bool:
    """Whether a CSV file is a table that the project writes, other than measurements."""
    return _kind_of_table(_header(path)) is not None


def table_line(path: Path) -> str:
    """Such a table in a line.

    Raises
    ------
    InputError
        It is none, or has a row of another length than its header.
    """
    header = _header(path)
    kind = _kind_of_table(header)
    if kind is None:
        raise InputError(str(path), "another table", "one that a run, an export or a study wrote")
    rows = 0
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.reader(file, strict=True)
            for cells in islice(reader, 1, None):
                rows += 1
                if len(cells) != len(header):
                    found = f"{len(cells)} cells"
                    raise InputError(
                        f"{path}: line {reader.line_num}", found, f"{len(header)}, as the header"
                    )
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(str(path), "a row that can't be read", "a whole CSV table") from error
    return f"table of {kind}: {counted(rows, 'row')}"


def json_line(path: Path) -> str:
    """A JSON file of the project (GeoJSON, or what `bench` measured) in a line.

    Raises
    ------
    InputError
        It is neither, or can't be read.
    """
    allowed = "GeoJSON, a run.json or what bench --json wrote"
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise InputError(str(path), f"{path.stat().st_size} bytes", f"at most {LARGEST_BYTES}")
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), allowed) from error
    except (ValueError, RecursionError) as error:
        raise InputError(str(path), "no JSON", allowed) from error
    if isinstance(content, dict) and isinstance(content.get("features"), list):
        return f"GeoJSON: {counted(len(content['features']), 'feature')}"
    if isinstance(content, dict) and content.get("format") == "gridslam-bench":
        return f"speed of {counted(len(content.get('steps', ())), 'kind')} of steps on one machine"
    raise InputError(str(path), "other JSON", allowed)


def clocks_line(path: Path) -> str:
    """A run's ``clocks.h5`` in a line.

    Raises
    ------
    InputError
        It can't be read as such.
    """
    clocks, truth = read_clocks(path)
    if not len(clocks.step):
        return "offsets of clocks over no steps"
    widest = 1e9 * float(np.ptp(clocks.offset_s[-1]))
    whose = f"{counted(len(clocks.device), 'clock')} ({', '.join(clocks.device)})"
    line = (
        f"offsets of {whose} over {counted(len(clocks.step), 'step')}: "
        f"at the end {widest:.3g} ns ({widest * SPEED_OF_LIGHT / 1e9:.3g} m) apart"
    )
    return line if truth is None else f"{line}; with the true ones"


def checkpoint_line(path: Path) -> str:
    """A filter's checkpoint in a line.

    Raises
    ------
    InputError
        Its filter can't go on from it.
    """
    with reading_h5(path, checkpoint.FORMAT, checkpoint.VERSION) as file:
        method = str(get_attributes(subgroup(file, "run")).get("method"))
    if method not in METHODS:  # a class that a file names is never imported
        return f"checkpoint of method {method!r}, which isn't one of gridslam's own"
    slam = method_class(method).resume(path)  # type: ignore[attr-defined]
    steps = counted(slam.state.step, "step")
    return f"checkpoint of {method} in {slam.scene.name}, after {steps} of {slam.agent}"


def _header(path: Path) -> tuple[str, ...]:
    """Names of the columns; none of what isn't text."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            return tuple(name.strip() for name in file.readline(4096).split(","))
    except (OSError, UnicodeDecodeError):
        return ()


def _kind_of_table(header: tuple[str, ...]) -> str | None:
    for columns, kind in TABLES.items():
        if header[: len(columns)] == columns:
            return kind
    if "method" in header:
        return next((f"{kind} of a study" for column, kind in STUDY.items() if column in header), None)
    return None
