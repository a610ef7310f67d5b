"""The one exception for input that a person can mend, and notes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager


class InputError(ValueError):
    """Bad input, told in one line: which file, which field, what was found, what is allowed.

    Parameters
    ----------
    where : str
        File (and field) that holds the fault, e.g. ``"canyon.toml: anchors[0].position_m"``.
    found : str
        What stands there.
    allowed : str
        What could stand there instead.
    """

    def __init__(self, where: str, found: str, allowed: str) -> None:
        self.where, self.found, self.allowed = _line(where), _line(found), _line(allowed)
        super().__init__(f"{self.where}: found {self.found}; allowed: {self.allowed}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        """Travel whole from a worker process: the parts, where ValueError would pass on the sentence."""
        return type(self), (self.where, self.found, self.allowed)


class Faults(InputError):
    """Several faults at once; as one error it is the first of them.

    Parameters
    ----------
    faults : sequence of InputError
        At least one.
    """

    def __init__(self, faults: Sequence[InputError]) -> None:
        self.faults = tuple(faults)
        super().__init__(faults[0].where, faults[0].found, faults[0].allowed)

    def __reduce__(self) -> tuple[type[Faults], tuple[tuple[InputError, ...]]]:  # type: ignore[override]
        """Travel whole from a worker process."""
        return type(self), (self.faults,)


class Unwritten(Faults):
    """Some files of a run couldn't be written; the others were. One fault per file."""


@contextmanager
def located(path: str | os.PathLike[str]) -> Iterator[None]:
    """Name the file in any `InputError` that doesn't yet."""
    try:
        yield
    except InputError as error:
        if error.where.startswith(str(path)):
            raise
        raise InputError(f"{path}: {error.where}", error.found, error.allowed) from error


@contextmanager
def renamed(before: str, after: str) -> Iterator[None]:
    """Call a scene in any `InputError` as its user did, by its file, and not by the name in it."""
    try:
        yield
    except Faults:
        raise
    except InputError as error:
        if before == after or not error.where.startswith(f"{before}: "):
            raise
        raise InputError(f"{after}{error.where[len(before) :]}", error.found, error.allowed) from error


def _line(text: str, longest: int = 500) -> str:
    """The text on one line, whatever a hostile file put into it."""
    plain = "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in text[: 2 * longest])
    return plain if len(plain) <= longest else f"{plain[: longest - 3]}..."


class Note(UserWarning):
    """Something that a person should know, and that stops nothing: a line of its own on the command line."""
