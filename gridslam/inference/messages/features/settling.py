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
from gridslam.inference.messages.features.prices import usual_prices
from gridslam.inference.messages.features.rivals import (
    CLEAR,
    FOLLOWED,
    Lesson,
    Rival,
    best_of,
)
from gridslam.inference.messages.features.ways import apart, straight_ways
from gridslam.inference.state.features.features import MOVING
from gridslam.inference.state.features.hybrid_state import HybridState, Segment
from gridslam.world.signal_model import SignalModel

SIGHTED_STEPS = 5
"""Of the first steps, at which a line of sight has to be heard for particles to tell the agent's way."""
OTHER_M, MOST = 0.3, 4
"""How far apart ways of the first steps have to be to be followed up beside each other, and how many."""


def settle(state: HybridState, front: Front, model: SignalModel) -> HybridState:
    """The state with the joint belief after the first steps.

    Its features, if any, are for the time being: the segment goes on, and what it teaches takes their place.
    Those of an earlier agent's map last, unless the steps are explained better without them: then the map is
    of another world, or its maker was lost.
    """
    cloud, segment = state.particles, state.segment
    if cloud is None:
        return state
    before = replace(state.before, los_power=sight.los_power(cloud), noise=cloud.noise.mean(1))
    state = replace(state, before=before, joint=before, particles=None)
    best = beginning(state, segment, front, model)
    bank = before.features
    if len(bank):  # an earlier agent's, that the particles knew of: also without
        none = np.zeros(len(bank), bool)
        bare = replace(state, before=before.keep(none), joint=before.keep(none))
        without = beginning(bare, segment, front, model)
        if without.beats(best, CLEAR):
            state, best = bare, without
    identity = best.joint.features.identity.max(initial=state.next_identity - 1) + 1
    segment = replace(segment, agent=best.track)
    return replace(state, joint=best.joint, segment=segment, next_identity=int(identity))


def beginning(state: HybridState, segment: Segment, front: Front, model: SignalModel) -> Rival:
    """The set of features, on top of those that are known, that explains the first steps best."""
    return beginnings(state, segment, front, model)[0]


def beginnings(state: HybridState, segment: Segment, front: Front, model: SignalModel) -> list[Rival]:
    """Sets that may explain the first steps, the best first; one where a line of sight tells the way."""
    before, lesson = state.before, Lesson.of(state, segment, 0, front, model)
    price = usual_prices(before, model)[:1]  # so short a track doesn't tell kinds apart
    plain = lesson.judge(before, segment)
    still = replace(segment, agent=np.tile(before.mean[:MOVING], (len(segment), 1)))
    begun = lesson.rivals(segment, plain.joint if len(before.features) else before, price)
    # one step shows few features: where ten show a crowd, these stand for one, too
    alike = replace(lesson, before=replace(before, extent=begun[0].joint.extent))
    begun += alike.rivals(still, before, price, still.first(1))
    best = best_of([plain, alike.best(begun, [segment, still], price[0])])
    if len(before.features) or state.sights >= SIGHTED_STEPS:
        return [best]
    ways = straight_ways(segment, before)
    tried = [lesson.rivals(way, before, price, other=best)[0] for way in ways]
    order = np.argsort([-one.score for one in tried], kind="stable")[:FOLLOWED]
    climbed = lesson.best([tried[k] for k in order], [ways[k] for k in order], price[0])
    return distinct([best, climbed, *begun, *tried])


def distinct(rivals: list[Rival]) -> list[Rival]:
    """The best of several sets, each of which leads another way."""
    found = list[Rival]()
    for one in sorted(rivals, key=lambda one: -one.score):
        if one.score > -np.inf and all(apart(one.track, other.track) > OTHER_M for other in found):
            found.append(one)
    return found[:MOST]
