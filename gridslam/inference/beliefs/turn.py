"""A turn of everything about a place: what it does to a joint belief; docs/model.md, (M493)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import HEADING
from gridslam.world.geometry import unit


def direction(belief: Belief, place: Array, turning: NDArray[np.bool_] | None = None) -> Array:
    """By how much all entries of a belief change when all turns about a place (2,), per rad, (N,).

    Parameters
    ----------
    turning : (I,) bool, optional
        Which agents do; default: all.
    """
    mean, lines, layout = belief.mean, belief.lines, belief.layout
    way = np.zeros(len(mean))
    for agent in range(layout.agents) if turning is None else np.flatnonzero(turning).tolist():
        own, at = mean[layout.pose(agent)], layout.pose(agent).start
        way[at], way[at + 1] = place[1] - own[1], own[0] - place[0]
        way[at + 2], way[at + 3], way[at + HEADING] = -own[3], own[2], 1.0
    way[layout.angles] = 1.0
    way[layout.offsets] = unit(lines[:, 0] + 0.5 * np.pi) @ place
    return way
