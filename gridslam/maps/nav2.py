"""The picture a planner gets: cells with the walls found drawn in, and nothing free behind them."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridslam.io.foreign import refuse_foreign_text
from gridslam.maps.map_cells import MapCells, anchors_of
from gridslam.maps.walls import WallSegments

FREE, OCCUPIED, UNKNOWN = 254, 0, 205
NUDGE = 1e-6
"""Cells: so near to a corner of cells a wall belongs to all four of them."""
SMALLEST_SEEN_M2 = 1.0
"""Free cells that walls part from the most of them count as seen if there are so many together, or an anchor
stands among them: doubt about where a wall is leaves bands and specks behind it."""
PAST_ENDS_M = 0.3
"""Walls part free cells a bit beyond their ends, too: the corner of a room is seldom hit."""
SURELY_CROSSED_NAT = -3.0
ACROSS_CELLS = np.linspace(-2.5, 2.5, 11)
"""Where cells are asked whether rays crossed a line. Those next to it are not enough: rays run along either
side of a wall between two rows of cells at a slant, and free both rows over a metre without ever crossing."""
CROSSED_NAT = -0.7
"""Evidence of cells that a planner may take for free: their odds were halved. Far more were touched by the
outermost rays of vague paths, also behind walls that were never heard, and learned next to nothing of."""

NUMBER = r"-?\d+\.\d+"
OURS = re.compile(
    r"image: (map|reflection)\.pgm\nmode: (trinary|raw)\n"
    rf"resolution: {NUMBER}\norigin: \[{NUMBER}, {NUMBER}, 0\.0\]\n"
    r"negate: 0\noccupied_thresh: 0\.65\nfree_thresh: 0\.196\n"
)
"""A description of a map as it is written here; nav2's own writes whole numbers without a point."""


def nav2_files(grid: MapCells, walls: Callable[[], WallSegments | None]) -> dict[str, Callable[[], bytes]]:
    """What the ROS nav2 map server reads: content of files by name, each made by itself.

    ``map.yaml`` and ``map.pgm``: trinary, 254 free, 0 occupied, 205 never observed; first image row at the
    highest y. ``reflection.yaml`` and ``reflection.pgm``: the same frame in nav2's raw mode, in which a cell
    is the reflection coefficient in percent (0 to 100) and 255 unknown. Walls are occupied whatever their
    cells say, and what lies behind them is unknown; None gives the cells alone.

    Parameters
    ----------
    grid : MapCells
    walls : callable
        Gives the walls, or None.

    Notes
    -----
    ``free_thresh`` is 0.196 as in ROS 1 and in nav2 since 2025: the 0.25 of older nav2 savers turns the
    unknown 205, (255 - 205) / 255 = 0.1961, into free space on reading.
    """
    return {
        "map.yaml": partial(_yaml, grid, "map", "trinary"),  # first: a picture alone is nobody's
        "map.pgm": lambda: _pgm(trinary(grid, walls())),
        "reflection.yaml": partial(_yaml, grid, "reflection", "raw"),
        "reflection.pgm": lambda: _pgm(_percent(grid)),
    }


def refuse_foreign_maps(folder: Path) -> None:
    """Refuse to replace files of these names that are another program's: a SLAM of its own, most likely.

    Raises
    ------
    InputError
        One in the folder isn't as `nav2_files` has it; a picture goes by the ``.yaml`` beside it.
    """
    for name in ("map", "reflection"):
        beside, kind = folder / f"{name}.yaml", "a folder without nav2 maps of other programs"
        refuse_foreign_text(beside, kind, OURS.fullmatch)
        described = beside.is_file()
        refuse_foreign_text(folder / f"{name}.pgm", kind, lambda _, known=described: known)  # type: ignore[misc]


def _percent(grid: MapCells) -> NDArray[np.uint8]:
    percent = np.where(np.isnan(grid.reflection), 255, np.rint(100 * np.nan_to_num(grid.reflection)))
    return percent.astype(np.uint8)


def _pgm(pixels: NDArray[np.uint8]) -> bytes:
    return f"P5\n{pixels.shape[1]} {pixels.shape[0]}\n255\n".encode("ascii") + pixels[::-1].tobytes()


