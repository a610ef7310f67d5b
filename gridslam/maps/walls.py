"""Where a surface is a wall: the stretches of its line that the cells bear out.

A surface is an endless line, and the extent that goes with it runs from its first hit to its last: across
doors, streets and whatever lies between two walls in one line. The cells know better. Along the line, a place
is open where rays went through all cells next to it, as sure as a cell can be; it is wall where a cell next
to it was hit, and not just faintly where rays speak against it, or is more likely occupied than before; and
it is unknown else. Of methods that map no cells, what paths were reflected by is wall (`Map.stretches`).

What is wall comes in pieces. Two of them are one wall if the gap between them is short, both in all and where
it is open, and neither piece is much shorter than the gap: one measurement that is off by metres puts a hit
far beyond a wall's end, and mustn't draw the wall as far. Nor is a piece of half a cell, alone, drawn there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.maps.map_cells import MapCells
from gridslam.world.geometry import unit

OPEN_NAT = -3.0
"""Evidence below which a cell is surely crossed. Cells of a wall that was hit seldom stay near 0, with an
occupancy as low as the prior: that alone opens nothing."""
WALL_NAT = 1.0
"""Evidence above which a cell speaks for a wall."""
HIT_NAT, FAINT_NAT = 0.3, 2.0
"""Spread of the evidence over reflection coefficients, best to worst, from which a cell counts as hit; and up
to which only where rays don't speak against it: hits of a wall that wasn't known well yet, as those beside a
door, are spread over what lies next to them."""
SURE_HIT_NAT = 1.0
"""A stretch needs a cell with so large a spread, where rays don't speak against it, or one that speaks for a
wall: faint hits alone leave open where a wall ends."""
LONGEST_OPEN_M = 0.3
"""Between two pieces of a wall, so much may be open at a stretch: gaps of the evidence."""
LONGEST_GAP_M = 0.5
"""So much may lie between them in all, open or unknown: any door is wider, but hits are spread into it from
both sides."""
LEAST_SHARE = 0.4
"""Of a gap's length, how long the pieces beside it must be."""
REACH_CELLS, MOST_REACH_CELLS = 1.0, 3.0
"""How far beside the line cells are asked: two standard deviations of the line, between these."""
OPEN, UNKNOWN, WALL = -1, 0, 1


@dataclass(frozen=True, eq=False)
class WallSegments:
    """Stretches of surfaces where there is a wall.

    Attributes
    ----------
    surface : (W,) int64
        Row of the surface in the map's table; one may have several stretches or none. Ascending.
    identity : (W,) int64
        The surface's number.
    extent_m : (W, 2) float64, m
        From where to where along the surface, as `SurfaceEstimate.extent_m` counts; ascending.
    ends_m : (W, 2, 2) float64, m
        Ends of the stretch, indexed [stretch, end, xy].
    """

    surface: NDArray[np.int64]
    identity: NDArray[np.int64]
    extent_m: Array
    ends_m: Array

    def __len__(self) -> int:
        return len(self.surface)

    @property
    def length_m(self) -> Array:
        """Lengths, (W,) float64, m."""
        return self.extent_m[:, 1] - self.extent_m[:, 0]


def wall_segments(grid: MapCells) -> WallSegments:
    """Stretches of a map's surfaces where there is a wall, by what its cells know.

    A surface whose cells know nothing keeps its whole extent, unless the map says by which stretches of it
    paths were reflected; one that was never hit has no stretch. What lies off the grid by more than the grid
    is wide is left out.

    Parameters
    ----------
    grid : MapCells
    """
    rows: list[int] = []
    pieces: list[tuple[float, float]] = []
    table = grid.surfaces
    if table is not None:
        hits = np.ptp(grid.coefficient, axis=-1)
        for row in np.flatnonzero(np.isfinite(table.extent_m).all(axis=1)):
            known = None if grid.stretches is None else grid.stretches.extent_m[grid.stretches.surface == row]
            own = _stretches(grid, hits, table.line[row], table.line_cov[row], table.extent_m[row], known)
            rows += [int(row)] * len(own)
            pieces += own
    surface, extent = np.array(rows, np.int64), np.array(pieces, float).reshape(-1, 2)
    if table is None:
        return WallSegments(surface, surface, extent, np.zeros((0, 2, 2)))
    angle, offset = table.line[surface].T
    foot = offset[:, None] * unit(angle)
    ends = foot[:, None] + extent[:, :, None] * unit(angle + 0.5 * np.pi)[:, None]
    return WallSegments(surface, table.identity[surface], extent, ends)


