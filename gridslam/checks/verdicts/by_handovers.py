"""What handovers and first poses make of suspicions: they refute some, and name what nothing else does."""

from __future__ import annotations

from gridslam.checks.anchors.handover_rivals import handover_rival, is_sound
from gridslam.checks.sights.handovers import Ties
from gridslam.checks.starts.told_start import other_start_told
from gridslam.checks.tables.unit_hypotheses import ANGLES, Suspicion
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

REFUTED = {"turned", "names", "start", "flipped", "mirrored", "backwards"}
"""Kinds of suspicions that make anchors' own poses part, or the first of them leave the told start."""
WHERE = {"distance_m", "anchor", "start", "agent", *ANGLES}
"""Columns of suspicions that say why poses part."""


def refuted(found: list[Suspicion], table: Columns, scene: Scene, agent: str | None) -> bool:
    """Whether a suspicion is, since each anchor's own poses fit the others' and the told start as they stand.

    A filter of lines of sight may lose an agent in a doorway, and then finds some reading that fits. Each
    anchor that was heard must be tied: of others handovers tell nothing.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    """
    if not scene.walls or not any(item.kind in REFUTED for item in found):
        return False
    ties = Ties.of(table, scene, agent)
    return ties is not None and ties.start is not None and is_sound(ties, scene, agent)


def named(found: list[Suspicion], table: Columns, scene: Scene, agent: str | None) -> list[Suspicion]:
    """Suspicions, with what makes handovers or the told start fit before them, if none says why not.

    Parameters
    ----------
    found : list of Suspicion
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    """
    if any(item.column in WHERE for item in found):
        return found
    one = handover_rival(table, scene, agent) or other_start_told(table, scene, agent)
    return found if one is None else [one, *found]
