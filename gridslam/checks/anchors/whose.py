"""Whether distances alone tell which anchor is which: with names exchanged another way may explain them."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from gridslam.checks.sights.line_of_sight_filter import Sight, explain
from gridslam.checks.tables.unit_hypotheses import ANGLES, finite
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

MOST_PAIRS = 15
"""Pairs of anchors up to which exchanging them is tried."""
ALIKE = 30.0
"""Log likelihood ratio in nats up to which names that are exchanged explain as much as the table's."""


def whose(table: Columns, scene: Scene, agent: str | None, seen: Sight) -> str:
    """What distances alone leave open of the names of anchors, to be said after what fits; or nothing.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    seen : Sight
        What is explained as it stands.
    """
    if len(np.unique(table["anchor"])) < 2 or any(len(finite(table, name)) for name in ANGLES):
        return ""
    best, names = explain(table, scene, agent, thorough=True).evidence, ""
    best = max(best, seen.evidence) - ALIKE
    pairs = list(combinations(range(len(scene.anchors)), 2))
    for one, other in pairs if len(pairs) <= MOST_PAIRS else []:
        order = np.arange(len(scene.anchors))
        order[[one, other]] = other, one
        own = explain(table | {"anchor": order[table["anchor"]]}, scene, agent, thorough=True)
        if own.evidence > best and own.explained >= seen.explained - 0.05:
            best = own.evidence
            names = f"{scene.anchor_names[one]} and {scene.anchor_names[other]}"
    more = f": with {names} exchanged lines of sight explain as much or more" if names else ""
    return f"; not sure: distances alone don't tell for certain which anchor is which{more}"
