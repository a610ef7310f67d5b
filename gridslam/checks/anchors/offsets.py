"""An offset of all distances where one anchor at a time is in sight: beside other suspicions, or alone.

Least squares need several anchors at once. Here the way that the agent goes from its start tells an offset,
as it tells another reading of a column: the two are weighed against each other.
"""

from __future__ import annotations

from dataclasses import replace

from gridslam.checks.anchors.rivals import (
    ALIKE,
    CERTAIN,
    CLEAR,
    FAIR_CROWD,
    MOST_BEHIND,
    STRAIGHT_RAD,
    Cure,
    both_measured,
)
from gridslam.checks.scene.allowed_for import error_allowed
from gridslam.checks.scene.range_errors import RangeError
from gridslam.checks.scene.range_words import error_words
from gridslam.checks.sights.fit import FITTING, least_share
from gridslam.checks.sights.line_of_sight_filter import Sight, explain, turning_rad
from gridslam.checks.tables.unit_hypotheses import Suspicion, told_after
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

NO_RIVAL_OF = {"offset", "slant", "rise", "plan", "names", "turned", "start", "agent", "second device"}
"""Kinds of suspicions that have been weighed against an offset already, or that none can stand for."""


def offset_beside(
    found: list[Suspicion], table: Columns, read: Columns, scene: Scene, agent: str | None, sight: Sight
) -> list[Suspicion]:
    """Suspicions of angles or units, with an offset of all distances beside them if it explains as much.

    Where one anchor at a time is in sight, another reading of a column and an offset can't be told apart: the
    one that explains more comes first, and neither is certain.

    Parameters
    ----------
    found : list of Suspicion
    table, read : dict of (K,) arrays
        As it stands, and with the columns read as the suspicions say; columns as of
        `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    scene : Scene
    agent : str or None
        Whose table it is.
    sight : Sight
        What is explained with the columns so read.
    """
    kinds = {item.kind for item in found}
    if not found or kinds & NO_RIVAL_OF or not both_measured(table):
        return found
    error = _of_all(scene)
    rival = _with_offset(found, table, scene, agent)
    gain = _gain(rival, read, scene, agent, sight) if _is_rival(rival, scene, sight) else None
    if gain is None or gain < -MOST_BEHIND:
        return found
    more = "more than" if gain > CLEAR else "as much as" if gain > -CLEAR else "less than"
    reason = (
        f"line of sight in {rival.explained:.0%} of {rival.judged}: {more} what else is suspected "
        f"(log likelihood ratio {gain:.0f}); one anchor at a time can't tell them apart"
    )
    own = Suspicion("distance_m", "offset", error_words(error, rival.size_m, scene, agent), False, reason)
    others = [replace(item, certain=False) for item in found]
    if gain > CERTAIN:  # another reading of the distances is worse by far
        others = [item for item in others if item.column != "distance_m"]
    first, then = ([own], others) if gain > CLEAR else (others, [own])
    return [*first, *(told_after(item, first) for item in then)]


def _of_all(scene: Scene) -> RangeError:
    """The offset of all anchors' distances."""
    return RangeError("offset", tuple(range(len(scene.anchors))))


def _with_offset(found: list[Suspicion], table: Columns, scene: Scene, agent: str | None) -> Sight:
    """What an offset explains of the table as it stands, or of arrivals in the world, if suspected."""
    error = _of_all(scene)
    rival = explain(table, scene, agent, error=error)
    if ("aoa_rad", "world frame") not in {(item.column, item.kind) for item in found}:
        return rival
    # who goes straight ahead along x measures in the world, too: the offset bends the way
    ahead = explain(table, scene, agent, True, error)
    bends = min(turning_rad(one.position_m) for one in (rival, ahead))
    return ahead if ahead.evidence > rival.evidence and bends < STRAIGHT_RAD else rival


def _is_rival(rival: Sight, scene: Scene, sight: Sight) -> bool:
    """Whether an offset is large enough to be told, and explains as much as the reading it stands beside."""
    # where nobody knows how much can be explained, a rival must explain as much as what it is named beside
    least = FITTING if scene.walls else max(least_share(scene), ALIKE * sight.explained)
    near = rival.explained >= least and rival.evidence >= sight.evidence - MOST_BEHIND
    return near and abs(rival.size_m) >= _of_all(scene).least_m


def _gain(rival: Sight, read: Columns, scene: Scene, agent: str | None, sight: Sight) -> float:
    """Log likelihood ratio in nats of an offset to the reading, with or without one."""
    free = explain(read, scene, agent, error=_of_all(scene))  # to be fair: it gains on the reading, too
    freed = free.evidence if free.explained >= least_share(scene) else -float("inf")
    return rival.evidence - max(sight.evidence, freed)


def offset_alone(table: Columns, scene: Scene, agent: str | None, sight: Sight) -> Cure | None:
    """An offset of all distances where one anchor is in sight, if it explains clearly more of a table.

    Least squares need several anchors at once; the way that the agent goes from its start tells, too.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    sight : Sight
        What is explained as it stands.
    """
    error = _of_all(scene)
    if explain(table, scene, agent, error=error).evidence < sight.evidence + CERTAIN:
        return None
    moved, still = (explain(table, scene, agent, error=one, crowd=FAIR_CROWD) for one in (error, None))
    gain = moved.evidence - still.evidence
    if moved.explained < least_share(scene) or gain < CERTAIN or abs(moved.size_m) < error.least_m:
        return None
    if error_allowed(error, moved.size_m, scene, agent):
        return None
    reason = (
        f"line of sight in {moved.explained:.0%} of {moved.judged}, {sight.explained:.0%} as it stands; "
        f"log likelihood ratio {gain:.0f}; one anchor in sight can't tell it from another start"
    )
    suspicion = Suspicion(
        "distance_m", "offset", error_words(error, moved.size_m, scene, agent), False, reason
    )
    cured = table | {"distance_m": table["distance_m"] - moved.size_m}
    return Cure(suspicion, cured, explain(cured, scene, agent))
