"""What the scene itself allows for: offsets of its clocks, another height, anchors as roughly as it tells."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.checks.scene.range_errors import RangeError
from gridslam.world.geometry import slant
from gridslam.world.network_scene import clock_model
from gridslam.world.scene import Scene
from gridslam.world.scene_derived import mounting_std_of

WITHIN = 3.0
"""Told deviations within which something may be another than told."""
NEAREST_M = 0.5
"""Distance below which an anchor's place tells nothing of angles."""


def error_allowed(
    error: RangeError, size_m: float, scene: Scene, agent: str | None, far_m: float = np.inf
) -> bool:
    """Whether the scene's clocks, heights or anchors' places, as little as it knows of them, allow for it.

    Parameters
    ----------
    error : RangeError
    size_m : float
    agent : str or None
        Whose table it is; None: the first's.
    far_m : float
        How far away the anchors are, by which a height is a longer distance.
    """
    if error.kind == "rise" and scene.agents:
        body = scene.agent(agent) if agent is not None else scene.agents[0]
        return abs(size_m) <= WITHIN * body.height_std_m
    if error.kind == "slant" and np.isfinite(far_m):
        heights = scene.heights(agent)[list(error.anchors)]
        longer = [slant(np.array(far_m), size_m) - slant(np.array(far_m), height) for height in heights]
        return bool(np.max(np.abs(longer)) <= _aside_m(scene, error.anchors))
    if error.kind != "offset":
        return False
    if abs(size_m) <= _aside_m(scene, error.anchors):
        return True
    if scene.clocks is None:
        return False
    names = [agent] if agent is not None else [body.name for body in scene.agents[:1]]
    width = clock_model(scene, names).half_width_m
    own = width[len(scene.anchors) :].sum()  # nobody's where the scene has no agent
    return bool(abs(size_m) <= width[list(error.anchors)].min() + own + error.least_m)


def turn_allowed(turn_rad: float, anchor: int, far_m: Array, scene: Scene) -> bool:
    """Whether an anchor may be turned so: by how it is mounted, or as one looks that stands aside.

    Parameters
    ----------
    far_m : (N,) array
        How far away the agent was when it showed.
    """
    place, facing = mounting_std_of(scene.anchors)[anchor]
    far = max(float(np.median(far_m)), NEAREST_M) if len(far_m) else np.inf
    return bool(abs(turn_rad) <= WITHIN * np.hypot(facing, place / far))


def shift_allowed(shift_m: Array, anchor: int, scene: Scene) -> bool:
    """Whether an anchor may stand elsewhere by so much, (2,) m."""
    return bool(np.hypot(*shift_m) <= _aside_m(scene, (anchor,)))


def farthest_aside_m(scene: Scene) -> float:
    """How far from its place any anchor may stand."""
    return float(may_stand_aside_m(scene).max(initial=0.0))


def may_stand_aside_m(scene: Scene) -> Array:
    """How far from its place each anchor (J,) may stand, m."""
    return np.asarray(WITHIN * mounting_std_of(scene.anchors)[:, 0])


def _aside_m(scene: Scene, anchors: tuple[int, ...]) -> float:
    """How far all of some anchors may stand aside."""
    return WITHIN * float(mounting_std_of(scene.anchors)[list(anchors), 0].min())
