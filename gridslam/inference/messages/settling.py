"""From particles to the joint belief, by way of whichever beginning explains the first steps best.

Where scattered paths are as strong as the line of sight and overlap it, particles that know of it alone
follow them instead. So features are proposed for the first steps already, along the particles' track and
along one that starts from the prior with what the very first step teaches. Evidence decides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages import sight
from gridslam.inference.messages.feature_likelihood import Front
from gridslam.inference.messages.learning import replay, surveys, usual_prices, with_proposals
from gridslam.inference.state.features import MOVING
from gridslam.inference.state.hybrid_state import HybridState, JointBelief, Segment
from gridslam.world.signal_model import SignalModel

ROUNDS = 2
"""Times that features are proposed along the track that the ones before gave."""


def settle(state: HybridState, front: Front, model: SignalModel) -> HybridState:
    """The state with the joint belief after the first steps.

    Its features, if any, are for the time being: the segment goes on, and what it teaches takes their place.
    """
    cloud, segment = state.particles, state.segment
    if cloud is None:
        return state
    before = replace(state.before, los_power=sight.los_power(cloud), noise=cloud.noise.mean(1))
    state = replace(state, before=before, joint=before, particles=None)
    plain, evidence, track = replay(before, segment, None, 0, model)
    ends = [(float(evidence.sum()), plain, track)]
    if len(before.features):  # an earlier agent's: the particles knew of them
        return replace(state, joint=plain)
    price = usual_prices(before, model)[0]  # so short a track doesn't tell kinds apart
    ends.append(_proposed(state, segment, segment, price, front, model))
    still = replace(segment, agent=np.tile(before.mean[:MOVING], (len(segment), 1)))
    end = _proposed(state, still, segment.first(1), price, front, model)
    for _ in range(ROUNDS):
        _, found, track = end
        levels = replace(before, noise=found.noise, los_power=found.los_power)
        along = replace(segment, agent=track)
        end = _proposed(replace(state, joint=levels), along, along, price, front, model)
        ends.append(end)
    _, joint, track = max(ends, key=lambda end: end[0])
    identity = joint.features.identity.max(initial=state.next_identity - 1) + 1
    return replace(state, joint=joint, segment=replace(segment, agent=track), next_identity=int(identity))


def _proposed(
    state: HybridState, segment: Segment, taught: Segment, price: Array, front: Front, model: SignalModel
) -> tuple[float, JointBelief, Array]:
    """Evidence, belief and track with the features that a part of the first steps proposes."""
    taught = replace(taught, agent=segment.agent[: len(taught)])
    looks = surveys(state.before, state, taught, 0, front, model)
    wider, _ = with_proposals(state.before, replace(state, step=len(taught)), taught, looks, price, model)
    found, evidence, track = replay(wider, segment, None, 0, model)
    return float(evidence.sum()), found, track
