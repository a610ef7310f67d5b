"""Heights that a flat scene lacks, of each anchor another one: no error of one size explains distances."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.checks.anchors.range_fit import RangeFit, fit_heights
from gridslam.checks.scene.range_errors import LEAST_HEIGHT_M
from gridslam.checks.sights.line_of_sight_filter import Sight
from gridslam.checks.tables.unit_hypotheses import Suspicion
from gridslam.world.columns import Columns
from gridslam.world.geometry import level_of
from gridslam.world.scene import Scene

CLEAR = 10.0
"""Log likelihood ratio in nats for each anchor's height that these must reach over an error of one size."""


def forgotten_heights(
    table: Columns, scene: Scene, sight: Sight, best: RangeFit
) -> tuple[Suspicion, Columns] | None:
    """The heights that explain lines of sight clearly better than the best error of one size, and the table
    of horizontal distances; None if they don't, or the scene has heights.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    best : RangeFit
    """
    if scene.has_heights:
        return None
    found = fit_heights(table, sight, scene)
    if found is None:
        return None
    heights, fit = found
    gain = fit.gain(best)
    if gain < CLEAR * len(heights) or heights.max() < LEAST_HEIGHT_M:
        return None
    times = best.misfit / max(fit.misfit, 1e-9)
    reason = (
        f"misfit of the lines of sight {times:.1f} times as large with the best error of one size; "
        f"log likelihood ratio {gain:.0f}"
    )
    level = level_of(table["distance_m"], heights[table["anchor"]])
    cured = table | {"distance_m": np.maximum(level, 1e-2)}
    return Suspicion("distance_m", "slant", _words(heights, scene), True, reason), cured


def _words(heights: Array, scene: Scene) -> str:
    named = ", ".join(
        f"{name} {height:.1f}" for name, height in zip(scene.anchor_names, heights, strict=True) if height > 0
    )
    return (
        f"slant ranges of anchors above or below the agent, by about ({named}) m: the scene has no heights; "
        "give them as third numbers of position_m, and the agent's as height_m"
    )
