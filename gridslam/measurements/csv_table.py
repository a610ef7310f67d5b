"""CSV files of measurement tables."""

from __future__ import annotations

import codecs
import csv
import difflib
import io
import os
import warnings
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from gridslam.errors import Faults, InputError, Note
from gridslam.io.files import write_bytes
from gridslam.io.foreign import begins_as, refuse_foreign_text
from gridslam.measurements.csv_cells import Marks, Names, is_number, number_of
from gridslam.measurements.foreign_columns import angles_meant, meant_by
from gridslam.measurements.ranged_in_turn import in_turn_words
from gridslam.world.columns import (
    KEYS,
    ONE_AGENT,
    OPTIONAL,
    UNITS,
    VALUES,
    Columns,
    check_columns,
)
from gridslam.world.validation import nearest, plain_name

IN_DEGREES = {name.replace("_rad", "_deg"): name for name in UNITS if name.endswith("_rad")}
"""Columns of angles by the names that they may have in CSV files if they are in degrees."""
KNOWN = (*KEYS, "agent", *VALUES, *OPTIONAL)
FOLDED = {name.casefold(): name for name in (*KNOWN, *IN_DEGREES)}
"""Names of columns as they are here, by their small letters."""
FILES = "a file of measurements: CSV, MATLAB (.mat) or HDF5"
LARGEST_CSV_BYTES = 2**29
"""A larger table belongs into HDF5."""


def write_csv(
    path: str | os.PathLike[str], columns: Columns, anchors: Sequence[str], agents: Sequence[str] = ()
) -> None:
    """Write a table as CSV: anchors and agents by name, numbers at full precision, empty cells for NaN."""
    refuse_foreign_text(path, "a table of measurements as it is written here", begins_as(",".join(columns)))
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


def read_csv(
    path: str | os.PathLike[str],
    anchors: Sequence[str] | None = None,
    checked: bool = True,
    pseudo: bool = False,
    agents: Sequence[str] | None = None,
    several: bool = False,
    alone: str | None = None,
) -> tuple[Columns, tuple[str, ...], tuple[str, ...]]:
    """Read and check a CSV table.

    Cells may be set apart by tabs, or by semicolons, then with decimal commas, as spreadsheets of some
    countries write them; ``nan`` is an empty cell; angles may be in columns that end in ``_deg``. Passed over
    are lines that begin with ``#``, empty rows, and empty cells beyond the header. Without a column ``step``
    every time is a step, with a `Note`. Passed over, too, are columns of other names, with a `Note`, unless
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
    alone : str, optional
        The one of several `agents` whose rows all are where no column says so.

    Returns
    -------
    columns : dict of (K,) arrays
        `KEYS`, ``agent`` if it has that column, and those of `VALUES` and `OPTIONAL` that the file has; of
        several agents, ``anchor`` may be -1.
    anchors, agents : tuple of str

    Raises
    ------
    InputError
        The first fault, with its line.
    """
    names = {"anchor": Names(anchors, several), "agent": Names(agents, False)}
    with _rows(Path(path)) as reader:
        head = _Head.of(reader, path, several)
        if head.unused:
            warnings.warn(Note(f"{path}: {_unused(head)}"), stacklevel=2)
        lines, columns = _read_rows(reader, path, head, names)
    if several:
        columns = _with_senders(columns, names["agent"], alone, head.where)
    timed = "step" not in columns
    if timed:
        times, columns["step"] = np.unique(columns["time_s"], return_inverse=True)
        note = f"{path}: no column step: {len(times)} steps, one for each time; a silent one isn't there"
        warnings.warn(Note(note + in_turn_words(columns)), stacklevel=2)
    columns = _in_our_units(columns, head.in_degrees)
    known, whose = tuple(names["anchor"].place), tuple(names["agent"].place)
    if not several and "agent" in columns and len(np.unique(columns.pop("agent"))) > 1:
        raise InputError(f"{path}: agent", f"{len(whose)} agents ({', '.join(whose)})", ONE_AGENT)
    if checked:

        def where_in_file(row: int, name: str) -> str:
            return f"{path}: line {lines[row]}: {name}"

        check_columns(columns, len(known), where_in_file, several, pseudo, head.in_degrees, timed)
    return columns, known, whose


