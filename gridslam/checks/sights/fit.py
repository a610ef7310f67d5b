"""When a table, or a cure of it, is said to fit the scene."""

from __future__ import annotations

import numpy as np

from gridslam.checks.scene.range_errors import RangeError
from gridslam.checks.sights.line_of_sight_filter import Sight, explain
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

FITTING = 0.8
"""Share of scans that a line of sight must explain for a table, or a cure of it, to be called fitting."""
BLIND = 0.3
"""Such a share where the scene has no walls: nobody knows in how many scans an anchor is hidden. Evidence
decides there which reading is right; the share only keeps chance from being called a fit."""


def fitting(scene: Scene) -> float:
    """Share of scans that a line of sight must explain, of those in which a path is detected."""
    given = scene.signal_model().given_detection
    return FITTING * (1.0 if given is None else given)


def least_share(scene: Scene) -> float:
    """Share of scans that must be explained for something to fit this scene."""
    return fitting(scene) if scene.walls else BLIND


def tells_place(table: Columns) -> bool:
    """Whether lines of sight tell where an agent is that starts anywhere near: not by one anchor without AoD.

    By length and AoA alone it may go around the anchor, facing the other way as it does.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    """
    leaving = table.get("aod_rad")
    return (leaving is not None and bool(np.isfinite(leaving).any())) or len(np.unique(table["anchor"])) > 1


def settled(
    table: Columns,
    scene: Scene,
    agent: str | None,
    world_arrival: bool = False,
    error: RangeError | None = None,
) -> Sight:
    """What is explained of a table as it is judged in the end: followed through doors, if need be.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    world_arrival : bool
        Take arrivals as directions in the world.
    error : RangeError, optional
        Let all of these distances be off by one size.
    """
    sight = explain(table, scene, agent, world_arrival, error)
    if sight.explained >= FITTING:
        return sight
    through = explain(table, scene, agent, world_arrival, error, thorough=True)
    return through if through.explained > sight.explained else sight
