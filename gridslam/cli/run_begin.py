"""Command line: how a run begins. The map that it starts from, and what is said before its first step."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from gridslam.cli.asked import Asked
    from gridslam.maps.map import Map

err = Console(stderr=True)


def map_before(asked: Asked) -> tuple[Map | None, list[str]]:
    """The map to start from, on the scene's grid, and what there is to say of it.

    Raises
    ------
    InputError
        It can't be read, or is of another frame.
    """
    from gridslam.maps.frames import fitted
    from gridslam.maps.map import Map
    from gridslam.runs.notes import lost_makers

    if asked.map_file is None:
        return None, []
    prior, note = fitted(Map.load(asked.map_file), asked.world, str(asked.map_file), asked.same_frame)
    return prior, [*filter(None, [note]), *lost_makers(asked.map_file)]


def tell(notes: Iterable[str | None]) -> None:
    """Say what there is to say, line by line, on the error output."""
    for line in filter(None, notes):
        err.print(f"note: {line}", highlight=False, markup=False, soft_wrap=True)
