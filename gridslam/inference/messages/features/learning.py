"""New features out of what nothing explains yet; docs/model.md, (M132), (M137).

Rival sets of them join the joint belief of the segment's beginning; the one that explains the segment best is
kept if it foretells the last steps, of which it wasn't made.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.following import START_STEPS
from gridslam.inference.messages.features.joint_update import SIGHTED
from gridslam.inference.messages.features.prices import usual_prices
from gridslam.inference.messages.features.rivals import CLEAR, Lesson, best_of
from gridslam.inference.messages.features.settling import SIGHTED_STEPS, beginnings
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, Segment
from gridslam.world.signal_model import SignalModel

JUDGED = 5
"""Last steps of a segment, which new features aren't learned from, but have to foretell."""


@dataclass(frozen=True, eq=False)
class Learned:
    """What learning did: features proposed and taken, and what they gain on the steps that judge, nats."""

    proposed: int = 0
    taken: int = 0
    gain: float = 0.0


def learn(state: HybridState, front: Front, model: SignalModel) -> tuple[HybridState, Learned]:
    """The state with what the segment teaches, and a new segment begun."""
    segment, old = state.segment, len(state.before.features)
    if len(segment) <= 2 * JUDGED:
        return state, Learned()
    prices = usual_prices(state.before, model)
    lesson = Lesson.of(state, segment, JUDGED, front, model)
    best, price = None, prices[0]
    for rival, kind in zip(lesson.rivals(segment, state.joint, prices), prices, strict=True):
        # in doubt, images are the rule
        if best is None or rival.beats(best, CLEAR):
            best, price = rival, kind
    assert best is not None
    best = lesson.best([best], [segment], price)
    if not old and state.sights < SIGHTED_STEPS and state.before_s is None:
        # the first steps alone left several ways open
        open_ways = beginnings(replace(state, step=START_STEPS), segment.first(START_STEPS), front, model)
        ways = [replace(segment, agent=lesson.judge(one.start, segment).track) for one in open_ways]
        others = [lesson.rivals(way, state.joint, price[None], other=best)[0] for way in ways]
        best = best_of([best, lesson.best(others, ways, price)])
    if not old and best.joint.extent > 0 and not best.placed:
        best = lesson.best(*lesson.elsewhere(best, segment, price), price)
    proposed, gain = len(best.joint.features) - old, float((best.evidence - segment.evidence)[-JUDGED:].sum())
    # those for the time being make way for as good ones of more steps
    passing = len(state.joint.features) > old
    if not proposed or gain <= -CLEAR * passing:
        return with_new_segment(state, state.joint), Learned(proposed, 0, gain if proposed else 0.0)
    detected = was_detected(best.joint)
    detected[:old] = True
    if not passing and not detected[old:].any():  # nothing is left that could say where the agent is
        return with_new_segment(state, state.joint), Learned(proposed, 0, gain)
    identity = int(best.joint.features.identity.max()) + 1
    taught = with_new_segment(state, best.joint.keep(detected))
    return replace(taught, next_identity=identity), Learned(proposed, int(detected.sum()) - old, gain)


def was_detected(joint: JointBelief) -> NDArray[np.bool_]:
    """Features (F,) that were heard at some step, or are surely there though they are never loud."""
    bank = joint.features
    seen: NDArray[np.bool_] = bank.steps_seen > 0
    return seen if joint.extent > 0 else seen | (bank.presence > SIGHTED)


def with_new_segment(state: HybridState, joint: JointBelief) -> HybridState:
    """The state with this belief, and an empty segment from here on."""
    empty = Segment.empty(*state.segment.samples.shape[1:])
    return replace(state, joint=joint, before=joint, segment=empty, before_s=state.time_s)
