"""Where each anchor alone puts the agent, by length, AoD and AoA of one path: no filter, no motion model.

A filter that is blunt follows from one anchor's sights to the next one's, whatever jump that takes. Poses of
their own show the jump.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.scene.views import in_view
from gridslam.world.columns import Columns
from gridslam.world.geometry import level_of, unit, wrap
from gridslam.world.scene import Scene

NEIGHBOURS, NEAR_STEPS = 2, 2
"""Rows of the same anchor that must continue one, within so many steps: what nothing continues is clutter."""
ANGLE_STD, DISTANCE_STD_M = np.radians(3.0), 0.1
"""Of a row's AoD and length, where it has none of its own."""
PACES = 2.0
"""Of the scene's steps, that one may be long."""
LEAST_LEVEL_M = 0.5
"""Nearer to below an anchor, its length tells no place."""


@dataclass(frozen=True, eq=False)
class Stand:
    """How anchors stand, by the scene or otherwise.

    Attributes
    ----------
    position : (J, 2) m
    orientation, height : (J,) rad, m
        Heights above the agent.
    """

    position: Array
    orientation: Array
    height: Array

    @classmethod
    def of(cls, scene: Scene, agent: str | None) -> Stand:
        """By the scene."""
        return cls(scene.anchor_positions, scene.anchor_orientations, scene.heights(agent))

    def turned(self, anchor: int, turn_rad: float) -> Stand:
        """With an anchor turned."""
        return replace(self, orientation=self.orientation + turn_rad * self._is(anchor))

    def moved(self, anchor: int, shift_m: Array) -> Stand:
        """With an anchor elsewhere.

        Parameters
        ----------
        anchor : int
        shift_m : (2,) m
        """
        return replace(self, position=self.position + shift_m * self._is(anchor)[:, None])

    def renamed(self, order: tuple[int, ...]) -> Stand:
        """With what is called j in the table standing where the scene has ``order[j]``."""
        chosen = np.array(order)
        return Stand(self.position[chosen], self.orientation[chosen], self.height[chosen])

    def _is(self, anchor: int) -> Array:
        return np.asarray(np.arange(len(self.orientation)) == anchor, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class OwnPoses:
    """Poses of the rows of a table (K,), each by its anchor alone, and which of them can be lines of sight.

    Attributes
    ----------
    step, anchor : (K,) int
    place : (K, 2) m
    facing : (K,) rad
        NaN without AoA.
    spread_m : (K,) m
        Standard deviation of the place.
    sights : list of (N,) int
        Of each anchor the rows that are probably lines of sight, at most one a step, in the order of steps.
    """

    step: NDArray[np.intp]
    anchor: NDArray[np.intp]
    place: Array
    facing: Array
    spread_m: Array
    sights: list[NDArray[np.intp]]


def poses(table: Columns, scene: Scene, stand: Stand, kept: NDArray[np.intp]) -> OwnPoses:
    """Poses and lines of sight of a table.

    The shortest row of a step that lies in the region, and that walls leave in sight of the anchor, is the
    line of sight: a reflection's own place lies behind the wall that reflects it.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    stand : Stand
        How anchors stand.
    kept : (R,) int
        Rows that may be lines of sight, see `continued`.
    """
    anchor, level = table["anchor"], _level(table, stand)
    toward = table["aod_rad"] + stand.orientation[anchor]
    origin = stand.position[anchor]
    place = origin + level[:, None] * unit(toward)
    arriving = table.get("aoa_rad", np.full(len(level), np.nan))
    low, high = np.transpose([scene.grid.x_m, scene.grid.y_m])
    clear = ((place[kept] > low) & (place[kept] < high)).all(1)
    clear &= in_view(origin[kept], place[kept], scene.segments())
    rows = kept[clear]
    rows = rows[np.lexsort((table["distance_m"][rows], table["step"][rows], anchor[rows]))]
    new = np.diff(table["step"][rows], prepend=-1) | np.diff(anchor[rows], prepend=-1)
    rows = rows[new != 0]
    sights = [rows[anchor[rows] == number] for number in range(len(stand.position))]
    along = _std(table, "distance_std_m", DISTANCE_STD_M) * table["distance_m"] / np.maximum(level, 1e-3)
    spread = np.hypot(along, level * _std(table, "aod_std_rad", ANGLE_STD))
    return OwnPoses(table["step"], anchor, place, wrap(toward + np.pi - arriving), spread, sights)


def continued(table: Columns, scene: Scene, agent: str | None, stand: Stand) -> NDArray[np.intp]:
    """Rows (R,) whose own places others of the same anchor continue, however it stands; none without AoD.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    stand : Stand
        How anchors stand: of it, heights alone count.
    """
    if not {"distance_m", "aod_rad"} <= table.keys():
        return np.zeros(0, np.intp)
    level = _level(table, stand)
    spot = level[:, None] * unit(table["aod_rad"])
    pace = PACES * (scene.agent(agent).step_m if agent is not None else 0.1)
    spread = np.hypot(2 * DISTANCE_STD_M, level * _std(table, "aod_std_rad", ANGLE_STD))
    found = []
    for number in range(len(stand.position)):
        rows = np.flatnonzero(
            (table["anchor"] == number) & np.isfinite(spot).all(1) & (level > LEAST_LEVEL_M)
        )
        step, near = table["step"][rows], np.zeros(len(rows), int)
        for ahead in range(1, len(rows)):
            gap = step[ahead:] - step[:-ahead]
            if gap.min() > NEAR_STEPS:
                break
            far = np.linalg.norm(spot[rows[ahead:]] - spot[rows[:-ahead]], axis=1)
            good = (gap > 0) & (gap <= NEAR_STEPS) & (far < 1.5 * spread[rows[ahead:]] + pace * gap)
            near[ahead:] += good
            near[:-ahead] += good
        found.append(rows[near >= NEIGHBOURS])
    return np.sort(np.concatenate(found))


def _level(table: Columns, stand: Stand) -> Array:
    with np.errstate(invalid="ignore"):
        return np.asarray(level_of(table["distance_m"], stand.height[table["anchor"]]))


def _std(table: Columns, name: str, least: float) -> Array:
    own = np.nan_to_num(table[name]) if name in table else np.zeros(len(table["step"]))
    return np.maximum(own, least)
