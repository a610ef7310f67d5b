"""CSV and HDF5 files of measurement tables."""

from __future__ import annotations

import csv
import difflib
import io
import os
import warnings
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from gridslam.errors import InputError, Note
from gridslam.io.files import get, put, reading_h5, subgroup, write_bytes, writing_h5
from gridslam.world.columns import DEVIATIONS, KEYS, MOST_STEPS, VALUES, Columns, check_columns
from gridslam.world.trajectory import Trajectory
from gridslam.world.validation import nearest

KIND, VERSIONS = "gridslam-measurements", (1, 2)
UNITS = {
    "step": "1",
    "time_s": "s",
    "anchor": "index",
    "agent": "index",
    "amplitude": "1",
    "distance_m": "m",
    "distance_std_m": "m",
}
UNITS |= dict.fromkeys(("aod_rad", "aoa_rad", "aod_std_rad", "aoa_std_rad"), "rad")
IN_DEGREES = {name.replace("_rad", "_deg"): name for name in UNITS if name.endswith("_rad")}
"""Columns of angles by the names that they may have in CSV files if they are in degrees."""
LARGEST_CSV_BYTES = 2**29
"""A larger table belongs into HDF5."""


@contextmanager
def located(path: str | os.PathLike[str]) -> Iterator[None]:
    """Name the file in any `InputError` that doesn't yet."""
    try:
        yield
    except InputError as error:
        if error.where.startswith(str(path)):
            raise
        raise InputError(f"{path}: {error.where}", error.found, error.allowed) from error


