"""Frames of clocks, joined once an anchor is set in two of them; docs/model.md, (M496)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.state.network.clock_search import NEVER, ClockSearch


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
