"""What true clocks show over time: offset, drift, zigzag, jump, and the walk that a seed draws."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.arrays import Array
from gridslam.world.clocks import Clock, ClockTruth
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene
from gridslam.world.scene_parts import Agent, Anchor
from gridslam.world.start import require_seed

STREAM = 0xC1


def true_offset(scene: Scene, device: Anchor | Agent, time_s: Array, seed: int) -> Array:
    """True offset of an anchor's or agent's clock at times of steps (N,), s.

    The walk stands still at time 0 and takes an independent step of ``walk_ns`` per root second at each
    interval from then on: docs/model.md, section 13.
    """
    clock = device.clock or Clock()
    offset = clock.offset_s(time_s)
    if clock.walk_ns == 0:
        return offset
    require_seed(seed)
    interval = scene.agents[0].interval_s if isinstance(device, Anchor) else device.interval_s
    step = np.rint(np.asarray(time_s) / interval).astype(np.intp)
    draw = np.random.default_rng([seed, STREAM, (*scene.anchors, *scene.agents).index(device)])
    walk = np.zeros(int(step.max(initial=0)) + 1)
    walk[1:] = np.cumsum(draw.standard_normal(len(walk) - 1))
    return np.asarray(offset + 1e-9 * clock.walk_ns * np.sqrt(interval) * walk[step])


def apparent_bias(scene: Scene, agent: str, time_s: Array, seed: int = 0) -> Array:
    """What the clocks add to measured distances, anchor's minus agent's, (N, J) m."""
    offsets = [true_offset(scene, anchor, time_s, seed) for anchor in scene.anchors]
    own = true_offset(scene, scene.agent(agent), time_s, seed)
    return SPEED_OF_LIGHT * (np.stack(offsets, -1) - own[:, None])


def clock_truth(scene: Scene, names: Sequence[str], time_s: Array, seed: int = 0) -> ClockTruth:
    """True offsets of the clocks of all anchors and of some agents at given times (N,)."""
    devices: tuple[Anchor | Agent, ...] = (*scene.anchors, *(scene.agent(name) for name in names))
    offsets = [true_offset(scene, device, time_s, seed) for device in devices]
    return ClockTruth(tuple(device.name for device in devices), time_s, np.stack(offsets, -1))
