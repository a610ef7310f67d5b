"""Whether measured elevations are those of lines of sight, and whether anything is made of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gridslam.arrays import Array
from gridslam.checks.sights.line_of_sight_filter import Sight
from gridslam.checks.tables.unit_hypotheses import Suspicion, finite
from gridslam.world.columns import ELEVATIONS, Columns
from gridslam.world.geometry import elevations
from gridslam.world.scene import Scene

ENOUGH_ROWS, FAR_RAD, BETTER = 10, 0.15, 0.4
"""Lines of sight that are judged at least; median miss from which elevations are doubted; share of it that a
reading may leave."""
READINGS: dict[str, tuple[str, Callable[[Array], Array]]] = {
    "downwards": ("counted downwards; elevations count upwards from the horizontal", lambda v: -v),
    "zenith": (
        "angles from the vertical, where those above the horizontal belong",
        lambda v: 0.5 * np.pi - v,
    ),
    "nadir": (
        "angles from straight down, where those above the horizontal belong",
        lambda v: v - 0.5 * np.pi,
    ),
    "degrees": ("degrees, where radians belong", np.radians),
}


def suspicions(table: Columns, sight: Sight, scene: Scene, agent: str | None) -> list[Suspicion]:
    """What the lines of sight show of elevations, in a scene with heights.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    sight : Sight
        Its lines of sight.
    """
    rows, found = sight.row[sight.sure], list[Suspicion]()
    if not scene.has_heights or len(rows) < ENOUGH_ROWS or "distance_m" not in table:
        return found
    height = scene.heights(agent)[table["anchor"][rows]]
    expected = elevations(table["distance_m"][rows], height, np.ones(len(rows), dtype=bool))
    for end, name in enumerate(ELEVATIONS):
        values = table.get(name, np.zeros(0))[rows] if name in table else np.zeros(0)
        good = np.isfinite(values) & np.isfinite(expected[:, end]) if len(values) else np.zeros(0, bool)
        if good.sum() < ENOUGH_ROWS:
            continue
        true, values = expected[good, end], values[good]
        plain = _miss(values, true)
        best = min(READINGS, key=lambda kind: _miss(READINGS[kind][1](values), true))
        left = _miss(READINGS[best][1](values), true)
        if plain < FAR_RAD:
            continue
        reason = f"{len(true)} lines of sight are {plain:.2f} rad off as it stands"
        if left < BETTER * plain:
            found.append(Suspicion(name, best, READINGS[best][0], True, f"{reason}, {left:.2f} else"))
        else:
            text = "not that of the scene's heights: position_m of the anchors, height_m of the agent"
            found.append(Suspicion(name, "heights", text, False, reason))
    return found


def _miss(values: Array, true: Array) -> float:
    return float(np.median(np.abs(values - true)))


def remarks(columns: Columns, scene: Scene | None, agent: str | None) -> list[str]:
    """Elevations of which no filter makes anything, and why.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Of a table of measurements, as its file has them.
    """
    notes = list[str]()
    if scene is None:
        measured = " and ".join(name for name in ELEVATIONS if len(finite(columns, name)))
        where = "only --method grid and adaptive use them, in scenes with heights"
        return [f"note: {measured}: {where}"] if measured else notes
    known = scene.signal_model(agent if agent or not scene.agents else scene.agents[0].name)
    for end, name in enumerate(ELEVATIONS):
        if not len(finite(columns, name)):
            continue
        if not scene.has_heights:
            notes.append(f"note: {name} isn't used: the scene has no heights")
        elif not known.elevated[end] and not len(finite(columns, name.replace("_rad", "_std_rad"))):
            array = "the anchors' arrays have" if end == 0 else "the agent's array has"
            notes.append(f"note: {name} isn't used: it has no deviations, and {array} one layer")
    return notes
