"""Cells of CSV files of measurements: names, numbers, and the marks in them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from gridslam.errors import InputError
from gridslam.world.columns import MOST_STEPS

THOUSANDS = re.compile(r"[+-]?\d+([.,'\u2019\u00a0\u202f ]\d+)+")
"""Digits with marks between them, not all of them decimal."""


class Names:
    """Names of a column as numbers; new ones are added where none were given."""

    def __init__(self, given: Sequence[str] | None, optional: bool) -> None:
        self.place = {name: index for index, name in enumerate(given or ())}
        self.growing, self.optional = given is None, optional

    def number(self, cell: str, where: str, what: str) -> int:
        """The place of a name in the list of those known.

        Raises
        ------
        InputError
            It isn't known, and none is added.
        """
        if self.optional and not cell:
            return -1
        if self.growing and cell:
            self.place.setdefault(cell, len(self.place))
        if cell not in self.place:
            raise InputError(where, repr(cell), ", ".join(self.place) or f"the name of an {what}")
        return self.place[cell]


class Marks:
    """Decimal marks of a table whose cells are set apart by semicolons: commas or points, not both."""

    def __init__(self) -> None:
        self.seen: dict[str, str] = {}

    def look(self, cells: Sequence[tuple[str, str]], where: str) -> None:
        """Refuse a mark where there was the other one: 1.234 may be a thousand or one and a bit."""
        for cell, name in cells:
            for mark, other in ((",", "."), (".", ",")):
                if mark in cell and name not in ("anchor", "agent"):
                    self.seen.setdefault(mark, f"{cell!r} in {where.rpartition(': ')[2]}")
                    if other in self.seen:
                        found = f"{cell!r}, and {self.seen[other]}"
                        allowed = "one decimal mark in all cells, comma or point, and none between thousands"
                        raise InputError(f"{where}: {name}", found, allowed)


def is_number(cell: str) -> bool:
    """Whether a cell of a header is a number, with a decimal comma or without."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def number_of(cell: str, name: str, names: Names | None, where: str, comma: bool = False) -> float:
    """One cell as a number, with a decimal `comma` or a point; names by their place in the list."""
    if names is not None:
        return names.number(cell, f"{where}: {name}", name)
    if name == "step":
        if not (cell.isascii() and cell.isdecimal() and len(cell) <= 12):
            raise InputError(f"{where}: step", repr(cell), f"a whole number from 0 to {MOST_STEPS - 1}")
        return int(cell)
    try:
        value = float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        if name != "time_s" and cell.lower() in ("", "nan"):
            return math.nan
        if cell.count(",") == 1 and cell.replace(",", "").lstrip("+-").isdecimal():
            allowed = "a decimal point; decimal commas only where semicolons set cells apart"
            raise InputError(f"{where}: {name}", f"{cell!r}, a decimal comma", allowed)
        if THOUSANDS.fullmatch(cell):
            allowed = "a number with one decimal mark, and none between thousands: 1234.5"
            raise InputError(f"{where}: {name}", f"{cell!r}, with several marks", allowed)
        allowed = (
            "a finite number" if name == "time_s" else "a finite number, or an empty cell if not measured"
        )
        raise InputError(f"{where}: {name}", repr(cell), allowed)
    return value