@dataclass(frozen=True)
class _Head:
    """Header of a table.

    Attributes
    ----------
    where : str
        File and line.
    written, names : list of str
        Columns as the file has them, and as they are here, where angles are in radians.
    width : int
        Cells of the row, with nameless ones at its end.
    unused : list of str
        Names that aren't known.
    """

    where: str
    written: list[str]
    names: list[str]
    width: int
    unused: list[str]

    @classmethod
    def of(cls, reader: Any, path: str | os.PathLike[str], several: bool) -> Self:
        """The next row of a file."""
        written, width = _header(reader)
        names, where = [IN_DEGREES.get(name, name) for name in written], f"{path}: line {reader.line_num}"
        return cls(where, written, names, width, _check_header(names, written, where, several))

    @property
    def used(self) -> list[str]:
        """Names that are known, in the file's order."""
        return [name for name in self.names if name not in self.unused]

    @property
    def in_degrees(self) -> dict[str, str]:
        """What columns are called in the file that are degrees there, by what they are here."""
        return {IN_DEGREES[name]: name for name in self.written if name in IN_DEGREES}


def _unused(head: _Head) -> str:
    """Which columns aren't used, and what they may be meant for."""
    meant = [one for one in map(meant_by, head.unused) if one and one.column not in head.names]
    meant += dict.fromkeys(one for name in head.unused for one in angles_meant(name, head.names))
    ways = [f"{one.column}, {one.way}" for one in meant]
    said = f" ({'; '.join(ways)})" if ways else ""
    return f"column{'s' if len(head.unused) > 1 else ''} {', '.join(head.unused)} not used{said}"


def _read_rows(
    reader: Any, path: str | os.PathLike[str], head: _Head, names: dict[str, Names]
) -> tuple[array[int], Columns]:
    """Lines (K,) in the file of all rows, and their numbers by column, (K,) float64 each."""
    lines, table = array("q"), array("d")  # a list of lists takes ten times the memory
    marks, comma = Marks(), reader.dialect.delimiter == ";"
    for row in reader:
        where = f"{path}: line {reader.line_num}"
        cells = _filled(row, len(head.names), head.width)
        if len(cells) not in (0, len(head.names)):
            raise InputError(where, f"{len(cells)} cells", f"{len(head.names)} cells, as in the header")
        if not cells:
            continue
        lines.append(reader.line_num)
        here = [
            (cell.strip(), name)
            for cell, name in zip(cells, head.names, strict=True)
            if name not in head.unused
        ]
        table.extend(number_of(cell, name, names.get(name), where, comma) for cell, name in here)
        if comma:
            marks.look(here, where)
    if not table:
        raise InputError(str(path), "no rows", "at least one measurement")
    return lines, dict(zip(head.used, np.array(table).reshape(-1, len(head.used)).T, strict=True))


def _with_senders(columns: Columns, agents: Names, alone: str | None, where: str) -> Columns:
    """Columns of a table of several agents, with those of anchors and agents where the file has none."""
    count = len(columns["time_s"])
    columns = {**columns, "anchor": columns.get("anchor", np.full(count, -1.0))}
    if "agent" in columns:
        return columns
    choice = tuple(agents.place)  # it may be left out where there is one
    own = choice[0] if len(choice) == 1 else alone
    if own is None:
        allowed = "one, where there are several agents; or, of a table of one, its name (--agent)"
        raise InputError(where, "no column 'agent'", allowed)
    return {**columns, "agent": np.full(count, agents.number(own, where, "agent"))}


def _in_our_units(columns: Columns, in_degrees: dict[str, str]) -> Columns:
    """Columns with whole numbers where they are, and all angles in radians."""
    whole = [name for name in ("step", "anchor", "agent") if name in columns]
    return (
        columns
        | {name: columns[name].astype(np.intp) for name in whole}
        | {name: np.radians(columns[name]) for name in in_degrees}
    )


def columns_in_degrees(path: str | os.PathLike[str]) -> dict[str, str]:
    """Columns of a CSV file that are degrees there, by what they are here: ``{"aod_rad": "aod_deg"}``.

    Raises
    ------
    InputError
        It can't be read.
    """
    with _rows(Path(path)) as reader:
        written, _ = _header(reader)
    return {IN_DEGREES[name]: name for name in written if name in IN_DEGREES}


