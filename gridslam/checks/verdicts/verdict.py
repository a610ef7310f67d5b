"""What `check` says of a table of measurements in which nothing is suspected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.checks.anchors.range_fit import steps_to_judge_by
from gridslam.checks.anchors.rivals import both_measured, fitting_cure, range_errors
from gridslam.checks.anchors.turned_anchors import UNSEEN
from gridslam.checks.anchors.whose import whose
from gridslam.checks.scene.allowed_for import error_allowed
from gridslam.checks.sights.course import Course, aside_words
from gridslam.checks.sights.fit import BLIND, FITTING, fitting, settled, tells_place
from gridslam.checks.sights.handovers import FIRST, Ties, heard_alone
from gridslam.checks.sights.line_of_sight_filter import Sight, explain
from gridslam.checks.starts.followed import followed
from gridslam.checks.starts.start_search import one_in_sight
from gridslam.checks.tables.unit_hypotheses import ANGLES, finite
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene
from gridslam.world.scene_derived import mounting_std_of

UNSURE = "unsure: "
"""Begins a line that says that a table can't be judged."""
FEW = 10
"""Scans below which little can be told."""
LEAST_SIGHTS = 8.0
"""Expected lines of sight from which on an anchor was in sight."""
LONGEST = 1000
"""Steps over which it is looked for."""
MANY = 20
"""Steps with lines of sight to two anchors from which on errors of distances show."""


def verdict(columns: Columns, place: NDArray[np.intp] | None, scene: Scene, agent: str | None) -> str:
    """What is said of a table in which nothing is suspected, in a line.

    Parameters
    ----------
    columns : dict of (K,) arrays
    place : (J,) int or None
        Which of the scene's anchors each of the table's is; None if that isn't known.
    scene : Scene
    agent : str or None
        Whose table it is.
    """
    if place is None or not len(columns["step"]):
        return "nothing to compare with the scene"
    order = np.argsort(columns["step"], kind="stable")
    sorted_rows = {name: values[order] for name, values in columns.items()}
    table = sorted_rows | {"anchor": place[columns["anchor"][order]]}
    seen = followed(table, scene, agent, explain(table, scene, agent))
    seen = _by_anchors(table, scene, agent, _by_clocks(table, scene, agent, seen))
    share = f"{seen.explained:.0%}" if seen.scans >= FEW else f"about {seen.explained * seen.scans:.0f}"
    line = f"line of sight to the anchors in {share} of {seen.judged}"
    if seen.explained >= fitting(scene):
        return line + _fits(table, scene, agent, seen)
    if len(scene.anchors) > 1:
        line += f" ({_each(scene, seen)})"
    return _falls_short(line, table, scene, agent, seen)


def _fits(table: Columns, scene: Scene, agent: str | None, seen: Sight) -> str:
    """What is said where lines of sight explain the rows: that they fit, and what isn't told by that."""
    alone = _alone(table, scene, agent, seen)
    line = f": units and frames fit the scene{_as_far_as(alone, scene)}{_rest(table, seen)}"
    if seen.scans < FEW:
        return f"{line}, as far as so few scans tell"
    both = steps_to_judge_by(table, seen, scene)
    if both < MANY and both_measured(table):
        total = len(np.unique(table["step"]))
        line += f"; heights and clocks can't be told: two anchors at once at {both} of {total} steps"
    line += _cannot_be_told(alone, scene) + _start_unseen(table, scene, agent)
    line += whose(table, scene, agent, seen)
    return line + _not_judged(table, scene, seen) + _aside(table, scene, seen)


def _falls_short(line: str, table: Columns, scene: Scene, agent: str | None, seen: Sight) -> str:
    """What is said where they don't, after a line that says how much: unsure, or suspect, and why."""
    if not any(len(finite(table, name)) for name in ANGLES):
        return f"{line}: distances alone don't tell where the agent is, so that nothing more can be said"
    if seen.explained < BLIND or seen.scans < FEW:
        whether = "whether units and frames are right; no single cure explains the rows"
        return f"{UNSURE}{line}: too few to tell {whether}"
    if scene.walls and not tells_place(table) and seen.evidence > 0:
        where = "one anchor, without angles of departure, doesn't tell where the agent is"
        return f"{UNSURE}{line}: {where}, so that nobody knows when walls hide the anchor"
    if scene.walls:
        return f"suspect: {line}: does not fit the scene, and no single cure explains the rows"
    unseen = _never_seen(table, scene, agent, seen)
    if unseen:
        which = f"{', '.join(unseen)} {'is' if len(unseen) == 1 else 'are'} never in line of sight"
        return (
            f"{UNSURE}{line}: {which}: hidden by walls, of which the scene has none, or its rows are wrong; "
            "give the scene the walls that you know, or a way that passes there"
        )
    hidden = "walls, of which the scene has none, may hide anchors"
    more = f"{hidden}{_rest(table, seen)}{_not_judged(table, scene, seen)}"
    return f"{line}: no other reading of a column explains more; {more}"


