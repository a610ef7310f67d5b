"""What `check` says of a table of measurements in which nothing is suspected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.checks.line_of_sight_filter import explain
from gridslam.checks.range_fit import steps_to_judge_by
from gridslam.checks.rivals import FITTING
from gridslam.checks.unit_hypotheses import ANGLES, finite
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

UNSURE = "unsure: "
"""Begins a line that says that a table can't be judged."""
FEW = 10
"""Scans below which little can be told."""
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
    seen = explain(table, scene, agent)
    if seen.explained < FITTING:
        seen = explain(table, scene, agent, thorough=True)
    line = f"line of sight to the anchors in {seen.explained:.0%} of {seen.scans} scans"
    if seen.explained >= FITTING:
        line += ": units and frames fit the scene"
        if seen.scans < FEW:
            return f"{line}, as far as so few scans tell"
        both = steps_to_judge_by(table, seen, scene)
        if both < MANY and any(len(finite(columns, name)) for name in ANGLES):
            total = len(np.unique(table["step"]))
            line += f"; heights and clocks can't be told: two anchors at once at {both} of {total} steps"
        return line
    if len(scene.anchors) > 1:
        each = zip(scene.anchor_names, seen.shares, strict=True)
        line += f" ({', '.join(f'{name} {share:.0%}' for name, share in each if share == share)})"
    if not any(len(finite(columns, name)) for name in ANGLES):
        return f"{line}: distances alone don't tell where the agent is, so that nothing more can be said"
    if seen.explained < 0.3 or seen.scans < FEW:
        whether = "whether units and frames are right; no single cure explains the rows"
        return f"{UNSURE}{line}: too few to tell {whether}"
    if not scene.walls:
        hidden = "walls, of which the scene has none, may hide anchors"
        return f"{line}: no other reading of a column explains more; {hidden}"
    return f"suspect: {line}: does not fit the scene, and no single cure explains the rows"