def column_name(written: str) -> str:
    """What a column is called here, which in a file may be in other letters, or between blanks."""
    name = written.strip()
    return FOLDED.get(name.casefold(), name)


def _header(reader: Iterator[list[str]]) -> tuple[list[str], int]:
    """Names of the columns, and how many cells they are with nameless ones at the end, as of spreadsheets."""
    names = [column_name(name) for name in next((row for row in reader if any(map(str.strip, row))), [])]
    last = max((place for place, name in enumerate(names) if name), default=-1)
    return names[: last + 1], len(names)


def _filled(cells: list[str], named: int, width: int) -> list[str]:
    """A row's cells under `named` columns of a header of `width` cells; none of an empty row or a remark."""
    if not any(map(str.strip, cells)) or (cells[0].startswith("#") and len(cells) < named):
        return []
    more = len(cells) > width or any(map(str.strip, cells[named:]))
    return cells if more else cells[:named]


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
        with path.open(encoding="utf-8", errors="replace") as file:  # an open quote is noticed far below
            odd = next((number for number, text in enumerate(file, 1) if text.count('"') % 2), None)
        found = str(error) if odd is None else "a quotation mark that isn't closed"
        raise InputError(f"{path}: line {odd or line}", found, "a CSV row") from error
    except UnicodeDecodeError as error:
        with path.open("rb") as content:
            wide = content.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        found = "UTF-16 text" if wide else "bytes that aren't text"
        raise InputError(str(path), found, "UTF-8: save it as CSV UTF-8" if wide else FILES) from error
    except OSError as error:
        raise InputError(str(path), (error.strerror or "no readable file").lower(), FILES) from error


def _delimiter(header: str) -> str:
    """What sets the cells of a table apart, by its first line."""
    return next((mark for mark in ";\t" if mark in header and "," not in header), ",")


def _check_header(header: list[str], written: list[str], where: str, several: bool) -> list[str]:
    """Columns that aren't known, nor look like one that is, misspelt; `written`: as the file has them."""
    if not header:
        raise InputError(
            where.rpartition(": ")[0], "an empty file", f"a header line {','.join((*KEYS, *VALUES))}"
        )
    if len(written) == 1 and len(set(written[0].split()) & set(KNOWN)) > 1:
        raise InputError(where, "columns set apart by spaces", "commas, tabs or semicolons between them")
    if not set(header) & set(KNOWN) and any(map(is_number, written)):
        columns = ",".join((*KEYS, *VALUES))
        raise InputError(where, f"no header, but {','.join(written)[:60]!r}", f"names of columns: {columns}")
    faults = list[InputError]()
    for place, name in enumerate(header):
        meant = None if name in KNOWN else meant_by(name)
        misspelt = name not in KNOWN and difflib.get_close_matches(plain_name(name), KNOWN)
        noted = meant and meant.column in ("amplitude", "agent")  # a table may do without
        if meant and meant.column not in header and (misspelt or not noted):
            found = f"a column {name!r}, and no {meant.column}"
            rename = "" if ":" in meant.way else " (rename it)"
            faults.append(InputError(where, found, f"{meant.column}, {meant.way}{rename}"))
        elif not name or (misspelt and not meant):
            faults.append(
                InputError(where, f"an unknown column {name!r}", nearest(name, (*KNOWN, *IN_DEGREES)))
            )
        elif name in header[:place]:
            both = [repr(own) for own, column in zip(written, header, strict=True) if column == name]
            found = f"columns {' and '.join(both)}" if len(set(both)) > 1 else f"column {name!r} twice"
            allowed = "each column once" if len(set(both)) == 1 else "one of them"
            faults.append(InputError(where, found, allowed))
    if faults:
        raise faults[0] if len(faults) == 1 else Faults(faults)
    # steps follow from times
    needed = [name for name in (KEYS[:2] if several else KEYS) if name != "step"]
    for name in needed:
        if name not in header:
            more = ", or --method network, which needs no anchor" if name == "anchor" else ""
            raise InputError(where, f"no column {name!r}", f"all of {','.join(needed)}{more}")
    if not set(header) & set(VALUES):
        raise InputError(where, "no measured column", f"at least one of {','.join(VALUES)}")
    return [name for name in header if name not in KNOWN]
