"""Frames of clocks, joined once an anchor is set in two of them; docs/model.md, (M496), (M530)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.state.network.clock_search import CELL_M, NEVER, ClockSearch


def frames_joined(search: ClockSearch) -> ClockSearch:
    """With frames in which the same anchor is set made one, the common time's before agents'."""
    if not search.framed:
        return search
    while (pair := _tied(search)) is not None:
        search = _joined(search, *pair)
    return search


def _tied(search: ClockSearch) -> tuple[int, int] | None:
    """Two frames that an anchor ties together."""
    frames = [0, *sorted(set(search.frame.tolist()) - {0})]
    for number, one in enumerate(frames):
        for other in frames[number + 1 :]:
            if (~search.unset[search.rows(one)] & ~search.unset[search.rows(other)]).any():
                return one, other
    return None


def _joined(search: ClockSearch, one: int, other: int) -> ClockSearch:
    """With the second frame's agents in the first, where what either has set is set."""
    unset, log, doubt = search.unset.copy(), search.log.copy(), search.doubt.copy()
    into, gone = search.rows(one), search.rows(other)
    news = np.flatnonzero(unset[into] & ~unset[gone]) + into.start
    log[news] = np.where(log[news] > NEVER, 0.0, NEVER)
    unset[news], doubt[news], unset[gone] = False, 0.0, False
    return replace(
        search, unset=unset, log=log, doubt=doubt, frame=np.where(search.frame == other, one, search.frame)
    )


def set_nowhere(search: ClockSearch) -> NDArray[np.bool_]:
    """Anchors (J,) that are set in no frame."""
    frames = {0, *search.frame.tolist()}
    return np.asarray(np.all([search.unset[search.rows(one)] for one in frames], axis=0))


def within_priors(search: ClockSearch, half: Array, mean: Array, slack: Array) -> ClockSearch:
    """With offsets ruled out that would take another clock beyond its prior, (M530).

    What is set in a frame bounds the clock whose frame it is, since all of these clocks have priors; and so
    the offsets of the others in it, and, in other frames, of those that are set in it. An offset of which
    nothing would be left stays as it is.

    Parameters
    ----------
    half : (J + I,) m
        Half widths of the priors, anchors first.
    mean, slack : (R,) m
        Of offsets that are set, and how far off they may be.
    """
    log, anchors = search.log.copy(), search.anchors
    frames = [0, *sorted(set(search.frame.tolist()) - {0})]
    roots = {frame: _bounds(search, frame, half, mean, slack) for frame in frames}
    for frame in frames:
        for anchor in range(anchors):
            row = frame * anchors + anchor
            if not search.unset[row]:
                continue
            low, high = -half[anchor], half[anchor]
            for other in frames:
                own = other * anchors + anchor
                if not search.unset[own]:
                    least, most = roots[other]
                    low = max(low, mean[own] - slack[own] + least)
                    high = min(high, mean[own] + slack[own] + most)
            low, high = low - roots[frame][1] - CELL_M, high - roots[frame][0] + CELL_M
            left = np.where((search.centre >= low) & (search.centre <= high), log[row], NEVER)
            if left.max() > NEVER:
                log[row] = np.where(left > NEVER, left - left.max(), NEVER)
    return replace(search, log=log)


def _bounds(search: ClockSearch, frame: int, half: Array, mean: Array, slack: Array) -> tuple[float, float]:
    """Between which the clock lies whose frame it is, by what is set in it; its prior if nothing is left."""
    if not frame:
        return 0.0, 0.0
    own, anchors = search.rows(frame), search.anchors
    known, room, whole = ~search.unset[own], half[:anchors] + slack[own], float(half[anchors + frame - 1])
    low = float(np.max((-room - mean[own])[known], initial=-whole))
    high = float(np.min((room - mean[own])[known], initial=whole))
    return (low, high) if low <= high else (-whole, whole)
