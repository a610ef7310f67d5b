"""Anchors that one mirror may show together: docs/model.md, (M546).

What comes over a wall, read as a line of sight, puts the agent behind the wall. The mirror turns all angles
the other way round, so that each anchor tells another heading there, but for anchors that lie in one line.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.geometry import unit, wrap

ALIKE_RAD = np.radians(25.0)
"""Within which the heading that a mirror shows and the one that was found are the same."""
DEVIATIONS = 2.0
"""Of the other place, by which the mirror may be turned."""


def shown_by_mirror(
    anchors: Array, believed: Array, other: Array, spread_m: float = 0.0, arrives: bool = True
) -> NDArray[np.bool_]:
    """Which anchors (J, 2) the mirror between a believed pose (3,) and another one shows at the other, (J,).

    Those on the believed pose's side of it whose reflections, read as lines of sight, tell the other heading.

    Parameters
    ----------
    spread_m : float
        Standard deviation of the other place, which turns the mirror.
    arrives : bool
        Whether arrivals tell headings: without, a mirror shows every anchor on its side.
    """
    step = other[:2] - believed[:2]
    within = ALIKE_RAD + 2 * DEVIATIONS * spread_m / max(float(np.hypot(*step)), 1e-6)
    wall = np.arctan2(step[1], step[0])
    before = np.asarray((anchors - 0.5 * (believed[:2] + other[:2])) @ unit(wall) < 0)
    if not arrives:
        return before
    toward = np.arctan2(*(anchors - other[:2]).T[::-1])
    told = 2 * toward + believed[2] - 2 * wall - np.pi
    return np.asarray(before & (np.abs(wrap(told - other[2])) < within))


def added_by_mirror(nats: Array, shown: NDArray[np.bool_]) -> float:
    """What a mirror may add to the loudest line of sight that it shows, of nats (J,) that anchors tell."""
    told = np.maximum(nats, 0.0) * shown
    return float(told.sum() - told.max(initial=0.0))
