"""Hybrid SLAM [HybridSlam]: physics for the line of sight, learned features for all else, from samples.

All formulas stand in docs/model.md, section 15. Ours: agent and features share one belief, so that what is
learned stays as uncertain as the agent was that learned it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from gridslam.inference.management.hybrid_info import HybridInfo, conclude
from gridslam.inference.messages.feature_likelihood import Front, require_hybrid
from gridslam.inference.messages.following import (
    START_STEPS,
    follow_by_particles,
    follow_jointly,
    predict_agent,
    remember,
    settle,
    snapshot,
)
from gridslam.inference.messages.learning import Learned, learn
from gridslam.inference.state.features import MOVING, FeatureBank
from gridslam.inference.state.hybrid_state import HybridState, JointBelief, Segment
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

LEARN_EVERY = 30
"""Steps of a segment."""


@dataclass(frozen=True, eq=False)
class HybridWork:
    """What steps share and no state holds: tables of the waveform, and the seed.

    Attributes
    ----------
    front : Front
    seed : int
    """

    front: Front
    seed: int


def start(model: SignalModel) -> HybridState:
    """The state before the first step: the agent's prior, no features.

    Raises
    ------
    InputError
        See `require_hybrid`.
    """
    require_hybrid(model)
    anchors, _, elements, frequencies = model.waveform.shape
    belief = JointBelief(
        model.start_mean[:MOVING].copy(), np.diag(model.start_variance[:MOVING]), FeatureBank.empty(),
        np.full(anchors, 0.5), np.ones(anchors), np.ones(anchors),
    )  # fmt: skip
    return HybridState(belief, belief, Segment.empty(anchors, elements, frequencies))


def step(
    state: HybridState, scan: SignalScan, model: SignalModel, work: HybridWork
) -> tuple[HybridState, HybridInfo]:
    """One step, as the list of its messages ([HybridSlam], sections III to VI)."""
    began, learned = time.perf_counter(), Learned()
    got = snapshot(scan, model)
    state = predict_agent(state, scan.time_s, model, work.seed)
    if state.step < START_STEPS:
        state, moments = follow_by_particles(state, got, work.front, model, work.seed)
    else:
        state, moments = follow_jointly(state, got, model)
    followed = time.perf_counter()
    state = remember(state, got, moments)
    state = replace(state, step=state.step + 1, silent=0 if got.heard.any() else state.silent + 1)
    if state.step == START_STEPS:
        state = settle(state, model)
    if state.step % LEARN_EVERY == 0:
        state, learned = learn(state, work.front, model)
    seconds = {"follow": followed - began, "learn": time.perf_counter() - followed}
    return state, conclude(state, moments, learned, got.heading_rad, seconds, model)


def step_by_sight(
    state: HybridState, scan: SignalScan, model: SignalModel, work: HybridWork
) -> tuple[HybridState, HybridInfo]:
    """The same without any features: what the line of sight alone gives."""
    began = time.perf_counter()
    got = snapshot(scan, model)
    state = predict_agent(state, scan.time_s, model, work.seed)
    state, moments = follow_by_particles(state, got, work.front, model, work.seed)
    state = replace(state, step=state.step + 1, silent=0 if got.heard.any() else state.silent + 1)
    seconds = {"follow": time.perf_counter() - began}
    return state, conclude(state, moments, Learned(), got.heading_rad, seconds, model)
