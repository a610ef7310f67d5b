"""What looks wrong with a table against the scene: every cure there is, and the one that explains most."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.checks.anchors.misplaced import with_places
from gridslam.checks.anchors.rivals import (
    ALIKE,
    CERTAIN,
    EXPLAINED,
    MOST_BEHIND,
    both_measured,
    fitting_cure,
    offset_alone,
    offset_beside,
    whole_cure,
)
from gridslam.checks.columns import elevations, time_units
from gridslam.checks.columns.loudness import loudness
from gridslam.checks.sights.fit import least_share, tells_place
from gridslam.checks.sights.handovers import Ties
from gridslam.checks.sights.line_of_sight_filter import Sight, explain
from gridslam.checks.starts.followed import followed, upheld
from gridslam.checks.starts.start_search import (
    ELSEWHERE,
    MANY_STARTS,
    RIVAL,
    goes_ahead,
    one_in_sight,
    other_start,
)
from gridslam.checks.starts.still_headings import with_frame
from gridslam.checks.tables.unit_hypotheses import ANGLES, Suspicion, finite, told_after
from gridslam.checks.verdicts import by_handovers
from gridslam.checks.verdicts.column_readings import likeliest_way, rival_of_start
from gridslam.checks.verdicts.reflections_instead import (
    are_faint_and_hidden,
    takes_reflections,
    through_walls,
)
from gridslam.checks.verdicts.second_device import second_device
from gridslam.world.columns import VALUES, Columns
from gridslam.world.scene import Scene

AHEAD = 0.7
"""Cosine between course and heading from which on an agent moves ahead, or backwards if negative."""


def against_scene(table: Columns, scene: Scene, agent: str | None, known: set[str]) -> list[Suspicion]:
    """What the lines of sight to the scene's anchors show of a table.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    known : set of str
        Columns of which something is known to be wrong already.
    """
    order = np.argsort(table["step"], kind="stable")
    asis = {name: values[order] for name, values in table.items()}
    if not any(len(finite(asis, name)) for name in VALUES if name != "amplitude"):
        return []
    plain = explain(asis, scene, agent)
    found, read, sight = _best_cure(asis, scene, agent, plain)
    if _refuted(found, asis, scene, agent, plain, sight):
        found, read, sight = [], asis, followed(asis, scene, agent, plain)
    kinds, cured = {item.kind for item in found}, read
    fits = sight.explained >= (EXPLAINED if scene.walls else least_share(scene))
    if fits and not kinds & ELSEWHERE and not {"distance_m", "anchor"} & {i.column for i in found}:
        cure = fitting_cure(read, scene, agent, sight)
        if cure is None and not found and one_in_sight(sight) and both_measured(asis):
            cure = offset_alone(asis, scene, agent, sight)
        if cure is not None and cure.suspicion is not None and cure.suspicion.kind == "turned":
            held = upheld(read, cure.table, [cure.suspicion], scene, agent, sight, CERTAIN)
            cure = cure if held is None else None
        if cure is not None:
            found += [_doubted(cure.suspicion, sight)] if cure.suspicion is not None else []
            sight, cured = cure.sight, cure.table
        if not found and cure is None and both_measured(asis):
            # from a wrong heading the right one is found, some steps later
            found, read, sight = _start_or_column(asis, scene, agent, sight)
    found = offset_beside(found, asis, read, scene, agent, sight)
    found = with_places(found, asis, scene, agent, cured)
    if _refuted(found, asis, scene, agent, plain, sight):
        found, read, sight = [], asis, followed(asis, scene, agent, plain)
    found = with_frame(by_handovers.named(found, asis, scene, agent), read, sight, scene)
    ties = Ties.of(asis, scene, agent) if scene.walls else None
    if are_faint_and_hidden(found, asis, sight, scene, agent, ties):
        found, read, sight = [], asis, followed(asis, scene, agent, plain)
    step_m = np.inf if agent is None else scene.agent(agent).step_m
    found += time_units.slow_times(asis, sight, ties, step_m) + time_units.fast_times(asis, sight)
    found += elevations.suspicions(read | asis, sight, scene, agent)
    measured = len(finite(asis, "distance_m")) and len(finite(asis, "amplitude"))
    # what isn't a line of sight tells nothing of the level, and where little fits it is none
    lost = any(item.kind == "start" for item in found) and one_in_sight(sight)
    if "amplitude" not in known and measured and sight.explained >= least_share(scene) and not lost:
        angles = any(len(finite(asis, name)) for name in ANGLES)
        placed = angles and (bool(scene.walls) or tells_place(asis))
        loud = loudness(asis["amplitude"], sight, scene, placed)
        if any(item.kind == "slant" for item in found):
            # where the scene lacks heights, amplitudes go by the length that is measured
            ways = replace(sight, distance_m=asis["distance_m"][sight.row])
            others = {item.kind for item in loudness(asis["amplitude"], ways, scene, placed)}
            loud = [item for item in loud if item.kind in others]
        found += loud
    if not found and sight.explained >= least_share(scene):
        found += second_device(asis, scene, agent, sight)
    return found


def _doubted(suspicion: Suspicion, sight: Sight) -> Suspicion:
    """The suspicion of a turned anchor, as far as one anchor in sight tells it from other errors."""
    if suspicion.kind != "turned" or not one_in_sight(sight):
        return suspicion
    note = "one anchor in sight can't tell it from another start, or from an error in its distances"
    return replace(suspicion, certain=False, reason=f"{suspicion.reason}; {note}")


def _refuted(
    found: list[Suspicion], asis: Columns, scene: Scene, agent: str | None, plain: Sight, sight: Sight
) -> bool:
    """Whether what anchors tell by themselves, or what comes first, speaks against suspicions."""
    return bool(found) and (
        by_handovers.refuted(found, asis, scene, agent)
        or takes_reflections(asis, followed(asis, scene, agent, plain), sight)
        or through_walls(asis, sight, scene)
    )


def _start_or_column(
    asis: Columns, scene: Scene, agent: str | None, plain: Sight
) -> tuple[list[Suspicion], Columns, Sight]:
    """A column read otherwise that fits from the told start, another start, or both; the table and its sight.

    Nothing if the table fits no better from elsewhere.

    Behind a wall the way's image, with arrivals counted the other way around, fits as well as the way itself.
    """
    elsewhere = other_start(asis, scene, agent, plain, plain)
    if elsewhere is None:
        return [], asis, plain
    if elsewhere[0] is None or elsewhere[0].kind != "start":
        return _with_start([], asis, plain, asis, elsewhere)
    way = rival_of_start(asis, scene, agent, plain)
    found = way.suspicions(asis, scene, agent)
    if not found:
        return _with_start([], asis, plain, asis, elsewhere)
    # as many particles as begin anywhere, to be fair
    fair = explain(way.table, scene, agent, way.in_world, crowd=MANY_STARTS)
    elsewhere = other_start(asis, scene, agent, plain, fair)
    start, sight = elsewhere or (None, fair)
    if start is None:
        return found, way.table, way.sight
    if fair.explained < ALIKE * sight.explained:
        return _with_start([], asis, plain, asis, (start, sight))
    both = [*(replace(item, certain=False) for item in found), told_after(start, found)]
    return [replace(item, certain=False) for item in both], way.table, way.sight


def _best_cure(
    asis: Columns, scene: Scene, agent: str | None, plain: Sight
) -> tuple[list[Suspicion], Columns, Sight]:
    """What is wrong by the best cure, the table as it should have been, and what is explained then."""
    way = likeliest_way(asis, scene, agent, plain)
    found, read, sight = way.suspicions(asis, scene, agent), way.table, way.sight
    if plain.explained < EXPLAINED:
        if not found:
            read, sight = asis, plain
        cure = whole_cure(asis, scene, agent, sight, plain)
        if cure is not None:  # it explains more than all readings of columns
            read, sight = cure.table, cure.sight
            found = [cure.suspicion] if cure.suspicion is not None else []
        # half a turn of the heading is the same as arrivals read backwards: evidence can't decide
        behind = MOST_BEHIND if {item.kind for item in found} == {"backwards"} else RIVAL
        elsewhere = other_start(asis, scene, agent, plain, sight, behind) if both_measured(asis) else None
        if elsewhere is not None:
            found, read, sight = _with_start(found, read, sight, asis, elsewhere)
    started = any(item.kind in ELSEWHERE for item in found)
    if (found or plain.explained < EXPLAINED) and not started:
        if (held := upheld(asis, read, found, scene, agent, plain)) is not None:
            return [], asis, held
    return found, read, sight


def _with_start(
    found: list[Suspicion],
    read: Columns,
    sight: Sight,
    asis: Columns,
    elsewhere: tuple[Suspicion | None, Sight],
) -> tuple[list[Suspicion], Columns, Sight]:
    """A start that explains as much as another cure, or more: beside it, or instead.

    A heading that is wrong by half a turn and arrivals read backwards are the same to every line of sight; an
    agent that moves ahead tells them apart.
    """
    start, other = elsewhere
    if start is None:
        return [], asis, other
    ahead = goes_ahead(other)
    if {item.kind for item in found} == {"backwards"} and abs(ahead) > AHEAD:
        return ([start], asis, other) if ahead > 0 else (found, read, sight)
    if one_in_sight(other):
        note = f"{start.reason}; one anchor in sight can't tell it from an error in what that anchor measures"
        start = replace(start, certain=False, reason=note)
    if not found or start.certain:
        return [start], asis, other
    return [*(replace(item, certain=False) for item in found), told_after(start, found)], read, sight