def write_csv(
    path: str | os.PathLike[str], columns: Columns, anchors: Sequence[str], agents: Sequence[str] = ()
) -> None:
    """Write a table as CSV: anchors and agents by name, numbers at full precision, empty cells for NaN."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    named = {"anchor": (*anchors, ""), "agent": tuple(agents)}  # anchor -1: not known
    cells = [
        [named[name][i] for i in values] if name in named else [_cell(v) for v in values.tolist()]
        for name, values in columns.items()
    ]
    writer.writerows(zip(*cells, strict=True))
    write_bytes(path, text.getvalue().encode("utf-8"))


def _cell(value: float) -> str:
    return "" if value != value else repr(value)


def fill_missing(columns: Columns) -> Columns:
    """Return the table with the columns of `VALUES` that it lacks, all NaN: not measured."""
    count = len(columns["step"])
    return columns | {name: np.full(count, np.nan) for name in VALUES if name not in columns}


def read_csv(
    path: str | os.PathLike[str],
    anchors: Sequence[str] | None = None,
    checked: bool = True,
    pseudo: bool = False,
    agents: Sequence[str] | None = None,
    several: bool = False,
) -> tuple[Columns, tuple[str, ...], tuple[str, ...]]:
    """Read and check a CSV table.

    Cells may be set apart by tabs, or by semicolons, then with decimal commas, as spreadsheets of some
    countries write them; ``nan`` is an empty cell; angles may be in columns that end in ``_deg``. Lines that
    begin with ``#`` before the header are passed over; so are columns of other names, with a `Note`, unless
    they look like one of these misspelt.

    Parameters
    ----------
    path : path
    anchors : sequence of str or None
        Names of the anchors; None takes those of the file in the order in which they first appear.
    checked : bool
        Whether the content of the rows is checked too, not only that they are numbers.
    pseudo : bool
        Whether distances may be negative.
    agents : sequence of str or None
        Names that a column ``agent`` may hold, as those of the anchors.
    several : bool
        Whether it is a table of several agents, whose rows may leave open whose they are. A table of one
        agent may have that column, too, if it names one agent.

    Returns
    -------
    columns : dict of (K,) arrays
        `KEYS`, ``agent`` if it has that column, and those of `VALUES` and `DEVIATIONS` that the file has; of
        several agents, ``anchor`` may be -1.
    anchors, agents : tuple of str

    Raises
    ------
    InputError
        The first fault, with its line.
    """
    names = {"anchor": _Names(anchors, several), "agent": _Names(agents, False)}
    lines, table = array("q"), array("d")  # a list of lists takes ten times the memory
    with _rows(Path(path)) as reader:
        written = [name.strip() for name in next((row for row in reader if row), [])]
        comma = reader.dialect.delimiter == ";"
        header = [IN_DEGREES.get(name, name) for name in written]
        extra = _check_header(header, str(path), reader.line_num, several)
        if extra:
            columns_are = f"column{'s' if len(extra) > 1 else ''} {', '.join(extra)}"
            warnings.warn(Note(f"{path}: {columns_are} not used"), stacklevel=2)
        for cells in reader:
            where = f"{path}: line {reader.line_num}"
            if len(cells) not in (0, len(header)):
                raise InputError(where, f"{len(cells)} cells", f"{len(header)} cells, as in the header")
            if cells:
                lines.append(reader.line_num)
                table.extend(
                    _number(_point(cell, name) if comma else cell.strip(), name, names.get(name), where)
                    for cell, name in zip(cells, header, strict=True)
                    if name not in extra
                )
    if not table:
        raise InputError(str(path), "no rows", "at least one measurement")
    header = [name for name in header if name not in extra]
    columns = dict(zip(header, np.array(table).reshape(-1, len(header)).T, strict=True))
    if several:
        columns.setdefault("anchor", np.full(len(lines), -1.0))
        if "agent" not in columns:  # it may be left out where there is one
            if len(names["agent"].place) != 1:
                raise InputError(
                    f"{path}: line 1", "no column 'agent'", "one, where there are several agents"
                )
            columns["agent"] = np.zeros(len(lines))
    columns |= {
        name: columns[name].astype(np.intp) for name in ("step", "anchor", "agent") if name in columns
    }
    columns |= {
        IN_DEGREES[name]: np.radians(columns[IN_DEGREES[name]]) for name in written if name in IN_DEGREES
    }
    known, whose = tuple(names["anchor"].place), tuple(names["agent"].place)
    if not several and "agent" in columns:
        if len(np.unique(columns.pop("agent"))) > 1:
            found = f"{len(whose)} agents ({', '.join(whose)})"
            raise InputError(f"{path}: agent", found, "one, or a method for several (network)")
    if checked:
        place = "{}: line {}: {}".format
        check_columns(columns, len(known), lambda row, name: place(path, lines[row], name), several, pseudo)
    return columns, known, whose


class _Names:
    """Names of a column as numbers; new ones are added where none were given."""

    def __init__(self, given: Sequence[str] | None, optional: bool) -> None:
        self.place = {name: index for index, name in enumerate(given or ())}
        self.growing, self.optional = given is None, optional

    def number(self, cell: str, where: str, what: str) -> int:
        if self.optional and not cell:
            return -1
        if self.growing and cell:
            self.place.setdefault(cell, len(self.place))
        if cell not in self.place:
            raise InputError(where, repr(cell), ", ".join(self.place) or f"the name of an {what}")
        return self.place[cell]


@contextmanager
def _rows(path: Path) -> Iterator[Any]:
    """Rows of a CSV file; whatever is wrong with the file itself becomes an `InputError`."""
    reader = None
    try:
        if path.stat().st_size > LARGEST_CSV_BYTES:
            size = f"{path.stat().st_size} bytes"
            raise InputError(str(path), size, f"at most {LARGEST_CSV_BYTES} bytes of CSV (or HDF5)")
        with path.open(encoding="utf-8-sig", newline="") as file:
            first, remarks = file.readline(), 0
            while first.startswith("#"):
                first, remarks = file.readline(), remarks + 1
            file.seek(0)
            lines = ("\n" if number < remarks else line for number, line in enumerate(file))
            reader = csv.reader(lines, strict=True, delimiter=_delimiter(first))
            yield reader
    except csv.Error as error:
        line = reader.line_num if reader is not None else 1
        raise InputError(f"{path}: line {line}", str(error), "a CSV row") from error
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "bytes that aren't text"
        raise InputError(str(path), reason, "a CSV file of measurements") from error


def _delimiter(header: str) -> str:
    """What sets the cells of a table apart, by its first line."""
    return next((mark for mark in ";\t" if mark in header and "," not in header), ",")


def _point(cell: str, name: str) -> str:
    """A cell of a table with decimal commas, with a point instead."""
    return cell.strip() if name in ("anchor", "agent") else cell.strip().replace(",", ".")


def _check_header(header: list[str], path: str, line: int, several: bool) -> list[str]:
    """Columns that aren't known, and don't look like one that is, misspelt."""
    known = (*KEYS, "agent", *VALUES, *DEVIATIONS)
    if not header:
        raise InputError(path, "an empty file", f"a header line {','.join((*KEYS, *VALUES))}")
    where = f"{path}: line {line}"
    for name in header:
        if not name or (name not in known and difflib.get_close_matches(name.lower(), known)):
            raise InputError(where, f"an unknown column {name!r}", nearest(name, known))
        if header.count(name) > 1:
            raise InputError(where, f"column {name!r} twice", "each column once")
    needed = KEYS[:2] if several else KEYS
    for name in needed:
        if name not in header:
            raise InputError(where, f"no column {name!r}", f"all of {','.join(needed)}")
    if not set(header) & set(VALUES):
        raise InputError(where, "no measured column", f"at least one of {','.join(VALUES)}")
    return [name for name in header if name not in known]


def _number(cell: str, name: str, names: _Names | None, where: str) -> float:
    """One cell as a number; names by their place in the list."""
    if names is not None:
        return names.number(cell, f"{where}: {name}", name)
    if name == "step":
        if not (cell.isascii() and cell.isdecimal() and len(cell) <= 12):
            raise InputError(f"{where}: step", repr(cell), f"a whole number from 0 to {MOST_STEPS - 1}")
        return int(cell)
    if name != "time_s" and cell.lower() in ("", "nan"):
        return np.nan
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        allowed = (
            "a finite number" if name == "time_s" else "a finite number, or an empty cell if not measured"
        )
        raise InputError(f"{where}: {name}", repr(cell), allowed)
    return value


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
            raise InputError(f"{path}: /agents", found, "one, or a method for several (network)")
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
    present = [name for name in (*VALUES, *DEVIATIONS) if name in rows]
    if not set(present) & set(VALUES):
        raise InputError(f"{path}: /measurements", "no measured column", f"at least one of {VALUES}")
    for name in ("time_s", *present):
        columns[name] = get(rows, name, (count,)).astype(np.float64)
    flags = {name: bool(rows.attrs.get(name, False)) for name in ("unlabelled", "pseudo")}
    if checked:
        place = "{}: /measurements/{}[{}]".format
        check_columns(columns, len(names), lambda row, name: place(path, name, row), **flags)
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
    return Trajectory(time, *(get(group, name, shape) for name, shape in shapes.items()))
