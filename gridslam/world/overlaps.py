"""Walls drawn twice: where reflecting pieces lie on one line and overlap, the overlap is there once.

Rooms of a floor plan share sides. Two mirrors at one place would each reflect every path.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.geometry import COLLINEAR_M

Parts = tuple[NDArray[np.intp], Array, NDArray[np.intp], Array]


def clipped(start: Array, end: Array, surface: NDArray[np.intp], rank: NDArray[np.intp]) -> Parts:
    """What is left of pieces of walls, and what each repeats of others.

    Parameters
    ----------
    start, end : (P, 2) float64, m
    surface : (P,) int
        Line on which each piece lies.
    rank : (P,) int
        Which of two pieces stays whole: that of the lower rank; -1: neither is cut, as it reflects nothing.

    Returns
    -------
    piece : (N,) int
        Rising: of which piece each part is.
    share : (N, 2) float64
        From where to where along the piece, 0 to 1; whole pieces are exactly 0 to 1.
    pair : (K, 2) int
        Pieces of which the first repeats the second.
    length_m : (K,) float64
        How much of it.
    """
    return _clipped(start.tobytes(), end.tobytes(), surface.tobytes(), rank.tobytes())


@lru_cache(maxsize=64)
def _clipped(start_bytes: bytes, end_bytes: bytes, surface_bytes: bytes, rank_bytes: bytes) -> Parts:
    """`clipped` of the same arrays, as bytes; kept, since the pieces of a scene are asked for often."""
    start, end = (np.frombuffer(raw).reshape(-1, 2) for raw in (start_bytes, end_bytes))
    surface, rank = (np.frombuffer(raw, dtype=np.intp) for raw in (surface_bytes, rank_bytes))
    left = {piece: [(0.0, 1.0)] for piece in range(len(start))}
    repeats: list[tuple[int, int, float]] = []
    mirrors = np.flatnonzero(rank >= 0)
    for line in np.flatnonzero(np.bincount(surface[mirrors], minlength=1) > 1):
        own = mirrors[surface[mirrors] == line]
        own = own[np.argsort(rank[own], kind="stable")]
        along = end[own[0]] - start[own[0]]
        along = along / np.linalg.norm(along)
        reach = np.stack([start[own] @ along, end[own] @ along], 1)
        low, high = reach.min(1), reach.max(1)
        for number, piece in enumerate(own.tolist()):
            first, span = reach[number, 0], reach[number, 1] - reach[number, 0]
            for before in range(number):
                common = min(high[number], high[before]) - max(low[number], low[before])
                if common <= COLLINEAR_M:
                    continue
                hidden = sorted(((low[before] - first) / span, (high[before] - first) / span))
                kept = _without(left[piece], hidden[0], hidden[1], COLLINEAR_M / abs(span))
                gone = sum(b - a for a, b in left[piece]) - sum(b - a for a, b in kept)
                if gone > 0:
                    repeats.append((piece, int(own[before]), float(gone * abs(span))))
                left[piece] = kept
    count = [len(left[piece]) for piece in range(len(start))]
    share = [part for piece in range(len(start)) for part in left[piece]]
    pair = np.array([row[:2] for row in repeats], dtype=np.intp).reshape(-1, 2)
    piece = np.repeat(np.arange(len(start)), count)
    return piece, np.reshape(share, (-1, 2)), pair, np.array([row[2] for row in repeats])


def _without(
    parts: list[tuple[float, float]], low: float, high: float, least: float
) -> list[tuple[float, float]]:
    """Parts of a piece less a stretch of it; what would be shorter than `least` is no part."""
    rest = []
    for a, b in parts:
        if high <= a or low >= b:
            rest.append((a, b))
        else:
            rest += [(c, d) for c, d in ((a, min(b, low)), (max(a, high), b)) if d - c > least]
    return rest
