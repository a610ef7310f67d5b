"""Whether an agent looks where it goes; what it may mean if it never does.

An array that is mounted sideways, or angles of another axis, turn the heading by as much all the way, and the
positions stay right: nothing else in the measurements tells. Bearings in the world's frame hold it still.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gridslam.arrays import Array
from gridslam.checks.sights.line_of_sight_filter import Sight
from gridslam.estimates import Estimate
from gridslam.world.columns import Columns
from gridslam.world.geometry import wrap
from gridslam.world.scene import Scene

LEG_M, BLUNT_LEG_M, LEAST = 0.5, 1.0, 20
"""Way by which a course is told, of a run and by lines of sight; least number of steps that have one."""
WAVERS_RAD = 0.05
"""By how much of the way to the anchors a straight way seems to bend, as angles tell it."""
LEG_DEVIATIONS = 10.0
"""By how many deviations of the positions it does: a vague track isn't taken for a way that turns."""
ASIDE, BACKWARDS = np.radians(30.0), np.radians(150.0)
"""Mean angle between heading and course from which on the agent goes sideways, and backwards."""
STEADY, STILL, BENT = 0.95, 0.99, 0.9
"""Mean resultant lengths: of that angle where it is the same all the way (18 degrees), of a heading that
stays (8 degrees), and of courses that turn (a quarter of a turn, evenly)."""
HEADING, VAGUE_RAD = 4, np.radians(20.0)
"""Place of the heading in an estimate's covariance, and its deviation from which on nothing tells it."""


class Course(NamedTuple):
    """How headings lie to the way.

    Attributes
    ----------
    turn : complex
        Mean resultant of headings less courses.
    facing, way : complex
        Of headings, and of courses.
    """

    turn: complex
    facing: complex
    way: complex

    @classmethod
    def of(cls, place: Array, heading: Array, leg_m: float = LEG_M) -> Course | None:
        """Of a track (N, 2) in m with headings (N,) in rad, NaN where unknown; None where too few tell."""
        legs = np.reshape(_legs(place, leg_m), (-1, 2)).astype(int)
        middle = heading[legs.sum(1) // 2]
        legs, middle = legs[np.isfinite(middle)], middle[np.isfinite(middle)]
        if len(legs) < LEAST:
            return None
        way = place[legs[:, 1]] - place[legs[:, 0]]
        course = np.arctan2(way[:, 1], way[:, 0])
        return cls(_mean(wrap(middle - course)), _mean(middle), _mean(course))

    @classmethod
    def by_sight(cls, table: Columns, sight: Sight, scene: Scene) -> Course | None:
        """By lines of sight as `check` follows them; None where too few tell.

        Parameters
        ----------
        table : dict of (K,) arrays
            Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
        sight : Sight
            Its lines of sight.
        """
        rows = sight.row[sight.sure]
        if "aoa_rad" not in table or not len(sight.row):
            return None
        rows = rows[np.isfinite(table["aoa_rad"][rows])]
        number = np.searchsorted(np.unique(table["step"][sight.row]), table["step"][rows])
        away = sight.position_m[number] - scene.anchor_positions[table["anchor"][rows]]
        facing = np.arctan2(away[:, 1], away[:, 0]) + np.pi - table["aoa_rad"][rows]
        sums = np.zeros(len(sight.position_m), complex)
        np.add.at(sums, number, np.exp(1j * facing))
        heading = np.where(sums == 0, np.nan, np.angle(sums))
        course = cls.of(sight.position_m, heading, BLUNT_LEG_M)
        if course is None or not may_be_straight(sight):
            return course
        return course._replace(way=course.way / abs(course.way))

    def aside_rad(self) -> float | None:
        """By how much the heading is turned against the course all the way; None where it isn't."""
        turned = abs(self.turn) > STEADY and abs(np.angle(self.turn)) > ASIDE
        return float(np.angle(self.turn)) if turned else None

    def stays(self) -> bool:
        """Whether the heading hardly turns while the way does."""
        return abs(self.facing) > STILL and abs(self.way) < BENT


def course_note(estimates: Sequence[Estimate]) -> str | None:
    """What heading and motion say of angles of arrival; None where the agent looks where it goes.

    Parameters
    ----------
    estimates : sequence of Estimate
        Of all steps of a run; without headings that are known nothing is said.
    """
    place = np.array([one.position_m[:2] for one in estimates]).reshape(-1, 2)
    heading = np.array([_known_heading(one) for one in estimates])
    spread = [np.sqrt(np.trace(one.covariance[:2, :2])) for one in estimates]
    course = Course.of(place, heading, max(LEG_M, LEG_DEVIATIONS * float(np.median(spread or [0.0]))))
    if course is None:
        return None
    turn_rad = course.aside_rad()
    if turn_rad is not None:
        return f"it {aside_words(turn_rad)}"
    if course.stays():
        return (
            "its heading hardly turns while its way does: if it looks where it goes, aoa_rad is counted in "
            "the world's frame, and not in the agent's"
        )
    return None


def _known_heading(estimate: Estimate) -> float:
    """Heading of an estimate, rad; NaN where it has none, or nothing tells it, as of distances alone."""
    own, covariance = estimate.heading_rad, estimate.covariance
    if own is None or (len(covariance) > HEADING and covariance[HEADING, HEADING] > VAGUE_RAD**2):
        return np.nan
    return own


def may_be_straight(sight: Sight) -> bool:
    """Whether a way bends by no more than places told by lines of sight waver so far from the anchors."""
    place, step = sight.position_m, np.arange(len(sight.position_m), dtype=np.float64)
    far = sight.distance_m[sight.sure]
    if len(step) < LEAST or not len(far):
        return False
    design = np.column_stack([np.ones(len(step)), step])
    left = place - design @ np.linalg.lstsq(design, place, rcond=None)[0]
    return bool(np.sqrt((left**2).sum(1).mean()) < WAVERS_RAD * np.median(far))


def aside_words(turn_rad: float) -> str:
    """Of an agent whose heading is turned by so much against its course."""
    off = f"{abs(np.degrees(turn_rad)):.0f} degrees off its heading"
    return (
        f"{side_words(turn_rad)} all the way ({off}): is its array mounted so, or are aoa_rad and "
        "start_heading_deg counted from another axis of the agent?"
    )


def side_words(turn_rad: float) -> str:
    """Where an agent goes whose heading is turned by so much against its course."""
    if abs(turn_rad) <= ASIDE:
        return "goes ahead"
    return "goes " + (
        "backwards" if abs(turn_rad) > BACKWARDS else f"to its {'left' if turn_rad < 0 else 'right'}"
    )


def _legs(place: Array, leg_m: float) -> list[tuple[int, int]]:
    """Steps, each with the first one after it that is a leg away."""
    legs, end = [], 0
    for first in range(len(place)):
        end = max(end, first + 1)
        while end < len(place) and np.hypot(*(place[end] - place[first])) < leg_m:
            end += 1
        if end == len(place):
            break
        legs.append((first, end))
    return legs


def _mean(angle: Array) -> complex:
    """Mean resultant of angles, rad."""
    return complex(np.exp(1j * angle).mean())
