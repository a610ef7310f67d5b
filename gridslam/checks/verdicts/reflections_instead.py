"""Cures that take reflections for lines of sight: later than others that fit as it is, or through walls.

Between walls that stand close together, reflections come nearly from where the line of sight does, and some
wrong reading makes them fit. Nothing comes before a line of sight but clutter, and that fits none.
"""

from __future__ import annotations

import numpy as np

from gridslam.checks.anchors.handover_rivals import fits_start
from gridslam.checks.anchors.rivals import EXPLAINED
from gridslam.checks.scene.views import in_view
from gridslam.checks.sights.handovers import Ties
from gridslam.checks.sights.line_of_sight_filter import Sight
from gridslam.checks.starts.start_search import one_in_sight
from gridslam.checks.tables.unit_hypotheses import ADVICE, ANGLES, Suspicion
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

OTHERS, LATER = 0.25, 0.75
"""Share of scans in which a cure takes another row, and share of these in which that is the later one."""
IN_VIEW = 0.2
"""Share of lines of sight that the scene's walls must leave."""
FAINT_DB, ENOUGH = -6.0, 10
"""Median level of lines of sight up to which they may be reflections; so many tell it."""


def takes_reflections(table: Columns, plain: Sight, sight: Sight) -> bool:
    """Whether most rows that fit as a cure has them come behind others that fit as the table stands.

    Parameters
    ----------
    table : dict of (K,) arrays
        As it stands: columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of
        steps.
    plain, sight : Sight
        What is explained as it stands, and by the cure.
    """
    if plain.explained < EXPLAINED:
        return False
    before, after = (one.row[one.likely] for one in (plain, sight))
    anchors = int(table["anchor"].max()) + 1
    scan = table["step"] * anchors + table["anchor"]
    before, after = before[np.isin(scan[before], scan[after])], after[np.isin(scan[after], scan[before])]
    before, after = before[np.argsort(scan[before])], after[np.argsort(scan[after])]
    later = table["distance_m"][after] > table["distance_m"][before]
    others = int((before != after).sum())
    return others >= OTHERS * max(len(before), 1) and int(later.sum()) >= LATER * others


def through_walls(table: Columns, sight: Sight, scene: Scene) -> bool:
    """Whether walls of the scene stand in nearly all lines of sight that were found.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    sight : Sight
        What is explained of it.
    """
    rows = sight.row[sight.likely]
    number = np.searchsorted(np.unique(table["step"][sight.row]), table["step"][rows])
    clear = in_view(scene.anchor_positions[table["anchor"][rows]], sight.position_m[number], scene.segments())
    return len(rows) > 0 and float(clear.mean()) < IN_VIEW


def are_faint_and_hidden(
    found: list[Suspicion], table: Columns, sight: Sight, scene: Scene, agent: str | None, ties: Ties | None
) -> bool:
    """Whether an only anchor's rows, read otherwise, are as faint as reflections, and walls hide it anyway.

    Reflections by one wall look like lines of sight to an image of the anchor, so that some units and
    directions of its angles fit. As it stands nothing is amiss if walls hide it from the told start, or its
    first rows put the agent there.

    Parameters
    ----------
    found : list of Suspicion
    table : dict of (K,) arrays
        As it stands.
    sight : Sight
        What is explained with the columns read otherwise.
    ties : Ties or None
        Of the table as it stands.
    """
    read = any(item.column in ("distance_m", *ANGLES) and item.kind in ADVICE for item in found)
    if not read or agent is None or not scene.walls or not one_in_sight(sight) or "amplitude" not in table:
        return False
    start = np.array(scene.agent(agent).start_m)
    seen = in_view(scene.anchor_positions[np.unique(table["anchor"])], start, scene.segments())
    if seen.any() and not (ties is not None and fits_start(ties.start, scene, agent)):
        return False
    good = sight.likely & (table["amplitude"][sight.row] > 0) & (sight.distance_m > 0)
    expected = scene.signal_model().amplitude(sight.distance_m[good])
    level = 20 * np.log10(table["amplitude"][sight.row[good]] / expected)
    return len(level) >= ENOUGH and float(np.median(level)) <= FAINT_DB
