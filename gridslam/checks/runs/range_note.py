"""What a run's user is told of the distances: an offset or a height that the scene doesn't have."""

from __future__ import annotations

import numpy as np

from gridslam.checks.anchors.misplaced import with_places
from gridslam.checks.anchors.rivals import CERTAIN, both_measured, orders, range_cure, range_errors
from gridslam.checks.columns import time_units
from gridslam.checks.columns.gain_jumps import gain_jump
from gridslam.checks.columns.loudness import loudness
from gridslam.checks.columns.noise import noise
from gridslam.checks.sights.fit import BLIND, FITTING, least_share, settled, tells_place
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.checks.tables.unit_hypotheses import finite
from gridslam.checks.verdicts.diagnose import suspicions
from gridslam.measurements.observations import Observations
from gridslam.measurements.table import Measurements
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene


def range_note(scene: Scene, agent: str, observations: Observations) -> str | None:
    """One line on an error that all distances of an anchor have, or of all anchors; None if there is none.

    A filter can't tell: it puts agent and walls where such distances fit. So lines of sight are followed on
    their own over the first steps, as `gridslam check` does; it takes distances and angles. In scenes with
    clocks network SLAM finds offsets.

    Parameters
    ----------
    agent : str
        Who heard it.
    """
    table = _table(scene, observations)
    if table is None or scene.clocks is not None:
        return None
    sight = explain(table, scene, agent)
    if sight.explained < FITTING:  # too large to be taken for another place: its size is looked for, too
        seen = [explain(table, scene, agent, error=error) for error in range_errors(scene)]
        top = max(seen, key=lambda one: one.evidence)
        if top.explained < least_share(scene) or top.evidence < sight.evidence + CERTAIN:
            return None
        sight = top
    cure = range_cure(table, scene, agent, sight)
    found = [] if cure is None or cure.suspicion is None else [cure.suspicion]
    found = with_places(found, table, scene, agent, cure.table if cure is not None else None)
    return found[0].text if found else None


def fits_scene(scene: Scene, agent: str, observations: Observations) -> bool:
    """Whether lines of sight explain a table as it stands; True where nothing can be known.

    A filter that takes one anchor for another maps another world, and is sure of it.
    """
    table = _table(scene, observations)
    if table is None:
        return True
    if scene.walls and tells_place(table):
        return settled(table, scene, agent).explained >= least_share(scene)
    # nobody knows when walls hide an anchor: but more than chance must be explained, and than by other names
    sight = explain(table, scene, agent)
    if sight.explained < BLIND or sight.evidence < 0:
        return False
    renamed = (table | {"anchor": np.array(order)[table["anchor"]]} for order in orders(len(scene.anchors)))
    return all(explain(one, scene, agent).evidence < sight.evidence + CERTAIN for one in renamed)


def misfits(scene: Scene, agent: str, observations: Observations) -> list[str]:
    """What `gridslam check` suspects of a table against the scene, most of it that explains a misfit."""
    if not isinstance(observations, Measurements) or observations.unlabelled or scene.clocks is not None:
        return []
    columns = {name: np.asarray(values) for name, values in observations.columns.items()}
    return [str(item) for item in suspicions(columns, observations.anchors, scene, agent)]


def misread(scene: Scene, agent: str, observations: Observations) -> list[str]:
    """What `gridslam check` suspects of amplitudes, times and noise of a table whose lines of sight fit."""
    table = _table(scene, observations)
    if table is None:
        return []
    sight = settled(table, scene, agent)
    found = time_units.absurd_times(table)
    found += time_units.slow_times(table, sight, step_m=scene.agent(agent).step_m)
    found += time_units.fast_times(table, sight)
    if len(finite(table, "amplitude")) and sight.explained >= least_share(scene):
        found += gain_jump(table, scene, agent) or loudness(table["amplitude"], sight, scene)
    return [str(item) for item in found or noise(table, sight, scene)]


def _table(scene: Scene, observations: Observations) -> Columns | None:
    """Measured paths in the order of steps, anchors as the scene's; None where they tell of no place."""
    if not isinstance(observations, Measurements) or not set(observations.anchors) <= set(scene.anchor_names):
        return None
    place = np.array([scene.anchor_names.index(name) for name in observations.anchors], np.intp)
    table = {name: np.asarray(values) for name, values in observations.columns.items()}
    if not len(table["step"]) or not both_measured(table):
        return None
    order = np.argsort(table["step"], kind="stable")
    table = {name: values[order] for name, values in table.items()}
    table["anchor"] = place[table["anchor"]]
    return table
