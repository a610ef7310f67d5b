"""From particles to the joint belief, by way of whichever beginning explains the first steps best.

Where scattered paths are as strong as the line of sight and overlap it, particles that know of it alone
follow them instead. So features are proposed for the first steps already, along the particles' track and
along one that starts from the prior with what the very first step teaches; in a crowd, along eight more that
start beside it. Evidence decides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.inference.messages.features import sight
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.proposals import CROWD
from gridslam.inference.messages.features.rivals import Lesson, usual_prices
from gridslam.inference.state.features.features import MOVING
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, Segment
from gridslam.world.signal_model import SignalModel

STARTS, BESIDE_STD = 8, 2.5
"""Starts about the one that is believed that are tried in a crowd; how far off, in its deviations."""
CLIMBED = 3
"""Beginnings that are followed up, the best."""


def starts_beside(still: Segment, before: JointBelief) -> list[Segment]:
    """Stays at places about the start, as sure as that is known."""
    reach = BESIDE_STD * np.sqrt(np.trace(before.agent_covariance[:2, :2]) / 2)
    angle = 2 * np.pi * np.arange(STARTS) / STARTS
    shift = np.zeros((STARTS, MOVING))
    shift[:, :2] = reach * np.stack([np.cos(angle), np.sin(angle)], 1)
    return [replace(still, agent=still.agent + one) for one in shift]


def settle(state: HybridState, front: Front, model: SignalModel) -> HybridState:
    """The state with the joint belief after the first steps.

    Its features, if any, are for the time being: the segment goes on, and what it teaches takes their place.
    """
    cloud, segment = state.particles, state.segment
    if cloud is None:
        return state
    before = replace(state.before, los_power=sight.los_power(cloud), noise=cloud.noise.mean(1))
    state = replace(state, before=before, joint=before, particles=None)
    lesson = Lesson(before, None, 0, state.next_identity, 0, front, model)
    if len(before.features):  # an earlier agent's: the particles knew of them
        return replace(state, joint=lesson.judge(before, segment).joint)
    price = usual_prices(before, model)[:1]  # so short a track doesn't tell kinds apart
    still = replace(segment, agent=np.tile(before.mean[:MOVING], (len(segment), 1)))
    ways = [segment, still]
    begun = lesson.rivals(segment, before, price) + lesson.rivals(still, before, price, still.first(1))
    if max(len(one.joint.features) for one in begun) > CROWD:
        for way in starts_beside(still, before):
            lead = max(begun, key=lambda one: one.score)
            begun += lesson.rivals(way, before, price, way.first(1), lead)
            ways.append(way)
    order = sorted(range(len(begun)), key=lambda n: -begun[n].score)[:CLIMBED]
    begun, ways = [begun[n] for n in order], [ways[n] for n in order]
    plain, rival = lesson.judge(before, segment), lesson.best(begun, ways, price[0])
    best = max(plain, rival, key=lambda one: one.score)
    identity = best.joint.features.identity.max(initial=state.next_identity - 1) + 1
    segment = replace(segment, agent=best.track)
    return replace(state, joint=best.joint, segment=segment, next_identity=int(identity))
