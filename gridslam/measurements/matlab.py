"""Measurement tables in MATLAB's ``.mat`` files, version 5 to 7 (`matlab5`) and 7.3 (HDF5).

The file holds the columns of the CSV file as vectors of equal length, as variables of their own or as the
fields of one struct ``measurements``, as MATLAB writes it from a table::

    measurements = table2struct(readtable("heard.csv"), ToScalar=true); save heard.mat measurements

``anchor`` counts from 1, as MATLAB does, into the list of anchors, or holds their names (a cell array of
character vectors). The list itself is the cell array ``anchors``, where it is given. A file of several agents
has ``agent`` likewise, and its list ``agents``; an ``anchor`` that is 0, NaN or an empty name isn't known.

No object is built from such a file: variables of other names are never read, and numbers and text are all
that is taken of those that are. Version 7.3 is first tried in another process (`gridslam.io.hdf5_guard`).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from gridslam.errors import InputError
from gridslam.io.hdf5_guard import prove
from gridslam.io.hdf5_limits import claims_too_much, counted, most_claimed, own
from gridslam.measurements.matlab5 import Damaged, read_arrays
from gridslam.world.columns import KEYS, ONE_AGENT, OPTIONAL, VALUES, Columns, check_columns

GROUP = "measurements"
COLUMNS = (*KEYS, *VALUES, *OPTIONAL)
AGENTS = ("agent", "agents")
LARGEST_MAT_BYTES = 2**29
"""What a version 5 file may hold once it is unpacked; a larger table belongs into version 7.3."""
MOST_NAMES = 1_000_000


def read_mat(
    path: str | os.PathLike[str], anchors: Sequence[str] | None = None, checked: bool = True
) -> tuple[Columns, tuple[str, ...]]:
    """Read and check a MATLAB file.

    Parameters
    ----------
    path : path
    anchors : sequence of str, optional
        Names of the anchors; None takes the file's list ``anchors``, or else the names in
        ``anchor``, or counts them.
    checked : bool
        Whether the content of the rows is checked too.

    Returns
    -------
    columns : dict of (K,) arrays
        `KEYS`, and those of `VALUES` and `OPTIONAL` that the file has.
    anchors : tuple of str

    Raises
    ------
    InputError
        Not such a file, cut short, too large, or any fault of its content.
    """
    raw = read_variables(path, (*COLUMNS, "anchors", *AGENTS), GROUP)
    several = len(set(np.ravel(raw["agent"]).tolist())) if "agent" in raw else 1
    if several > 1:
        raise InputError(f"{path}: agent", f"{several} agents", ONE_AGENT)
    return _table(raw, anchors, checked, str(path))


def names_agents(path: str | os.PathLike[str]) -> bool:
    """Whether a MATLAB file has a variable ``agent``, or rows that don't say which anchor they are of.

    Raises
    ------
    InputError
        Not a MATLAB file.
    """
    raw = read_variables(path, ("step", "anchor", "agent"), GROUP)
    return "agent" in raw or ("step" in raw and "anchor" not in raw)


def read_network_mat(
    path: str | os.PathLike[str],
    anchors: Sequence[str] | None = None,
    agents: Sequence[str] | None = None,
    checked: bool = True,
    pseudo: bool = False,
) -> tuple[Columns, tuple[str, ...], tuple[str, ...]]:
    """Read and check a MATLAB file of several agents, whose rows may leave open which anchor they are of.

    Parameters
    ----------
    path, anchors, checked
        As of `read_mat`.
    agents : sequence of str, optional
        Names of the agents; None takes the file's list ``agents``, or else the names in ``agent``, or counts
        them. ``agent`` may be left out where there is one.
    pseudo : bool
        Whether distances may be negative.

    Returns
    -------
    columns : dict of (K,) arrays
        ``anchor`` is -1 where it isn't known.
    anchors, agents : tuple of str

    Raises
    ------
    InputError
        As `read_mat`, or agents that aren't known.
    """
    raw = read_variables(path, (*COLUMNS, "anchors", *AGENTS), GROUP)
    where = str(path)
    listed = _listed(raw.pop("agents", None), f"{where}: agents")
    if "step" not in raw:
        raise InputError(where, "no variable 'step'", f"all of {','.join(KEYS)}, or a struct {GROUP!r}")
    count = int(np.size(raw["step"]))
    found = raw.pop("agent", None)
    if found is None:
        alone = listed if listed is not None else list(agents or ())
        if len(alone) != 1:
            raise InputError(where, "no variable 'agent'", "one, where there are several agents")
        found = np.ones(count)
    known = list(agents) if agents is not None else None
    if isinstance(found, np.ndarray) and listed is not None:
        number, names = _numbered(found, listed, f"{where}: agent")
        found = [names[index] for index in number]
    agent, whose = _numbered(found, known if known is not None else listed, f"{where}: agent")
    if agent.size != count:
        raise InputError(f"{where}: agent", f"{agent.size} values", f"{count}, as in step")
    raw.setdefault("anchor", np.zeros(count))
    columns, names = _table(raw, anchors, False, where, unlabelled=True)
    columns["agent"] = agent
    if checked:
        check_columns(columns, len(names), lambda row, name: f"{where}: {name}({row + 1})", True, pseudo)
    return columns, names, whose


def read_variables(path: str | os.PathLike[str], names: Sequence[str], group: str) -> dict[str, Any]:
    """Variables of some names, of their own or as fields of a struct `group`.

    Returns
    -------
    dict
        Real or complex arrays in MATLAB's order of axes, lists of text.

    Raises
    ------
    InputError
        Not a MATLAB file, cut short, too large, or one that claims more than it holds.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            start = file.read(520)
        read = _read_h5 if b"\x89HDF" in (start[:4], start[512:516]) else _read_v5
        return read(path, names, group)
    except OSError as error:
        raise InputError(str(path), error.strerror or _line(error), f"a MATLAB file of {group}") from error


