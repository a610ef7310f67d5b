"""What health says of hybrid SLAM whose antennas tell no directions, about an only anchor in sight."""

from dataclasses import replace

import numpy as np
import pytest
from signal_worlds import signal_model

from gridslam.inference.health.reasons import TURNABLE
from gridslam.inference.management.features.hybrid_info import HANDED_ON, LATELY, SIGHTS, conclude
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.following import StepSamples, count_step
from gridslam.inference.messages.features.learning import Learned
from gridslam.inference.messages.features.sight import Moments
from gridslam.inference.state.features.features import FeatureBank
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, Segment

SINGLE = {"agent_element_m": np.zeros((1, 2))}
WHERE = Moments(np.zeros(4), 1e-4 * np.eye(4), 0.0, np.inf)


def told(model, sighted, features=1, unseen=0):
    """Of an agent that is well but for what nothing tells."""
    joint = JointBelief(np.zeros(4), 1e-4 * np.eye(4), FeatureBank.empty(), *np.ones((3, len(sighted))))
    for number in range(features):
        joint = joint.with_feature(0, np.ones(3), np.eye(3), np.zeros(2), 1.0, number, 0)
    state = HybridState(joint, joint, Segment.empty(len(sighted), 1, 41), step=40, sights=max(sighted))
    state = replace(state, sighted=np.array(sighted), unseen=np.zeros(len(sighted), int) + unseen)
    return conclude(state, WHERE, Learned(), 0.0, {}, model).health.why


@pytest.mark.parametrize("sighted", [[40], [40, 0], [SIGHTS - 1, 40]])
def test_lengths_to_one_anchor_tell_no_turn_of_agent_and_features(sighted):
    assert told(signal_model(**SINGLE), sighted) == TURNABLE
    assert not told(signal_model(), sighted), "2 x 2 antennas tell directions"
    assert not told(signal_model(**SINGLE), sighted, features=0), "particles say how wide all is"


def test_two_anchors_tell_it():
    assert not told(signal_model(**SINGLE), [SIGHTS, 40])


def test_two_anchors_tell_it_no_longer_where_one_of_them_has_been_out_of_sight():
    model = signal_model(**SINGLE)
    assert not told(model, [SIGHTS, 40], unseen=[LATELY, 0])
    assert told(model, [SIGHTS, 40], unseen=[LATELY + 1, 0]) == TURNABLE
    assert not told(model, [SIGHTS, 40, 40], unseen=[LATELY + 1, 0, 0])
    assert not told(model, [SIGHTS, SIGHTS], unseen=HANDED_ON), "an earlier agent's features do"


def test_steps_are_counted_at_which_each_anchor_is_in_sight():
    model = signal_model(**SINGLE)
    joint = JointBelief(np.zeros(4), np.eye(4), FeatureBank.empty(), np.array([0.99]), np.ones(1), np.ones(1))
    got = StepSamples(np.ones((1, 1, 41), complex), np.array([True]), 0.0)
    state = HybridState(joint, joint, Segment.empty(1, 1, 41))
    for _ in range(2):
        state = count_step(state, got, WHERE, Front(model.waveform), model)
    hidden = replace(state, joint=replace(joint, existence=np.array([0.5])))
    hidden = count_step(hidden, got, WHERE, Front(model.waveform), model)
    assert (state.sighted.tolist(), hidden.sighted.tolist()) == ([2], [2])
    assert (state.unseen.tolist(), hidden.unseen.tolist()) == ([0], [1])
    given = count_step(
        replace(hidden, unseen=np.array([HANDED_ON])), got, WHERE, Front(model.waveform), model
    )
    assert given.unseen[0] < -LATELY
