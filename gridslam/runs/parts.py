"""Folders that runs fill before they get their names: how they are called, signed, put away and told apart.

A run into NAME fills ``.NAME.PID.part`` beside it. Only a folder with a sign in it, written by a process of
this machine, is ever swept: a name alone proves nothing.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import socket
from pathlib import Path

from gridslam.errors import InputError
from gridslam.io.files import beside

MARK = ".gridslam-part"
"""File in a folder that isn't finished: what made it, on which machine, in which process."""
PART = re.compile(r"\.(?P<name>.+)\.(?P<process>\d{1,10})(-\d+)?(?P<old>\.old)?\.part")
UNFINISHED = ".unfinished"
"""Folder within a part that holds what a run needs to go on; no agent can be called so."""
INDEX = "unfinished.json"
"""File without which there is no checkpoint in that folder."""


def holds_checkpoint(part: Path) -> bool:
    """Whether a run can go on from what is in a part."""
    return (part / UNFINISHED / INDEX).is_file()


def unfinished_part(directory: str | os.PathLike[str]) -> Path | None:
    """The part from which a run into a folder can go on, if there is one; the latest of several."""
    target = Path(directory).resolve()
    if not target.parent.is_dir():
        return None
    found = []
    for path in target.parent.iterdir():
        part = PART.fullmatch(path.name)
        if part and part["name"] == target.name and not path.is_symlink() and holds_checkpoint(path):
            found.append(path)
    return max(found, key=lambda path: (path / UNFINISHED / INDEX).stat().st_mtime_ns, default=None)


def refuse_unfinished(folder: Path) -> None:
    """Raise `InputError` if nothing stands there but the checkpoint of a run into it."""
    if not folder.exists() and unfinished_part(folder) is not None:
        raise InputError(
            f"{folder}", "an unfinished run", f"to go on with it (gridslam run --resume {folder})"
        )


def waiting_note(folder: Path) -> str | None:
    """That a run that was to replace a folder's waits, where one does."""
    if not folder.is_dir() or unfinished_part(folder) is None:
        return None
    return (
        f"{folder}: an unfinished run that was to replace this one waits "
        f"(gridslam run --resume {folder} goes on with it)"
    )


def sign(folder: Path, process: int) -> None:
    """Mark a folder as an unfinished one of a process of this machine."""
    (folder / MARK).write_bytes(_mark(process))


def unsign(folder: Path) -> None:
    """Take the mark away, if it is there and can be."""
    with contextlib.suppress(OSError):
        (folder / MARK).unlink(missing_ok=True)


def _mark(process: int) -> bytes:
    """What a sign says; process numbers mean something on one machine only, and in one container."""
    numbers = ""
    with contextlib.suppress(OSError):
        numbers = os.readlink("/proc/self/ns/pid")
    return f"gridslam part 1\n{socket.gethostname()}\n{numbers}\n{process}\n".encode()


def is_signed(folder: Path, process: int) -> bool:
    """Whether a process of this machine made a folder."""
    mark = folder / MARK
    if folder.is_symlink() or not folder.is_dir() or mark.is_symlink() or not mark.is_file():
        return False
    with mark.open("rb") as file:
        return file.read(1000) == _mark(process)


def signed_folder(target: Path) -> Path:
    """Make a folder beside the target, under a name that nothing has, and sign it."""
    first, number = beside(target), 1
    while True:
        part = first if number == 1 else first.with_name(f"{first.stem}-{number}.part")
        if not os.path.lexists(replaced_by(part)):
            with contextlib.suppress(FileExistsError):
                part.mkdir()
                break
        number += 1
    try:
        sign(part, os.getpid())
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    return part


def replaced_by(part: Path) -> Path:
    """Where the run goes that a part replaces."""
    return part.with_name(f"{part.stem}.old.part")


def put_away(part: Path, name: str, process: str) -> Path:
    """Give a finished folder a name that nothing sweeps."""
    number = 1
    while True:
        aside = part.with_name(f"{name}.{process}.part" if number == 1 else f"{name}.{process}-{number}.part")
        if not aside.exists():
            break
        number += 1
    try:
        part.rename(aside)
    except OSError:
        aside = part  # without its sign nothing sweeps it here, either
    unsign(aside)
    return aside


def how_it_ended(folder: Path) -> str:
    """Why nothing is left to do of a run that was written; empty if none was."""
    try:
        agents = json.loads((folder / "run.json").read_text(encoding="utf-8"))["agents"].values()
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return ""
    if any(isinstance(one, dict) and one.get("interrupted") for one in agents):
        return "a run that was cut short and kept no checkpoint"
    return "a finished run: nothing is left to do"