def _stretches(
    grid: MapCells, hits: NDArray, line: Array, cov: Array, extent: Array, heard: Array | None
) -> list[tuple[float, float]]:
    """Where along one surface there is a wall: pairs of coordinates, ascending.

    `heard` (H, 2) is where paths were reflected, of methods without cells.
    """
    corners = np.array([[x, y] for x in (0, 1) for y in (0, 1)]) * (grid.corner_m - grid.origin_m)
    around = (grid.origin_m + corners) @ unit(line[0] + 0.5 * np.pi)
    nearby = around.min() - np.ptp(around), around.max() + np.ptp(around)
    low, high = np.sort(extent)
    if high < nearby[0] or low > nearby[1]:
        return []
    low, high = np.clip([low, high], *nearby)  # maps of others may claim any extent
    edge = np.linspace(low, high, max(1, int(np.ceil((high - low) / (0.5 * grid.cell_m)))) + 1)
    middle = 0.5 * (edge[1:] + edge[:-1])
    state, sure, evidence = _states(grid, hits, line, cov, middle)
    if heard is not None:
        hit = ((heard[:, :1] <= middle) & (middle <= heard[:, 1:])).any(axis=0) & (state == UNKNOWN)
        state, sure = np.where(hit, WALL, state), sure | hit
    elif not (state == WALL).any():  # nothing to go by but what is open
        state, sure = np.where(state == UNKNOWN, WALL, state), state == UNKNOWN
    first, last = _joined(state, edge)
    pieces = [(a, b) for a, b in zip(first, last, strict=True) if sure[a:b].any()]
    # half a cell alone is a stray hit at the end of the extent: no wall where more of it is known
    lasting = [(a, b) for a, b in pieces if b - a > 1]
    if pieces and not lasting:
        lasting = [max(pieces, key=lambda piece: float(evidence[slice(*piece)].max()))]
    return [(float(edge[a]), float(edge[b])) for a, b in lasting]


def _joined(state: NDArray[np.int64], edge: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Beginnings and ends of pieces of wall, after those that belong together are one.

    Pieces that were joined are longer, and may reach over the next gap, until no gap is left to close.

    Parameters
    ----------
    state : (N,)
        `OPEN`, `UNKNOWN` or `WALL`.
    edge : (N + 1,) m
        Where each place ends, along the surface.
    """
    begin, end = _runs(state)
    first, last = begin[state[begin] == WALL], end[state[begin] == WALL]
    wide = (state[begin] == OPEN) & (edge[end] - edge[begin] > LONGEST_OPEN_M)
    opened, until = begin[wide], end[wide]
    while True:
        gap, length = edge[first[1:]] - edge[last[:-1]], edge[last] - edge[first]
        closed = np.searchsorted(opened, last[:-1]) == np.searchsorted(until, first[1:], side="right")
        beside = np.minimum(length[1:], length[:-1])
        fits = closed & (gap <= LONGEST_GAP_M) & (beside >= LEAST_SHARE * gap)
        if not fits.any():
            return first, last
        first, last = first[np.append(True, ~fits)], last[np.append(~fits, True)]


def _states(
    grid: MapCells, hits: NDArray, line: Array, cov: Array, along: Array
) -> tuple[NDArray[np.int64], NDArray[np.bool_], Array]:
    """OPEN, WALL or UNKNOWN at places (N,) along a line, whether a wall is sure there, and the evidence."""
    normal, tangent = unit(line[0]), unit(line[0] + 0.5 * np.pi)
    jacobian = np.stack([-along, np.ones_like(along)], axis=-1)  # of the place across the line
    spread = 2 * np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", jacobian, cov, jacobian), 0))
    reach = np.clip(spread, REACH_CELLS * grid.cell_m, MOST_REACH_CELLS * grid.cell_m)
    aside = reach[:, None] * np.linspace(-1, 1, int(4 * MOST_REACH_CELLS) + 1)
    point = (line[1] + aside)[..., None] * normal + along[:, None, None] * tangent
    cell, inside = grid.index(point)
    cell = np.where(inside[..., None], cell, 0)
    at = cell[..., 0], cell[..., 1]
    seen = inside & grid.observed[at]
    evidence = np.where(seen, grid.evidence[at], 0.0)
    hit = np.where(inside, hits[at], 0.0).max(axis=1)
    most = evidence.max(axis=1)
    solid = most > WALL_NAT
    is_wall = (hit > np.where(most < 0, FAINT_NAT, HIT_NAT)) | solid
    state = np.where(most < OPEN_NAT, OPEN, np.where(is_wall, WALL, UNKNOWN))
    return state, ((hit > SURE_HIT_NAT) & (most >= 0)) | solid, most


def _runs(values: NDArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Beginnings and ends (exclusive) of runs of equal values; at least one."""
    change = np.flatnonzero(values[1:] != values[:-1]) + 1
    return np.concatenate([[0], change]), np.concatenate([change, [len(values)]])