def _table(
    raw: dict[str, Any],
    anchors: Sequence[str] | None,
    checked: bool,
    path: str,
    unlabelled: bool = False,
) -> tuple[Columns, tuple[str, ...]]:
    for name in KEYS:
        if name not in raw:
            raise InputError(path, f"no variable {name!r}", f"all of {','.join(KEYS)}, or a struct {GROUP!r}")
    if not set(raw) & set(VALUES):
        raise InputError(path, "no measured column", f"at least one of {','.join(VALUES)}")
    listed = _listed(raw.pop("anchors", None) if anchors is None else list(anchors), f"{path}: anchors")
    number, names = _numbered(raw["anchor"], listed, f"{path}: anchor", unlabelled)
    columns: Columns = {}
    for name in COLUMNS:
        if name in raw:
            values = number if name == "anchor" else _vector(raw[name], f"{path}: {name}")
            if values.size != number.size:
                raise InputError(f"{path}: {name}", f"{values.size} values", f"{number.size}, as in anchor")
            columns[name] = values
    step = columns["step"]
    if not ((np.abs(step) < 2**53) & (step == np.floor(step))).all():
        raise InputError(f"{path}: step", "numbers that aren't whole", "whole numbers from 0")
    columns["step"] = step.astype(np.intp)
    if checked:
        check_columns(columns, len(names), lambda row, name: f"{path}: {name}({row + 1})")
    return columns, names


def _listed(listed: Any, where: str) -> list[str] | None:
    """A list of names, where one is given."""
    named = isinstance(listed, list) and all(isinstance(name, str) for name in listed)
    if listed is not None and not named:
        raise InputError(where, "something else", "a cell array of names")
    return listed


def _numbered(
    found: Any, listed: list[str] | None, where: str, optional: bool = False
) -> tuple[np.ndarray, tuple[str, ...]]:
    """A column of names as indices from 0, and the names that they point to; -1 for none if `optional`."""
    if isinstance(found, list):
        given = [name for name in found if name or not optional]
        names = tuple(dict.fromkeys(given)) if listed is None else tuple(listed)
        place = {name: index for index, name in enumerate(names)}
        for name in given:
            if name not in place:
                raise InputError(where, repr(name), ", ".join(names))
        return np.array([place.get(name, -1) for name in found], dtype=np.intp), names
    number = _vector(found, where)
    if optional:
        number = np.where(np.isnan(number), 0.0, number)
    least = 0 if optional else 1
    whole = (number >= least) & (number == np.floor(number)) & (number <= MOST_NAMES)
    if not whole.all():
        unknown = ", 0 where it isn't known" if optional else ""
        raise InputError(where, str(number[~whole][0]), f"numbers from 1, or names{unknown}")
    highest = int(number.max(initial=1))
    names = tuple(f"{k + 1}" for k in range(highest)) if listed is None else tuple(listed)
    if highest > len(names):
        raise InputError(where, str(highest), f"{least} to {len(names)}")
    return number.astype(np.intp) - 1, names


