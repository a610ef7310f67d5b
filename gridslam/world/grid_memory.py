"""How much memory a grid of cells takes, and how much it may."""

from __future__ import annotations

import psutil

from gridslam.errors import InputError

SLAB_BYTES = 25
"""Of a cell in each slab of paths that are cast together: sums (12), lists (8), marks (1), messages (4)."""
COEFFICIENT_BYTES, BELIEF_BYTES = 80, 26
"""Of a cell: 20 bins in single precision, of which a map holds all and a filter those of hit cells; evidence
before and after a step, occupancy twice, flags."""
CELL_BYTES = COEFFICIENT_BYTES + BELIEF_BYTES + 4 * SLAB_BYTES
"""Of a cell in grid SLAM on a CPU, with its four slabs."""
MOST_BYTES = 2_000_000_000
"""What all cells together may take: 9.7 million of them, no more than a map's file may hold."""
SLABS_IN_ALL = 500_000_000
"""What slabs may take beyond the least number of them."""
LEAST_SLABS = 4
WAY_OUT = "a larger grid.cell_m or a smaller region (grid.x_m, grid.y_m)"


def in_gb(count: float) -> str:
    """Bytes in words."""
    return f"{count / 1e9:.2g} GB"


def slabs_for(most: int, cells: int) -> int:
    """How many slabs to cast in, `most` at best: each needs room for all cells of its own."""
    return min(most, max(LEAST_SLABS, SLABS_IN_ALL // (SLAB_BYTES * max(cells, 1))))


def check_room(cells: int, free: int | None = None) -> None:
    """Refuse a grid that the machine has no memory for, before anything is run.

    Parameters
    ----------
    cells : int
    free : int, optional
        Bytes. Default: what the system says it could give now.

    Raises
    ------
    InputError
        The cells need more.
    """
    free = int(psutil.virtual_memory().available) if free is None else free
    if cells * CELL_BYTES > free:
        found = f"{cells} cells, which need {in_gb(cells * CELL_BYTES)}, and {in_gb(free)} free"
        raise InputError("grid", found, WAY_OUT)
