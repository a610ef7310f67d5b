"""Ways of the agent through a segment: how far it may have come, and others that it may have gone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.features.silences import carried
from gridslam.inference.state.features.features import MOVING
from gridslam.inference.state.features.hybrid_state import JointBelief, Segment
from gridslam.world.signal_model import SignalModel

STARTS, BESIDE_STD = 8, 2.0
"""Starts about the one that is believed that are tried in a crowd; how far off, in its deviations."""

SPEEDS, HEADINGS = (0.6, 1.5), 8
"""Of straight ways: speeds, in the deviation of what it is along an axis, and in how many directions each."""


def spread_m(belief: JointBelief) -> float:
    """Deviation of the agent's place, along either axis, m."""
    return float(np.sqrt(np.trace(belief.agent_covariance[:2, :2]) / 2))


def drifted(belief: JointBelief, segment: Segment, before_s: float | None, model: SignalModel) -> float:
    """Deviation of the agent's place, m, half-way through a segment of which nothing is heard."""
    agent, earlier = belief.keep(np.zeros(len(belief.features), bool)), before_s
    for time_s in segment.time_s[: len(segment) // 2]:
        if earlier is not None:
            agent = carried(agent, time_s - earlier, model)
        earlier = float(time_s)
    return spread_m(agent)


def moved_starts(segment: Segment, before: JointBelief) -> list[Segment]:
    """The segment's way from each of several places about where the agent is believed to have started."""
    reach = BESIDE_STD * spread_m(before)
    angle = 2 * np.pi * np.arange(STARTS) / STARTS
    shift = np.zeros((STARTS, 1, MOVING))
    shift[:, 0, :2] = reach * np.stack([np.cos(angle), np.sin(angle)], 1)
    shift[..., :2] += before.mean[:2] - segment.agent[0, :2]
    return [replace(segment, agent=segment.agent + one) for one in shift]


def straight_ways(segment: Segment, before: JointBelief) -> list[Segment]:
    """Ways from where the agent is believed to have started, each at a speed that is as likely."""
    speed = float(np.sqrt(np.trace(before.agent_covariance[2:, 2:]) / 2))
    angle = 2 * np.pi * (np.arange(len(SPEEDS) * HEADINGS) + 0.5) / HEADINGS
    size = speed * np.repeat(SPEEDS, HEADINGS)
    velocity = before.mean[2:MOVING] + size[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    time_s = segment.time_s - segment.time_s[0]
    place = before.mean[:2] + velocity[:, None] * time_s[:, None]
    ways = np.concatenate([place, np.broadcast_to(velocity[:, None], place.shape)], 2)
    return [replace(segment, agent=way) for way in ways]


def apart(one: Array, other: Array) -> float:
    """Largest distance (m) between two ways (K, 4) at the same step."""
    return float(np.hypot(*(one - other)[:, :2].T).max())
