"""Anchors that one mirror may show together: docs/model.md, (M546).

What comes over a wall, read as a line of sight, puts the agent behind the wall. The mirror turns all angles
the other way round, so that each anchor tells another heading there, but for anchors that lie in one line.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.geometry import wrap

IN_LINE_RAD = np.radians(20.0)
"""Angle between two directions up to which the headings that they tell hardly differ."""


def in_line(anchors: Array, place: Array) -> NDArray[np.bool_]:
    """Which of anchors (J, 2) lie nearly in one line with each other, seen from a place (2,), (J, J)."""
    toward = np.arctan2(*(anchors - place).T[::-1])
    apart = np.abs(wrap(2 * (toward[:, None] - toward)))  # twice: on either side of the place
    return np.asarray(apart < 2 * IN_LINE_RAD)


def shown_together(anchors: Array, place: Array, nats: Array) -> float:
    """Nats that one mirror may add to the loudest line of sight, of those that anchors (J,) tell at a place.

    Parameters
    ----------
    anchors : (J, 2) m
    place : (2,) m
    nats : (J,)
        Log likelihood of what each anchor sent, in ratio to clutter.
    """
    lines = np.maximum(nats, 0.0) * in_line(anchors, place)
    return float((lines.sum(1) - lines.max(1, initial=0.0)).max(initial=0.0))
