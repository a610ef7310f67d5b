"""Whose a file is that would be replaced: what is written by name takes the place of its own kind only.

A call that writes one file (`Map.save`, `Measurements.to_csv`) replaces what it wrote before, and refuses to
replace anything else: a map saved as ``heard.csv`` would be the end of somebody's measurements.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import h5py

from gridslam.errors import InputError
from gridslam.io.hdf5_guard import is_hdf5, prove
from gridslam.io.hdf5_limits import most_claimed

HEAD_BYTES = 4096
"""Of a text file, by which it is known."""


def refuse_foreign_h5(path: str | os.PathLike[str], kind: str) -> None:
    """Refuse to replace a file that isn't HDF5 of a kind; one that is empty or not there may be written.

    Parameters
    ----------
    path : path
    kind : str
        Root attribute ``format``.

    Raises
    ------
    InputError
        It is something else.
    """
    if _holds_something(Path(path)) and (found := _format_of(Path(path))) != kind:
        raise InputError(str(path), f"{found}, which is not replaced", f"a new name, or a {kind} file")


def refuse_foreign_text(path: str | os.PathLike[str], kind: str, own: Callable[[str], object]) -> None:
    """Refuse to replace a file that isn't text of a kind; one that is empty or not there may be written.

    Parameters
    ----------
    path : path
    kind : str
        In words, as "a track (.tum)".
    own : callable
        Tells by the first lines whether it is of the kind.

    Raises
    ------
    InputError
        It is something else.
    """
    if _holds_something(Path(path)) and not own(_head(Path(path))):
        raise InputError(
            str(path), "another file of this name, which is not replaced", f"a new name, or {kind}"
        )


def begins_as(header: str) -> Callable[[str], bool]:
    """Tell tables of a kind by their first two columns, as spreadsheets write them back, too."""
    first = header.split(",")[:2]
    return lambda head: re.split("[,;]", head.partition("\n")[0].strip().replace('"', ""))[:2] == first


def _holds_something(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0


def _head(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return file.read(HEAD_BYTES).decode("utf-8-sig", "replace").replace("\r\n", "\n")
    except OSError:  # unknown, so not ours
        return ""


def _format_of(path: Path) -> str:
    """Root attribute ``format`` of an HDF5 file, else what it is in words."""
    try:
        if not is_hdf5(path):
            return f"a {f'{path.suffix} file'.strip()} without HDF5 in it"
        prove(path, most_claimed(path), ["/"])
        with h5py.File(path, "r") as file:
            found = file.attrs.get("format")
    except (OSError, InputError, KeyError, RuntimeError, ValueError, TypeError):
        return "a file that can't be read"
    kind = found.decode("utf-8", "replace") if isinstance(found, bytes) else found
    return f"{kind}" if isinstance(kind, str) else "HDF5 of another program"
