"""Command line: the folder that a run writes to, and how a run is stopped."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from gridslam.runs.reservation import Place
    from gridslam.runs.stopping import Termination

err = Console(stderr=True)


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
