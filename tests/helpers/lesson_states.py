"""States of hybrid SLAM whose segment is a way past features, for lessons and proposals."""

import numpy as np
from signal_worlds import received, signal_model

from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.joint_update import predict, update
from gridslam.inference.messages.features.learning import JUDGED
from gridslam.inference.messages.features.rivals import Lesson
from gridslam.inference.state.features.features import FeatureBank
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, Segment

LOS, LOS_POWER = np.array([3.0, 4.0, 0.0]), 3000.0
MIRROR, SCATTERER = np.array([-6.0, 2.0, 0.0]), np.array([2.0, -4.0, 8.06])
STEPS = 20


def state_after(points, powers, seed, elsewhere_from=STEPS, spread=(0.1, 0.1, 0.1, 0.1)):
    """A state whose segment is a way past the points; from `elsewhere_from` on, they are 5 m off."""
    model, draw = signal_model(spread=spread), np.random.default_rng(seed)
    belief = JointBelief(
        model.start_mean[:4], np.diag(model.start_variance[:4]), FeatureBank.empty(), np.array([0.9]),
        np.array([LOS_POWER]), np.ones(1),
    )  # fmt: skip
    segment, audible, at = Segment.empty(1, 4, 41), np.array([True]), belief
    for k in range(STEPS):
        place = np.array([0.1 * k, 0.5 * np.sin(0.2 * k)])
        rows = points if k < elsewhere_from else [point + np.array([0.0, 5.0, 0.0]) for point in points]
        z = received(model, place, 0.1 * k, [LOS, *rows], [LOS_POWER, *powers], draw)
        at, evidence = update(predict(at, 0.1, 2.0) if k else at, z, audible, 0.1 * k, model, k)
        segment = segment.add(0.1 * k, 0.1 * k, audible, z, np.array([*place, 1.0, 0.0]), evidence)
    return HybridState(belief, belief, segment, step=STEPS, time_s=0.1 * (STEPS - 1)), model


def lesson_of(state, model):
    return Lesson.of(state, state.segment, JUDGED, Front(model.waveform), model)


def hidden_start(seed, velocity, steps=10, seconds=0.5):
    """A state after its first steps, without a line of sight, and the agent's way past three mirrors."""
    model, draw = signal_model(spread=(0.1, 0.1, 0.5, 0.5)), np.random.default_rng(seed)
    belief = JointBelief(
        model.start_mean[:4], np.diag(model.start_variance[:4]), FeatureBank.empty(), np.array([0.1]),
        np.array([LOS_POWER]), np.ones(1),
    )  # fmt: skip
    points = [MIRROR, np.array([2.0, -7.0, 0.0]), np.array([8.0, 5.0, 0.0])]
    segment, audible = Segment.empty(1, 4, 41), np.array([True])
    way = seconds * np.arange(steps)[:, None] * np.asarray(velocity)
    for k, place in enumerate(way):
        z = received(model, place, 0.0, points, [900.0, 600.0, 800.0], draw)
        segment = segment.add(seconds * k, 0.0, audible, z, np.zeros(4), 0.0)
    return HybridState(belief, belief, segment, step=steps, time_s=seconds * (steps - 1)), model, way
