"""From particles to the joint belief, by way of whichever beginning explains the first steps best.

Where scattered paths are as strong as the line of sight and overlap it, particles that know of it alone
follow them instead. So features are proposed for the first steps already, along the particles' track and
along one that starts from the prior with what the very first step teaches. Evidence decides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.inference.messages.features import sight
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.rivals import Lesson, best_of, usual_prices
from gridslam.inference.state.features.features import MOVING
from gridslam.inference.state.features.hybrid_state import HybridState
from gridslam.world.signal_model import SignalModel


def settle(state: HybridState, front: Front, model: SignalModel) -> HybridState:
    """The state with the joint belief after the first steps.

    Its features, if any, are for the time being: the segment goes on, and what it teaches takes their place.
    """
    cloud, segment = state.particles, state.segment
    if cloud is None:
        return state
    before = replace(state.before, los_power=sight.los_power(cloud), noise=cloud.noise.mean(1))
    state = replace(state, before=before, joint=before, particles=None)
    lesson = Lesson.of(state, segment, 0, front, model)
    if len(before.features):  # an earlier agent's: the particles knew of them
        return replace(state, joint=lesson.judge(before, segment).joint)
    price = usual_prices(before, model)[:1]  # so short a track doesn't tell kinds apart
    still = replace(segment, agent=np.tile(before.mean[:MOVING], (len(segment), 1)))
    begun = lesson.rivals(segment, before, price) + lesson.rivals(still, before, price, still.first(1))
    plain, rival = lesson.judge(before, segment), lesson.best(begun, [segment, still], price[0])
    best = best_of([plain, rival])
    identity = best.joint.features.identity.max(initial=state.next_identity - 1) + 1
    segment = replace(segment, agent=best.track)
    return replace(state, joint=best.joint, segment=segment, next_identity=int(identity))
