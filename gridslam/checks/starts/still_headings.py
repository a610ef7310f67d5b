"""Arrivals in the world's frame that pass for the agent's: a heading that stays on a way that turns.

Counted clockwise, or from another axis than x, they fit once they are read so: the agent then faces one way.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.checks.sights.course import Course
from gridslam.checks.sights.fit import least_share, tells_place
from gridslam.checks.sights.line_of_sight_filter import Sight
from gridslam.checks.starts.start_search import one_in_sight
from gridslam.checks.tables.unit_hypotheses import ADVICE, Suspicion
from gridslam.world.columns import Columns
from gridslam.world.geometry import wrap
from gridslam.world.scene import Scene

NEAR_RAD = np.radians(10.0)
"""How near the heading that stays is to that of an axis which is named."""
BEHIND = {("aoa_rad", "flipped"), ("aoa_rad", "backwards"), ("start", "start")}
"""Columns and kinds of suspicions that such arrivals bring."""


def with_frame(found: list[Suspicion], read: Columns, sight: Sight, scene: Scene) -> list[Suspicion]:
    """Suspicions, with directions in the world in the place of one about arrivals, or where there is none.

    Parameters
    ----------
    read : dict of (K,) arrays
        The table as the suspicions say that it should have been, in the order of steps.
    sight : Sight
        What is explained then.
    """
    bearings = [item for item in found if (item.column, item.kind) == ("aod_rad", "compass")]
    found = [item for item in found if item not in bearings]
    named = _with_frame(found, read, sight, scene)
    return [*bearings, *(named if found or not bearings else [])]


def _with_frame(found: list[Suspicion], read: Columns, sight: Sight, scene: Scene) -> list[Suspicion]:
    """As `with_frame`, of what isn't suspected of departures."""
    kinds = {(item.column, item.kind) for item in found}
    if kinds - BEHIND or len(found) > 1 or not tells_place(read) or one_in_sight(sight):
        return found
    course = Course.by_sight(read, sight, scene) if sight.explained >= least_share(scene) else None
    if course is None or not course.stays():
        return found
    facing = float(np.angle(course.facing))
    degrees = round(float(np.degrees(facing)))
    reason = f"so read, the agent faces {degrees} degrees all the way, while its way turns"
    text = _words(facing + np.pi * (("aoa_rad", "backwards") in kinds), ("aoa_rad", "flipped") in kinds)
    if found and found[0].column == "aoa_rad":
        return [replace(found[0], kind="world frame", text=text, reason=f"{reason}; {found[0].reason}")]
    return [Suspicion("aoa_rad", "world frame", text, False, f"{reason}; nothing is wrong if it does")]


def _words(axis_rad: float, clockwise: bool) -> str:
    """What arrivals are, counted from an axis of the world."""
    degrees = round(float(np.degrees(wrap(axis_rad))))
    own = "where the angle from the agent's heading, counter-clockwise, belongs"
    if clockwise and abs(wrap(axis_rad - 0.5 * np.pi)) < NEAR_RAD:
        return f"directions in the world, counted clockwise from north (compass bearings), {own}"
    if clockwise:
        return f"directions in the world, counted clockwise from an axis at {degrees} degrees, {own}"
    if abs(wrap(axis_rad)) < NEAR_RAD:
        return ADVICE["world frame of arrival"]
    return f"directions in the world, counted from an axis at {degrees} degrees, {own}"
