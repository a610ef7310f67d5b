"""Where a run writes: a folder that it alone may fill, from before its first step to its end.

While a run is at work on the folder NAME, beside it lie ``.NAME.run-lock``, which the system unlocks when the
process ends in whatever way, and ``.NAME.PID.part``, which becomes the folder. What dead processes left of
these is swept by the next run beside it; finished work is kept, as ``NAME.PID.part``. Only a folder with a
sign in it, written by a process of this machine, is ever swept: a name alone proves nothing. A part that
holds a checkpoint stays until its run goes on, or another run overwrites it; runs beside it say so.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from gridslam.errors import InputError
from gridslam.io.files import beside, cannot_write, settle_folder
from gridslam.runs.locks import LOCK, SIGN, lock_of, locked
from gridslam.runs.parts import (
    INDEX,
    MARK,
    PART,
    UNFINISHED,
    holds_checkpoint,
    is_signed,
    put_away,
    replaced_by,
    sign,
    signed_folder,
    unfinished_part,
    unsign,
)


class Taken(InputError):
    """The folder is another run's, which is there or at work on it."""


@dataclass
class Place:
    """A folder that is reserved.

    Attributes
    ----------
    target : Path
        The folder, absolute.
    overwrite : bool
        Whether an earlier run's folder may be replaced.
    part : Path
        The folder to fill, which is there, with a sign in it.
    notes : list of str
        What was found of runs that ended before their time, in words.
    precious : bool
        Whether what was filled is kept even if something comes between it and its name.
    """

    target: Path
    overwrite: bool
    part: Path
    notes: list[str] = field(default_factory=list)
    precious: bool = False
    _done: bool = False

    @property
    def empty(self) -> bool:
        """Whether there is no file in the folder to fill."""
        return all(path.name == MARK for path in self.part.rglob("*") if path.is_file())

    def drop_checkpoint(self) -> None:
        """Remove the checkpoint, the file that makes it one first."""
        folder = self.part / UNFINISHED
        (folder / INDEX).unlink(missing_ok=True)
        shutil.rmtree(folder, ignore_errors=True)

    def finish(self) -> None:
        """Make the filled folder the reserved one; an earlier run's goes last.

        Raises
        ------
        InputError
            Something stands there by now that may not be replaced, or it can't be renamed: what was filled
            stays, under a name that the error says.
        """
        self.precious = True
        try:
            self.drop_checkpoint()
            check_output(self.target, self.overwrite)
            if self.target.exists():
                self._swap()
            else:
                self.part.rename(self.target)  # fails where there is a file, or a folder with something in it
            unsign(self.target)
            settle_folder(self.target.parent)
        except InputError as error:
            found = f"{error.found} by now; this run is kept in {self.keep()}"
            raise InputError(str(self.target), found, error.allowed) from error
        except OSError as error:
            found = f"{error.strerror or error}; this run is kept in {self.keep()}"
            raise InputError(str(self.target), found, "a folder that can be renamed") from error

    def keep(self) -> Path:
        """Put the filled folder where nothing sweeps it, and say where."""
        aside = put_away(self.part, self.target.name, str(os.getpid()))
        self._done = True
        return aside

    def clear(self) -> None:
        """Remove what was filled, unless it was kept, is to be, or a run can go on from it."""
        if self._done or holds_checkpoint(self.part):
            return
        if not self.precious:
            shutil.rmtree(self.part, ignore_errors=True)
        elif self.part.exists():
            self.keep()

    def _swap(self) -> None:
        old = replaced_by(self.part)
        with contextlib.suppress(OSError):  # of a folder that can't be signed, a rest would stay
            sign(self.target, os.getpid())
        try:
            self.target.rename(old)
            self.part.rename(self.target)
        except BaseException:
            if old.exists() and not self.target.exists():
                old.rename(self.target)
            unsign(self.target)
            raise
        shutil.rmtree(old, ignore_errors=True)


def check_output(directory: str | os.PathLike[str], overwrite: bool = False) -> None:
    """Refuse an output folder before a long run rather than after it.

    Raises
    ------
    InputError
        It exists and `overwrite` is off, it exists and isn't a run's folder, or it can't be made.
    """
    target = Path(directory)
    if target.exists() or target.is_symlink():
        if not overwrite:
            raise Taken(str(target), "something of this name", "a new folder (or --overwrite)")
        if not target.is_dir() or (any(target.iterdir()) and not (target / "run.json").is_file()):
            raise InputError(
                str(target), "something that no run wrote", "a new folder, or a run's to overwrite"
            )
    above = next(parent for parent in target.absolute().parents if parent.exists())
    try:  # to ask for rights isn't enough: the superuser has them all, read-only disks or not
        os.rmdir(tempfile.mkdtemp(prefix=".gridslam-", dir=above))
    except OSError as error:
        raise InputError(
            str(target), f"{error.strerror or error} in {above}", "a folder that can be written to"
        ) from error


