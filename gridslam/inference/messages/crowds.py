"""Crowds of nearly identical paths, as of a curved wall, count as one; docs/model.md, (M231)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.messages.likelihood_ratios import Pairs
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.kernels.primitives.tables import (
    AMPLITUDE,
    AOA,
    DENSITY,
    DISTANCE,
    LABEL,
    OWN_STD,
    SCAN_ROW,
    VARIANCE,
)
from gridslam.world.geometry import wrap

NEAR_M, NEAR_RAD = 1.0, 0.3
"""Distance and AoA within which measurements may be those of one wall's neighbouring pieces."""
FAINT = 15.0
"""Amplitude above which a path is told from its neighbours by its own angles."""
OTHERS = 3
"""Neighbours that make a crowd."""


def neighbours(table: Array) -> NDArray[np.bool_]:
    """Which measurements stand in a crowd, and with which others, (M, M); rows of others are empty.

    Parameters
    ----------
    table : (M, SCAN_COLUMNS)
        That of `AnchorScan`. What lacks distance, AoA or amplitude is in no crowd.
    """
    none = np.zeros((len(table), len(table)), dtype=bool)
    if not _close(table[:, DISTANCE].tolist()):  # as at most steps
        return none
    amplitude, told = table[:, AMPLITUDE], table[:, [OWN_STD + DISTANCE, OWN_STD + AOA]]
    (able,) = ((told >= 0).all(1) & (amplitude >= 0) & (amplitude < FAINT)).nonzero()
    if not _close(table[able, DISTANCE].tolist()):
        return none
    (distance, _, arrival), label = table[able, :3].T, table[able, LABEL]
    near = (np.abs(distance[:, None] - distance) < NEAR_M) & (label[:, None] == label)
    near &= np.abs(wrap(arrival[:, None] - arrival)) < NEAR_RAD
    crowd = near.sum(1) > OTHERS
    if not crowd.any():
        return none
    near[~crowd] = False
    none[np.ix_(able, able)] = near
    return none


def _close(lengths: list[float]) -> bool:
    """Whether so many of some lengths (m) that they may make a crowd are about the same."""
    lengths.sort()
    return any(last - first < 2 * NEAR_M for first, last in zip(lengths, lengths[OTHERS:], strict=False))


def of_one_way(near: NDArray[np.bool_], beta: Array, image: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Those neighbours (M, M) that seem to have come the same way: straight, over floor, or over ceiling.

    What a wall sends over floor and ceiling is heard close to what it sends straight, but no other piece of
    it sent that, and known heights tell one from the other.

    Parameters
    ----------
    near : (M, M)
        As of `neighbours`.
    beta : (L, M)
        What each path sends into the association; the likeliest tells the way.
    image : (L,) int
        Which images each path comes from: 0 for the anchors themselves.
    """
    if not (near.any() and image.any()):
        return near
    way = image[beta.argmax(0)]
    alike = near & (way[:, None] == way)
    alike[alike.sum(1) <= OTHERS] = False
    return np.asarray(alike, np.bool_)


def crowded_as_one(pairs: Pairs, scan: AnchorScan, near: NDArray[np.bool_] | None = None) -> Pairs:
    """The pairs, a crowd's widened: all of it together tells what one measurement of its middle would.

    Which of many paths that differ by centimetres caused which measurement is a guess, and wrong guesses
    agree with each other: taken as independent, they make the filter sure of an error. Pairs without a crowd
    stay the same object.

    Parameters
    ----------
    near : (M, M), optional
        The `neighbours`, where they are known.
    """
    near = neighbours(scan.table) if near is None else near
    if not near.any():
        return pairs
    count, index = near.sum(1), pairs.index[: len(pairs), SCAN_ROW]
    rows = np.flatnonzero(count[index])
    scatter = np.zeros((len(near), 3))
    for m in np.flatnonzero(count):
        gap = scan.table[near[m], :3] - scan.table[m, :3]
        gap[:, 1:] = wrap(gap[:, 1:])
        scatter[m] = gap.var(0)
    pair, chosen = pairs.pair.copy(), index[rows]
    variance = slice(VARIANCE, DENSITY)
    pair[rows, variance] = (pair[rows, variance] + scatter[chosen]) * count[chosen, None]
    return replace(pairs, pair=pair)