def _vector(values: Any, where: str) -> np.ndarray:
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiub":
        raise InputError(where, "something else", "a vector of real numbers")
    return values.astype(np.float64).ravel(order="F")


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__


# ---- version 5 to 7


def _read_v5(path: Path, names: Sequence[str], inside: str) -> dict[str, Any]:
    size = path.stat().st_size
    if size > LARGEST_MAT_BYTES:
        raise InputError(str(path), f"{size} bytes", f"at most {LARGEST_MAT_BYTES} bytes, or version 7.3")
    try:
        whole = read_arrays(path.read_bytes(), {inside, *names}, LARGEST_MAT_BYTES)
    except Damaged as error:
        found = f"a damaged MATLAB file ({_line(error)})"
        raise InputError(str(path), found, "a MATLAB file, version 5 to 7.3") from error
    group = whole.pop(inside, None)
    raw = {**(group if isinstance(group, dict) else {}), **whole}
    return {name: value for name, value in raw.items() if name in names}


# ---- version 7.3


def _read_h5(path: Path, names: Sequence[str], inside: str) -> dict[str, Any]:
    try:
        places = [f"{folder}{name}" for folder in ("", f"{inside}/") for name in names]
        prove(path, most_claimed(path), places)
        with h5py.File(path, "r") as file, counted(file):
            group = own(file, inside)
            tables: list[h5py.Group] = [group, file] if isinstance(group, h5py.Group) else [file]
            raw: dict[str, Any] = {}
            for table in tables:
                for name in names:
                    data = own(table, name)
                    if isinstance(data, h5py.Dataset):
                        raw[name] = _dataset(data, file, f"{path}: {name}")
            return raw
    except InputError:
        raise
    except (OSError, KeyError, RuntimeError, ValueError, TypeError, MemoryError) as error:
        found = f"a damaged MATLAB file ({_line(error)})"
        raise InputError(str(path), found, "a whole MATLAB file, version 7.3") from error


def _dataset(data: h5py.Dataset, file: h5py.File, where: str) -> Any:
    """Numbers as an array, a cell array of text as a list, a character array as one word."""
    if data.shape is None or claims_too_much(data):
        raise InputError(where, f"{data.size} values", "as many as the file holds")
    if data.attrs.get("MATLAB_empty", 0):
        return np.zeros(0)
    if h5py.check_ref_dtype(data.dtype) is h5py.Reference:
        if data.size > MOST_NAMES:
            raise InputError(where, f"{data.size} names", f"at most {MOST_NAMES}, or numbers")
        # MATLAB writes arrays in its own order, so HDF5 sees them transposed
        return [_referred(link, file, where) for link in data[()].T.ravel(order="F")]
    values = data[()]
    if data.attrs.get("MATLAB_class") in (b"char", "char") and values.dtype.kind == "u":
        return [_characters(row) for row in np.atleast_2d(values.T)]
    if values.dtype.names == ("real", "imag"):
        values = values["real"] + 1j * values["imag"]
    return np.asarray(values).T if values.dtype.kind in "fiubc" else values


def _referred(link: h5py.Reference, file: h5py.File, where: str) -> str:
    target = file[link] if link else None
    if (
        not isinstance(target, h5py.Dataset)
        or target.dtype.kind != "u"
        or target.size > 1000
        or claims_too_much(target)
    ):
        raise InputError(where, "a cell without a name", "a cell array of names")
    return _characters(target[()].T.ravel(order="F")) if not target.attrs.get("MATLAB_empty", 0) else ""


def _characters(codes: np.ndarray) -> str:
    return "".join(chr(int(code)) for code in np.ravel(codes) if code < 0x110000).rstrip()