def _yaml(grid: MapCells, name: str, mode: str) -> bytes:
    return (
        f"image: {name}.pgm\n"
        f"mode: {mode}\n"
        f"resolution: {_decimal(grid.cell_m)}\n"
        f"origin: [{_decimal(grid.origin_m[0])}, {_decimal(grid.origin_m[1])}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    ).encode()


def _decimal(value: float) -> str:
    """Full precision without an exponent, which YAML 1.1 would read as text (1e-05)."""
    return np.format_float_positional(value, unique=True, trim="0")


def trinary(grid: MapCells, walls: WallSegments | None) -> NDArray[np.uint8]:
    """Picture of a map for planners, (ny, nx) uint8, first row at the lowest y.

    Parameters
    ----------
    grid : MapCells
    walls : WallSegments or None
        Occupied, too, whatever the cells say; unknown are then free cells that paths hardly told anything of,
        those that no path reached but through a wall, and those between two stretches of one surface unless
        rays surely crossed the line there. None: the cells alone.
    """
    occupied, free = grid.occupied.copy(), grid.free
    if walls is not None:
        occupied |= burnt(grid, walls.ends_m)
        unproven = burnt(grid, _not_crossed(grid, _gaps(walls)))
        told = free & (grid.evidence < CROSSED_NAT)
        free = _seen(grid, told & ~occupied & ~unproven, walls.ends_m)
    return np.where(occupied, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.uint8)


def _gaps(walls: WallSegments) -> NDArray[np.float64]:
    """What lies between neighbouring stretches of one surface, (G, 2, 2), m."""
    same = walls.surface[1:] == walls.surface[:-1]
    return np.stack([walls.ends_m[:-1, 1], walls.ends_m[1:, 0]], axis=1)[same]


def _not_crossed(grid: MapCells, gaps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Parts of gaps (G, 2, 2) where it isn't sure that rays went from one side to the other, (P, 2, 2), m."""
    parts = [np.zeros((0, 2, 2))]
    for start, end in gaps:
        way = end - start
        far = max(float(np.hypot(*way)), 1e-9)
        edge = np.linspace(0, 1, max(1, int(np.ceil(far / (0.5 * grid.cell_m)))) + 1)
        across = np.array([-way[1], way[0]]) / far * grid.cell_m
        middle = start + 0.5 * (edge[1:] + edge[:-1])[:, None] * way
        cell, inside = grid.index(middle[:, None] + ACROSS_CELLS[:, None] * across)
        cell = np.where(inside[..., None], cell, 0)
        known = np.where(inside, grid.evidence[cell[..., 0], cell[..., 1]], 0.0)
        doubtful = known.max(axis=1) > SURELY_CROSSED_NAT
        parts.append(start + np.stack([edge[:-1], edge[1:]], axis=1)[doubtful][..., None] * way)
    return np.concatenate(parts)


def burnt(grid: MapCells, ends_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Cells of a map's grid that line segments pass through, (ny, nx).

    All of them, also those that a segment only cuts a corner of or passes by at a common corner: nothing gets
    from one side to the other without entering one, by diagonal moves neither.

    Parameters
    ----------
    ends_m : (W, 2, 2) float64, m
        [segment, end, xy]; parts beyond the grid are left out.
    """
    marked = np.zeros(grid.shape, dtype=bool)
    size = np.array(grid.shape[::-1], float)
    for start, end in (ends_m - grid.origin_m) / grid.cell_m:
        inside = _clipped(start, end, size)
        if inside is None:
            continue
        start, end = inside
        crossed = [np.array([0.0, 1.0])]
        for a, b in zip(start, end, strict=True):  # where the lines between columns and rows are crossed
            if a != b:
                crossed.append((np.arange(np.ceil(min(a, b)), np.floor(max(a, b)) + 1) - a) / (b - a))
        share = np.unique(np.clip(np.concatenate(crossed), 0, 1))
        between = 0.5 * (share[1:] + share[:-1])
        nudges = NUDGE * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
        corner = (start + share[:, None] * (end - start))[:, None] + nudges
        point = np.concatenate([start + between[:, None] * (end - start), corner.reshape(-1, 2)])
        cell = np.floor(point).astype(int)
        cell = cell[((cell >= 0) & (cell < size)).all(axis=1)]
        marked[cell[:, 1], cell[:, 0]] = True
    return marked


def _clipped(
    start: NDArray[np.float64], end: NDArray[np.float64], size: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """The part of a segment on the grid and its rim of one cell, in cells; None if there is none."""
    way, first, last = end - start, 0.0, 1.0
    for axis in range(2):
        low, high = -1 - start[axis], size[axis] + 1 - start[axis]
        if way[axis] == 0:
            if not low <= 0 <= high:
                return None
            continue
        near, far = sorted((low / way[axis], high / way[axis]))
        first, last = max(first, near), min(last, far)
    return (start + first * way, start + last * way) if first <= last else None


def _seen(grid: MapCells, free: NDArray[np.bool_], ends_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Free cells without the bands and specks behind walls, (ny, nx)."""
    from scipy import ndimage

    if not len(ends_m):
        return free
    way = ends_m[:, 1] - ends_m[:, 0]
    more = way * (PAST_ENDS_M / np.maximum(np.linalg.norm(way, axis=1), 1e-9))[:, None]
    longer = burnt(grid, np.stack([ends_m[:, 0] - more, ends_m[:, 1] + more], axis=1))
    part, count = ndimage.label(free & ~longer)
    sure = np.bincount(part[grid.evidence < SURELY_CROSSED_NAT], minlength=count + 1)
    shown = sure * grid.cell_m**2 >= SMALLEST_SEEN_M2
    places = np.array([place for _, place in anchors_of(grid.provenance)], float).reshape(-1, 2)
    cell, inside = grid.index(places)
    shown[part[cell[inside, 0], cell[inside, 1]]] = True
    sure[0] = 0
    shown[np.argmax(sure)] = True
    shown[0] = False
    seen = shown[part]
    # what lies in a wall's prolongation is as seen as what is next to it
    return seen | (free & longer & ndimage.binary_dilation(seen))
