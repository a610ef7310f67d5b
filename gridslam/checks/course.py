"""Whether the agent that a run followed looks where it goes; what it may mean if it never does.

An array that is mounted sideways, or angles of another axis, turn the heading by as much all the way, and the
positions stay right: nothing else in the measurements tells. Bearings in the world's frame hold it still.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.arrays import Array
from gridslam.estimates import Estimate
from gridslam.world.geometry import wrap

LEG_M, LEAST = 0.5, 20
"""Way by which a course is told, and the least number of steps that have one."""
ASIDE, BACKWARDS = np.radians(30.0), np.radians(150.0)
"""Mean angle between heading and course from which on the agent goes sideways, and backwards."""
STEADY, STILL, BENT = 0.95, 0.98, 0.7
"""Mean resultant lengths: of that angle where it is the same all the way (18 degrees), of a heading that
stays (11 degrees), and of courses that turn."""


def course_note(estimates: Sequence[Estimate]) -> str | None:
    """What heading and motion say of angles of arrival; None where the agent looks where it goes.

    Parameters
    ----------
    estimates : sequence of Estimate
        Of all steps of a run; without headings nothing is said.
    """
    place = np.array([one.position_m[:2] for one in estimates]).reshape(-1, 2)
    heading = np.array([np.nan if one.heading_rad is None else one.heading_rad for one in estimates])
    legs = _legs(place)
    at = np.array([first for first, _ in legs if np.isfinite(heading[first])], dtype=int)
    if len(at) < LEAST:
        return None
    until = dict(legs)
    way = np.array([place[until[first]] - place[first] for first in at])
    course = np.arctan2(way[:, 1], way[:, 0])
    middle = np.array([heading[(first + until[first]) // 2] for first in at])
    turn = _mean(wrap(middle - course))
    if abs(turn) > STEADY and abs(np.angle(turn)) > ASIDE:
        return _aside(float(np.angle(turn)))
    if abs(_mean(middle)) > STILL and abs(_mean(course)) < BENT:
        return (
            "its heading hardly turns while its way does: if it looks where it goes, aoa_rad is counted in "
            "the world's frame, and not in the agent's"
        )
    return None


def _aside(turn_rad: float) -> str:
    """Of an agent whose heading is turned by so much against its course."""
    side = "backwards" if abs(turn_rad) > BACKWARDS else "to its left" if turn_rad < 0 else "to its right"
    return (
        f"it goes {side} all the way ({abs(np.degrees(turn_rad)):.0f} degrees off its heading): is its array "
        "mounted so, or are aoa_rad and start_heading_deg counted from another axis of the agent?"
    )


def _legs(place: Array) -> list[tuple[int, int]]:
    """Steps, each with the first one after it that is a leg away."""
    legs, end = [], 0
    for first in range(len(place)):
        end = max(end, first + 1)
        while end < len(place) and np.hypot(*(place[end] - place[first])) < LEG_M:
            end += 1
        if end == len(place):
            break
        legs.append((first, end))
    return legs


def _mean(angle: Array) -> complex:
    """Mean resultant of angles, rad."""
    return complex(np.exp(1j * angle).mean())
