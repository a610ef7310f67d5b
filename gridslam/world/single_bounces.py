"""Single bounces over many lines, from many places to many poses at once, and their slopes.

`gridslam.world.geometry` has the mirrors; `trace` there takes paths of up to two bounces, one by one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.geometry import mirror, mirror_derivative, slant, unit

LEAST_M = 1e-9


@dataclass(frozen=True, eq=False)
class SingleBounces:
    """Single bounces as their anchor and the agent see them; all shapes are broadcast.

    Attributes
    ----------
    line : (..., 2)
        Normal angle (rad) and offset (m).
    place : (..., 4)
        The anchor: x, y (m), orientation (rad) and height above the agent (m).
    pose : (..., 3) m, m, rad
    value : (..., 3)
        Distance (m), AoD and AoA (rad), angles relative to the anchor and the heading and not wrapped.
    toward : (..., 2) m
        From the agent to the anchor's image, seen from above.
    level : (...) m
        How long that is.
    """

    line: Array
    place: Array
    pose: Array
    value: Array
    toward: Array
    level: Array

    @property
    def possible(self) -> NDArray[np.bool_]:
        """Whether agent and anchor stand on one side of the line, (...)."""
        normal, offset = unit(self.line[..., 0]), self.line[..., 1]
        here = (normal * self.pose[..., :2]).sum(-1) - offset
        return np.asarray(here * ((normal * self.place[..., :2]).sum(-1) - offset) > 0)

    def slopes(self) -> tuple[Array, Array]:
        """Derivatives of `value` by the line (..., 3, 2) and by the pose (..., 3, 3)."""
        level = self.level[..., None]
        toward = self.toward / level
        across = np.stack([-toward[..., 1], toward[..., 0]], -1) / level
        toward = toward * (level / self.value[..., :1])
        image = mirror_derivative(self.line, self.place[..., :2])
        by_line, by_pose = np.empty((*self.level.shape, 3, 2)), np.zeros((*self.level.shape, 3, 3))
        by_line[..., 0, :] = (toward[..., None] * image).sum(-2)
        by_line[..., 2, :] = (across[..., None] * image).sum(-2)
        by_line[..., 1, :] = -by_line[..., 2, :]
        by_line[..., 1, 0] += 2.0
        by_pose[..., 0, :2], by_pose[..., 1, :2], by_pose[..., 2, :2] = -toward, across, -across
        by_pose[..., 2, 2] = -1.0
        return by_line, by_pose


def single_bounces(line: Array, place: Array, pose: Array, image: Array | None = None) -> SingleBounces:
    """Single bounces over lines (..., 2) from places (..., 4 or more) to poses (..., 3), which broadcast.

    docs/model.md, (M221) for heights.

    Parameters
    ----------
    image : (..., 2), optional
        The places' mirror images, where they are known.
    """
    toward = (mirror(line, place[..., :2]) if image is None else image) - pose[..., :2]
    level = np.maximum(np.hypot(toward[..., 0], toward[..., 1]), LEAST_M)
    arrival = np.arctan2(toward[..., 1], toward[..., 0])
    value = np.empty((*level.shape, 3))
    value[..., 0] = slant(level, place[..., 3])
    value[..., 1] = 2 * line[..., 0] - arrival - place[..., 2]
    value[..., 2] = arrival - pose[..., 2]
    return SingleBounces(line, place, pose, value, toward, level)
