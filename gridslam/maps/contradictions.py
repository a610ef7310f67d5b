"""Where two maps of one frame can't both be right: walls of one through what the other found free.

Two floors of a house may have their anchors at the same places, and a map of one is none of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from gridslam.maps.map import Map
from gridslam.maps.walls import OPEN_NAT

BESIDE_CELLS = np.arange(-1.5, 2.0, 0.5)
"""Where cells are asked, beside a wall's line: walls of two right maps differ by a cell."""
LEAST_M, LEAST_SHARE = 2.0, 0.1
"""Metres and share of a map's walls that must run through free cells: a door that was shut since is shorter.
Maps that two robots made of one workshop have 0.1 m of 38, of two floors of it 19 m."""


def crossed_m(walls: Map, cells: Map) -> tuple[float, float]:
    """How many metres of a map's walls run through cells that another is sure are free, and of how many."""
    length = through = 0.0
    for start, end in walls.wall_segments().ends_m:
        far = float(np.hypot(*(end - start)))
        count = max(round(far / cells.cell_m), 1)
        places = start + (np.arange(count)[:, None] + 0.5) / count * (end - start)
        across = np.array([start[1] - end[1], end[0] - start[0]]) / max(far, 1e-9) * cells.cell_m
        asked = places + BESIDE_CELLS[:, None, None] * across
        column, row = np.moveaxis(np.floor((asked - cells.origin_m) / cells.cell_m).astype(np.intp), -1, 0)
        height, width = cells.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        evidence = np.where(
            inside, cells.evidence[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)], 0.0
        )
        through += far * float((evidence.max(0) < OPEN_NAT).mean())
        length += far
    return through, length


def contradictions(maps: Sequence[Map], names: Sequence[str]) -> list[str]:
    """What to say of maps, called by names, of which no two should contradict each other."""
    called = list(zip(maps, names, strict=True))
    lines = (_line(one, other, name, against) for (one, name), (other, against) in combinations(called, 2))
    return [line for line in lines if line is not None]


def _line(one: Map, other: Map, name: str, against: str) -> str | None:
    ways = ((name, against, *crossed_m(one, other)), (against, name, *crossed_m(other, one)))
    whose, through, crossed, length = max(ways, key=lambda way: way[2])
    if crossed < LEAST_M or crossed < LEAST_SHARE * length:
        return None
    return (
        f"{whose}: {crossed:.0f} of {length:.0f} m of the walls run through free cells of {through}: "
        "another floor or another frame, or much has changed"
    )
