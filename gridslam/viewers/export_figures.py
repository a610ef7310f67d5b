"""Figures of a map alone, as `gridslam export` writes them: cells, coefficients, and what a planner gets."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from gridslam.drawing.map_figure import CELLS, NEAREST, draw_map, draw_reflection, encoded, region
from gridslam.drawing.widths import PAGE_IN
from gridslam.io.files import write_files
from gridslam.maps.map import Map
from gridslam.maps.nav2 import FREE, OCCUPIED, UNKNOWN


def draw_export(grid: Map, directory: str | os.PathLike[str], raw: bool = False) -> list[Path]:
    """Draw ``map.png``, ``occupancy.png`` and ``reflection.png`` of a map alone and return their paths.

    Parameters
    ----------
    raw : bool
        As of `Map.to_nav2`.

    Raises
    ------
    InputError
        The folder can't be written to.
    """
    figures = {"map.png": draw_planner_map(grid, raw), "occupancy.png": draw_map(grid)}
    figures["reflection.png"] = draw_reflection(grid)
    return write_files(Path(directory), {name: encoded(figure) for name, figure in figures.items()})


def draw_planner_map(grid: Map, raw: bool = False, width: float = PAGE_IN) -> Figure:
    """What ``map.pgm`` tells a planner: free, occupied and unknown cells, in metres."""
    _, size, _, pixels = grid.nav2_files(raw)["map.pgm"]().split(b"\n", 3)
    across, up = map(int, size.split())
    told = np.frombuffer(pixels, np.uint8).reshape(up, across)[::-1]
    number = np.select([told == FREE, told == UNKNOWN, told == OCCUPIED], [0, 1, 2], 1)
    figure, axes = region(grid, width=width)
    limits = axes.axis()
    (left, bottom), (right, top) = grid.origin_m.tolist(), grid.corner_m.tolist()
    colors, extent = ListedColormap([color for _, color in CELLS]), (left, right, bottom, top)
    axes.imshow(number, origin="lower", extent=extent, cmap=colors, vmin=0, vmax=2, **NEAREST)
    axes.axis(limits)
    named = zip(("free", "unknown", "occupied"), CELLS, strict=True)
    cells = [Patch(fc=color, ec="#808080", lw=0.5, label=name) for name, (_, color) in named]
    figure.legend(handles=cells, loc="outside lower center", ncols=3, fontsize="small", frameon=False)
    return figure
