"""The results file of a study: a header, then one line per finished run, each durable before the next."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

from gridslam.errors import InputError
from gridslam.io.files import cannot_write, settle_folder, write_bytes

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows: two studies in one folder aren't kept apart there
    fcntl = None

FORMAT, VERSION = "gridslam-study", 5
FILE = "study.jsonl"


class Results:
    """An open results file, which no second process can open meanwhile.

    Attributes
    ----------
    found : list of dict
        Records that were there, each key once.
    """

    def __init__(self, path: Path, file: BinaryIO, found: list[dict[str, Any]]) -> None:
        self.path, self._file, self.found = path, file, found

    @classmethod
    @contextlib.contextmanager
    def open(cls, directory: Path, header: Mapping[str, Any], overwrite: bool = False) -> Iterator[Results]:
        """Open the results in a folder, or begin new ones.

        A last line that was cut short by a crash is dropped: its run never counted.

        Raises
        ------
        InputError
            The folder holds something else, the file belongs to another study or version or is damaged, it
            is in use, or it can't be written.
        """
        path = directory / FILE
        prepare(directory, overwrite)
        try:
            if not path.exists() or b"\n" not in path.read_bytes():
                write_bytes(path, _line(header))
            with path.open("r+b") as file:
                _lock(path, file)
                found, whole = _read(path, file, header)
                file.seek(whole)
                file.truncate()
                _settle(file)
                settle_folder(directory)
                yield cls(path, file, found)
        except OSError as error:
            raise cannot_write(path, error) from error

    def append(self, record: Mapping[str, Any]) -> None:
        """Add a record; when this returns, it survives a crash of the machine."""
        self._file.write(_line(record))
        _settle(self._file)


def prepare(directory: Path, overwrite: bool) -> None:
    """Make the folder of a study; refuse one that holds something else.

    Raises
    ------
    InputError
        It holds something that no study wrote, or can't be made.
    """
    if directory.exists() or directory.is_symlink():
        if not directory.is_dir() or (any(directory.iterdir()) and not (directory / FILE).is_file()):
            raise InputError(str(directory), "something that no study wrote", "a new folder, or a study's")
        if overwrite:
            for name in (FILE, "runs.csv", "steps.csv", "summary.csv", "failures.log"):
                (directory / name).unlink(missing_ok=True)
            shutil.rmtree(directory / "figures", ignore_errors=True)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(directory, error) from error


def _read(path: Path, file: BinaryIO, header: Mapping[str, Any]) -> tuple[list[dict[str, Any]], int]:
    """Records that are whole, each key once, and where they end."""
    content = file.read()
    whole = content.rfind(b"\n") + 1
    first, *rest = content[:whole].splitlines()
    _check(path, _parse(path, 1, first), header)
    records: dict[str, dict[str, Any]] = {}
    for number, line in enumerate(rest, start=2):
        record = _parse(path, number, line)
        if not isinstance(record.get("key"), dict) or not isinstance(record.get("agents"), dict):
            raise InputError(f"{path}: line {number}", "no run", "a run: its key and its agents")
        records.setdefault(json.dumps(record["key"], sort_keys=True), record)
    return list(records.values()), whole


def _check(path: Path, found: Mapping[str, Any], header: Mapping[str, Any]) -> None:
    if found.get("format") != FORMAT:
        raise InputError(str(path), "another kind of file", f"the results of a study ({FORMAT})")
    wanted = json.loads(_line(header))  # tuples and the like, as they look when read
    for name in ("version", "gridslam"):
        if found.get(name) != wanted[name]:
            allowed = f"{wanted[name]}, that of this program (or another folder, or --overwrite)"
            raise InputError(f"{path}: {name}", str(found.get(name)), allowed)
    for name, value in wanted.items():
        if found.get(name) != value:
            allowed = "the study that this folder holds (or another folder, or --overwrite)"
            raise InputError(f"{path}: {name}", f"results of other {name}", allowed)


def _parse(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise InputError(f"{path}: line {number}", "damaged text", "one JSON object per line")
    return found


def _line(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, separators=(",", ":")).encode() + b"\n"


def _lock(path: Path, file: BinaryIO) -> None:
    if fcntl is not None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # type: ignore[attr-defined,unused-ignore]
        except BlockingIOError:
            raise InputError(str(path), "another study at work on it", "one study per folder") from None


def _settle(file: BinaryIO) -> None:
    file.flush()
    os.fsync(file.fileno())
