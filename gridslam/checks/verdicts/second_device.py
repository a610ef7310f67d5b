"""Whether a table of one agent holds the rows of another device, too: lines of sight that nobody has claimed.

Reflections of the agent's own rows look like a device behind the walls. They are fainter, mostly out of the
region that is mapped, and seldom the same for all anchors.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gridslam.arrays import Array
from gridslam.checks.sights.line_of_sight_filter import Sight, explain
from gridslam.checks.starts.start_search import APART_M, proposed_starts
from gridslam.checks.tables.unit_hypotheses import ANGLES, Suspicion, finite
from gridslam.checks.verdicts.reflections_instead import through_walls
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

LEAST, INSIDE = 0.7, 0.9
"""Share of scans that must hold a line of sight of the second device, of the same of each of two anchors, and
share of steps at which it must be in the scene's grid. Right tables have up to 0.67 and 0.37 of them."""
FEWEST = 30
"""Scans that must be judged."""
FAINTER_DB = 2.0
"""How much fainter a device may be than the other; two bounces take 3 dB at least, but of metal."""
TEXT = "rows of two devices in one table; say whose each row is, in a column agent, or make two files"


def second_device(table: Columns, scene: Scene, agent: str | None, sight: Sight) -> list[Suspicion]:
    """A second device in a table whose rows fit the scene, as one suspicion; or none.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    sight : Sight
        What the lines of sight of the table explain as it stands.
    """
    # mirrored by a wall, the agent has every angle but that of arrival
    if agent is None or not all(len(finite(table, name)) for name in ("distance_m", *ANGLES)):
        return []
    if len(np.unique(table["anchor"])) < 2 or sight.scans < FEWEST:
        return []
    left = np.ones(len(table["step"]), bool)
    left[sight.row[sight.likely]] = False
    rest: Columns = {name: values[left] for name, values in table.items()}
    for begun, other in _others(rest, scene, agent):
        if (
            _is_a_device(rest, other, scene)
            and _apart(other, sight)
            and (_level_db(rest, other) >= _level_db(table, sight) - FAINTER_DB)
        ):
            x, y = other.position_m[0]
            reason = (
                f"without the lines of sight of {agent}, {other.explained:.0%} of {other.judged} hold one "
                f"of a device that begins near ({x:.1f}, {y:.1f}) m{begun}"
            )
            return [Suspicion("agent", "second device", TEXT, False, reason)]
    return []


def _others(rest: Columns, scene: Scene, agent: str) -> Iterator[tuple[str, Sight]]:
    """What is explained of a table's rest from where the scene's other agents begin, and from anywhere.

    With what is to be said of that beginning. Where many rows are left, particles that begin anywhere follow
    reflections rather.
    """
    for body in scene.agents:
        if body.name != agent:
            yield f", as {body.name} does", explain(rest, scene, body.name)
    starts = proposed_starts(rest, scene, agent)
    if len(starts):
        yield "", explain(rest, scene, agent, starts=starts)


def _is_a_device(rest: Columns, other: Sight, scene: Scene) -> bool:
    """Whether lines of sight of two anchors at least are heard all along, in the region, past walls."""
    agreeing = np.nan_to_num(other.shares) >= LEAST
    enough = other.explained >= LEAST and agreeing.sum() >= 2 and other.scans >= FEWEST
    return enough and _inside(other.position_m, scene) >= INSIDE and not through_walls(rest, other, scene)


def _apart(one: Sight, other: Sight) -> bool:
    """Whether two ways are those of two devices."""
    together = min(len(one.position_m), len(other.position_m))
    gap = np.linalg.norm(one.position_m[:together] - other.position_m[:together], axis=1)
    return bool(np.median(gap) >= APART_M)


def _inside(position: Array, scene: Scene) -> float:
    """Share of positions (N, 2) m that are in the scene's grid."""
    low, high = np.transpose([scene.grid.x_m, scene.grid.y_m])
    return float(((position > low) & (position < high)).all(1).mean())


def _level_db(table: Columns, sight: Sight) -> float:
    """How loud lines of sight are at 1 m; 0 where nothing tells."""
    sure = sight.sure
    if "amplitude" not in table or not sure.any():
        return 0.0
    loud = table["amplitude"][sight.row[sure]] * sight.distance_m[sure]
    loud = loud[np.isfinite(loud) & (loud > 0)]
    return 20 * float(np.log10(np.median(loud))) if len(loud) else 0.0