@contextlib.contextmanager
def reserve(
    directory: str | os.PathLike[str], overwrite: bool = False, resume: bool = False
) -> Iterator[Place]:
    """Keep a folder for one run, and sweep what dead processes left beside it.

    Parameters
    ----------
    directory : path
    overwrite : bool
        Whether what is there may be replaced: an earlier run's folder, or an unfinished run.
    resume : bool
        Whether the run is the unfinished one, whose checkpoint the place then holds. (It does so after
        `overwrite`, too, for the new run to drop once it is sure to begin.)

    Raises
    ------
    Taken
        It exists and `overwrite` is off, another run is at work on it, or an unfinished one is neither to
        be gone on with nor to be overwritten.
    InputError
        It exists and isn't a run's folder, it can't be made, or there is nothing to go on with.
    """
    try:
        check_output(directory, overwrite)
    except Taken as error:
        if resume or unfinished_part(directory) is None:
            raise
        found = f"{error.found}, and an unfinished run to replace it"
        raise Taken(error.where, found, f"{error.allowed}, or gridslam run --resume {directory}") from error
    target = Path(directory).resolve()
    notes: list[str] = []
    with contextlib.ExitStack() as left:
        try:
            for folder in reversed([parent for parent in target.parents if not parent.exists()]):
                folder.mkdir(exist_ok=True)
                left.callback(_remove_empty, folder)
            before = left.enter_context(locked(lock_of(target)))
            if before:
                notes.append(f"process {before}, which is gone, left a run into {directory} unfinished")
            notes += _sweep(target)
            check_output(directory, overwrite)  # what was swept may have been the folder, on its way
            place = _placed(target, str(directory), overwrite, resume, notes)
        except BlockingIOError as error:
            who = f"process {error.strerror}" if error.strerror else "another process"
            raise Taken(
                str(directory), f"a run at work on it ({who})", "another folder, or to wait"
            ) from error
        except OSError as error:
            raise cannot_write(Path(directory), error) from error
        left.callback(place.clear)
        yield place


@contextlib.contextmanager
def reserve_free(folder: Path, name: str) -> Iterator[Place]:
    """Keep the first folder of FOLDER/NAME-1, FOLDER/NAME-2, ... that no run has or is at work on.

    Raises
    ------
    InputError
        It can't be made.
    """
    stem, number = re.sub(r"[^\w .+-]", "_", name), 1
    with contextlib.ExitStack() as stack:
        while True:
            try:
                place = stack.enter_context(reserve(folder / f"{stem}-{number}"))
                break
            except Taken:
                number += 1
        yield place


def _placed(target: Path, directory: str, overwrite: bool, resume: bool, notes: list[str]) -> Place:
    """Make the folder to fill: empty but for the checkpoint that is gone on with or is to be overwritten."""
    before = unfinished_part(target)
    if before is None:
        if resume:
            raise InputError(directory, "no unfinished run", "the folder of a run with --checkpoint")
        return Place(target, overwrite, signed_folder(target), notes)
    if not (resume or overwrite):
        allowed = f"to go on with it (gridslam run --resume {directory}), or --overwrite"
        raise Taken(directory, "an unfinished run", allowed)
    if not resume:
        notes.append(f"the unfinished run into {directory} is overwritten")
    part = before
    if before != beside(target):
        part = signed_folder(target)
        unsign(part)
        part.rmdir()
        before.rename(part)
        settle_folder(part.parent)
    sign(part, os.getpid())
    for path in part.iterdir():  # what it had begun to write at its end
        if path.name not in (UNFINISHED, MARK):
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    return Place(target, overwrite, part, notes)


def _sweep(target: Path) -> list[str]:
    """Remove what dead processes left beside a folder whose lock is held; say what was kept."""
    notes = []
    for path in sorted(target.parent.iterdir()):
        part, lock = PART.fullmatch(path.name), LOCK.fullmatch(path.name)
        with contextlib.suppress(OSError):
            if part and is_signed(path, int(part["process"])):
                if _stale(path, part["name"], int(part["process"]), target):
                    notes += _clear(path, part, target)
            elif lock and path != lock_of(target) and path.is_file() and path.read_bytes()[:9] == SIGN:
                with locked(path):
                    pass
    return notes


def _stale(path: Path, name: str, process: int, target: Path) -> bool:
    """Whether nobody is at work on something any more."""
    if name == target.name:
        return process == os.getpid() or not _alive(process)
    if process == os.getpid() or _alive(process):
        return False
    lock = lock_of(path.with_name(name))  # held by a process of another machine, maybe
    if lock.exists():
        with locked(lock):
            pass
    return True


def _alive(process: int) -> bool:
    """Whether a process is at work: one that was killed has its number until somebody asks how it ended."""
    try:
        return bool(psutil.Process(process).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False
    except psutil.Error:  # another user's, which tells nothing
        return True


def _clear(path: Path, part: re.Match[str], target: Path) -> list[str]:
    """Remove a rest, or keep it if it is a whole run or one that can go on; say so."""
    folder = path.with_name(part["name"])
    if holds_checkpoint(path):
        if part["name"] == target.name:
            return []
        ways = f"gridslam run --resume {folder} goes on with it, --overwrite gives it up"
        return [f"{folder} is an unfinished run, kept hidden in {path.name}: {ways}"]
    if part["old"] and not folder.exists():  # ended between the two renames
        path.rename(folder)
        unsign(folder)
        return [f"{folder} is back: the run that was to replace it ended too early"]
    elif not part["old"] and (path / "run.json").is_file():
        aside = put_away(path, part["name"], part["process"])
        return [f"{aside} is a run that process {part['process']}, which is gone, had finished"]
    else:
        shutil.rmtree(path)
    return []


def _remove_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()