def _by_clocks(table: Columns, scene: Scene, agent: str | None, seen: Sight) -> Sight:
    """What is explained, or what is with an offset that the scene's clocks allow for."""
    if scene.clocks is None or seen.explained >= FITTING:
        return seen
    offsets = [error for error in range_errors(scene) if error.kind == "offset"]
    others = [(error, settled(table, scene, agent, error=error)) for error in offsets]
    allowed = [one for error, one in others if error_allowed(error, one.size_m, scene, agent)]
    return max([seen, *allowed], key=lambda one: one.explained)


def _by_anchors(table: Columns, scene: Scene, agent: str | None, seen: Sight) -> Sight:
    """What is explained, or what is with anchors as the scene's deviations of them allow for."""
    if not mounting_std_of(scene.anchors).any() or seen.explained >= FITTING:
        return seen
    cure = fitting_cure(table, scene, agent, seen)
    allowed = [cure.sight] if cure is not None and cure.suspicion is None else []
    return max([seen, *allowed], key=lambda one: one.explained)


def _each(scene: Scene, seen: Sight) -> str:
    """Shares of anchors that were heard."""
    each = zip(scene.anchor_names, seen.shares, strict=True)
    return ", ".join(f"{name} {share:.0%}" for name, share in each if share == share)


def _alone(table: Columns, scene: Scene, agent: str | None, seen: Sight) -> list[int]:
    """Anchors of several that nothing ties to another one or to the start: they fit however they stand."""
    if len(scene.anchors) < 2:
        return []
    ties = Ties.of(table, scene, agent)
    return ties.untied(scene, agent) if ties is not None else heard_alone(table, seen, scene, agent)


def _as_far_as(alone: list[int], scene: Scene) -> str:
    """Which anchors that is said of, if not of all."""
    names = [name for number, name in enumerate(scene.anchor_names) if number not in alone]
    if not alone or not names:
        return ""
    which = f"anchor {names[0]} tells" if len(names) == 1 else f"anchors {', '.join(names)} tell"
    return f" as far as {which}"


def _cannot_be_told(alone: list[int], scene: Scene) -> str:
    """What nothing tells of anchors that are heard one at a time."""
    if not alone:
        return ""
    names = [scene.anchor_names[number] for number in alone]
    if len(names) == 1:
        told = "how it is turned, where it stands and which one it is can't be told"
        return f"; not sure: anchor {names[0]} is heard alone, or not where others put the agent: {told}"
    told = "how they are turned, where they stand and which is which can't be told"
    each = f"anchors {', '.join(names)} are heard one at a time, or not where others put the agent"
    return f"; not sure: {each}: {told}"


def _start_unseen(table: Columns, scene: Scene, agent: str | None) -> str:
    """That nothing tells of the start, in a scene with walls, where anchors alone tell where the agent is."""
    ties = Ties.of(table, scene, agent) if scene.walls and agent is not None else None
    if ties is None or ties.start is not None:
        return ""
    few = f"too few lines of sight in the first {FIRST} steps"
    return f"; whether the start and its heading are right can't be told, for {few}"


def _rest(table: Columns, seen: Sight) -> str:
    """Which steps weren't looked at: what is wrong from there on isn't known."""
    if seen.first is None:
        return ""
    begin, last = int(table["step"][0]) + seen.first, int(table["step"][-1])
    which = f"step {last} wasn't" if begin == last else f"steps {begin} to {last} weren't"
    return f"; {which} looked at"


def _aside(table: Columns, scene: Scene, seen: Sight) -> str:
    """That the agent never looks where it goes, where it doesn't."""
    course = Course.by_sight(table, seen, scene) if tells_place(table) and not one_in_sight(seen) else None
    turn_rad = course.aside_rad() if course is not None else None
    return "" if turn_rad is None else f"; the agent {aside_words(turn_rad)}"


def _not_judged(table: Columns, scene: Scene, seen: Sight) -> str:
    """Which anchors are hardly in sight in the scans that were looked at, so that nothing is said of them."""
    scans = np.bincount(table["anchor"][seen.row], minlength=len(scene.anchors))
    names = zip(scene.anchor_names, scans, np.nan_to_num(seen.shares), strict=True)
    few = [f"{name} (in {share:.0%} of {n} scans)" for name, n, share in names if n >= FEW and share < UNSEEN]
    which = f"the first {seen.first} steps" if seen.first else "all steps"
    return f"; not judged, for too few lines of sight in {which}: {', '.join(few)}" if few else ""


def _never_seen(table: Columns, scene: Scene, agent: str | None, seen: Sight) -> list[str]:
    """Anchors that were heard often, and never in line of sight: nothing tells whether their rows are right.

    Where that seems so over the first steps, the agent is followed on.
    """
    if np.nanmin(seen.shares) >= UNSEEN:
        return []
    whole = int(np.ptp(table["step"])) + 1
    seen = explain(table, scene, agent, thorough=True, steps=min(whole, LONGEST), across=True)
    heard = np.bincount(table["anchor"][seen.row], minlength=len(scene.anchors))
    expected = np.nan_to_num(seen.shares) * heard
    names = zip(scene.anchor_names, heard, expected, strict=True)
    return [name for name, scans, sights in names if scans >= FEW and sights < LEAST_SIGHTS]
