"""Where two maps of one frame can't both be right: walls of one through what the other found free.

Two floors of a house may have their anchors at the same places, and a map of one is none of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.maps.map import Map
from gridslam.maps.walls import LONGEST_OPEN_M, OPEN_NAT

BESIDE_CELLS = np.arange(-1.5, 2.0, 0.5)
"""Where cells are asked, beside a wall's line: walls of two right maps differ by a cell."""
LEAST_M, LEAST_SHARE = 2.0, 0.1
"""Metres and share of a map's walls that must run through free cells: a door that was shut since is shorter.
Maps that two robots made of one workshop have 0.1 m of 38, of two floors of it 19 m."""

LEAST_WALL_M = 1.0
"""So long a stretch is told of where paths went through it since: a door that has opened is shorter."""
MOST_NAMED = 6
"""How many such stretches are named."""


def crossed_m(walls: Map, cells: Map) -> tuple[float, float]:
    """How many metres of a map's walls run through cells that another is sure are free, and of how many."""
    length = through = 0.0
    for start, end in walls.wall_segments().ends_m:
        far = float(np.hypot(*(end - start)))
        through += far * float(_are_free(start, end, cells).mean())
        length += far
    return through, length


def crossed_walls(walls: Map, cells: Map) -> list[Array]:
    """Stretches of a map's walls, from end to end (2, 2) m, that run through cells that another is sure are
    free, the longest first."""
    found = []
    for start, end in walls.wall_segments().ends_m:
        free = _are_free(start, end, cells)
        begin, until = _runs_of(free)
        if not len(begin):
            continue
        # what lies between two of them is one with them if it is a cell or two
        apart = (begin[1:] - until[:-1]) * cells.cell_m > LONGEST_OPEN_M
        begin, until = begin[np.append(True, apart)], until[np.append(apart, True)]
        found += [
            start + np.array([[a], [b]]) / len(free) * (end - start)
            for a, b in zip(begin, until, strict=True)
        ]
    lengths = [float(np.hypot(*(one[1] - one[0]))) for one in found]
    order = np.argsort(lengths)[::-1]
    return [found[one] for one in order if lengths[one] >= LEAST_WALL_M]


def moved_walls(earlier: Map, later: Map, file: str) -> str | None:
    """What to say of walls of an earlier map that paths of the run that went on from it went through."""
    found = crossed_walls(earlier, later)
    if not found:
        return None
    named = [f"from ({a:.1f}, {b:.1f}) to ({c:.1f}, {d:.1f})" for (a, b), (c, d) in found[:MOST_NAMED]]
    more = [f"{len(found) - MOST_NAMED} more"] if len(found) > MOST_NAMED else []
    whole = sum(float(np.hypot(*(one[1] - one[0]))) for one in found)
    return (
        f"walls of {file} through which paths went since, {whole:.0f} m in all: they have moved or are gone: "
        + ", ".join([*named, *more])
    )


def _are_free(start: Array, end: Array, cells: Map) -> NDArray[np.bool_]:
    """At which places along a wall, a cell apart, a map is sure that all cells beside it are free, (N,)."""
    far = float(np.hypot(*(end - start)))
    count = max(round(far / cells.cell_m), 1)
    places = start + (np.arange(count)[:, None] + 0.5) / count * (end - start)
    across = np.array([start[1] - end[1], end[0] - start[0]]) / max(far, 1e-9) * cells.cell_m
    asked = places + BESIDE_CELLS[:, None, None] * across
    column, row = np.moveaxis(np.floor((asked - cells.origin_m) / cells.cell_m).astype(np.intp), -1, 0)
    height, width = cells.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    known = cells.evidence[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return np.asarray(np.where(inside, known, 0.0).max(0) < OPEN_NAT)


def _runs_of(true: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Beginnings and ends (exclusive) of runs of what is true."""
    change = np.diff(np.concatenate([[False], true, [False]]).astype(np.int8))
    return np.flatnonzero(change > 0), np.flatnonzero(change < 0)


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
