"""Tables that begin late: steps count from 0, from the start on, so silent ones come before the first row."""

from __future__ import annotations

import numpy as np

from gridslam.checks.sights.handovers import Ties
from gridslam.checks.starts.told_start import KNOWN_M, lies_far
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

FEW = 5
"""First step up to which nothing is said: a start known to decimetres outlives that much silence."""
APART_M = 1.0
"""Way in the silent steps, at the pace of the first rows, from which on the start can't be at both ends."""


def late_words(first: int) -> str:
    """What is said of a table whose first row is of this step."""
    return (
        f"step: the table begins at step {first}: {first} silent steps come before it, from the start on; "
        "if the start is where the table begins, count steps from 0"
    )


def late_line(table: Columns) -> str | None:
    """That silent steps come before the first row; None where hardly any do."""
    first = int(table["step"].min()) if len(table["step"]) else 0
    return late_words(first) if first > FEW else None


def begins_at_start(table: Columns, scene: Scene, agent: str | None) -> bool:
    """Whether the first rows put a moving agent at the told start, after silent steps in which it left it.

    One that stood still, or that came from the start in silence, isn't called.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    """
    order = np.argsort(table["step"], kind="stable")
    rows = {name: values[order] for name, values in table.items()}
    ties = Ties.of(rows, scene, agent) if agent is not None else None
    start = ties.start if ties is not None else None
    if start is None or agent is None or start.spread_m > KNOWN_M or lies_far(start, scene, agent):
        return False
    return bool(np.hypot(*start.pace_m) * int(rows["step"][0]) > APART_M)
