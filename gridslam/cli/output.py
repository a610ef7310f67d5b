"""Command line: the folder that a run writes to, how a run is stopped, and tables."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

if TYPE_CHECKING:
    from gridslam.runs.reservation import Place
    from gridslam.runs.stopping import Termination

err = Console(stderr=True)
WIDEST = 10_000
"""Columns of a table at most."""


@contextmanager
def interruptible() -> Iterator[Termination]:
    """Let SIGTERM do what Ctrl-C does, with exit code 143 instead of 130."""
    from gridslam.runs.stopping import terminable

    with terminable() as termination:
        try:
            yield termination
        except KeyboardInterrupt:
            if not termination.asked:
                raise
            err.print(ended(termination))
            sys.exit(143)


def busy(what: str) -> AbstractContextManager[object]:
    """A sign of life on a terminal."""
    return err.status(what) if err.is_terminal else nullcontext()


def ended(termination: Termination) -> str:
    """How a run that was stopped ended, in a word."""
    return "terminated" if termination.asked else "interrupted"


@contextmanager
def reserved(
    output: Path | None, name: str, overwrite: bool, resume: bool = False
) -> Iterator[tuple[Path, Place]]:
    """The run's folder, as it is called and as it is kept for it; by default runs/NAME-1, runs/NAME-2, ..."""
    from gridslam.runs.reservation import reserve, reserve_free

    if output is not None:
        with reserve(output, overwrite, resume) as place:
            yield output, place
        return
    with reserve_free(Path("runs"), name) as place:
        yield Path("runs") / place.target.name, place


def print_whole(table: Table) -> None:
    """Print a table with all its letters, however wide it is: a number that is cut is another number."""
    out = Console()
    natural = Measurement.get(out, out.options.update(max_width=WIDEST), table).maximum
    Console(width=max(out.width, natural)).print(table)
