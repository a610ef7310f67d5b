"""Hybrid SLAM [HybridSlam]: physics for the line of sight, learned features for all else, from samples.

All formulas stand in docs/model.md, section 15. Ours: agent and features share one belief, so that what is
learned stays as uncertain as the agent was that learned it.
"""

from __future__ import annotations

import numpy as np

from gridslam.inference.management.features.feature_tables import with_features
from gridslam.inference.management.features.hybrid_info import HANDED_ON, SIGHTS, HybridInfo, conclude
from gridslam.inference.messages.features.feature_likelihood import require_hybrid
from gridslam.inference.messages.features.following import (
    FeatureWork,
    count_step,
    follow_by_particles,
    follow_jointly,
    predict_agent,
    remember,
    step_samples,
)
from gridslam.inference.messages.features.learning import Learned
from gridslam.inference.messages.features.lessons import SETTLED, HybridWork, apply_lesson, begin_lesson
from gridslam.inference.state.features.features import MOVING, FeatureBank
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, Segment
from gridslam.maps.map import Map
from gridslam.systems.hybrid_front import HybridFilter, given_features
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan


def start(model: SignalModel, prior: Map | None = None) -> HybridState:
    """The state before the first step: the agent's prior, and what an earlier agent left, see
    `sharing.handed_over`.

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
    if prior is not None:
        known = given_features(prior, model)
        belief = with_features(belief, known.table, known.covariance, model.anchor_positions)
    empty = Segment.empty(anchors, elements, frequencies)
    given = len(belief.features)
    heard = SIGHTS if given else 0
    return HybridState(
        belief,
        belief,
        empty,
        next_identity=given,
        sights=heard,
        sighted=np.full(anchors, heard),
        unseen=np.full(anchors, HANDED_ON if given else 0),
    )


def step(
    state: HybridState, scan: SignalScan, model: SignalModel, work: HybridWork
) -> tuple[HybridState, HybridInfo]:
    """One step, as the list of its messages ([HybridSlam], sections III to VI)."""
    work.begin()
    received = step_samples(scan, model)
    state = predict_agent(state, scan.time_s, model, work.seed, True)  # eqs. (19)-(23); (M133), (M571)
    if state.step < SETTLED:
        # eqs. (24)-(32); (M134) to (M136), and (M452), which tells a line of sight from other paths
        state, moments = follow_by_particles(state, received, model, bounded=True, work=work)
    else:
        state, moments = follow_jointly(state, received, model, work=work)  # (M126) to (M131), (M526), (M572)
    state = remember(state, received, moments)
    state = count_step(state, received, moments, work.front, model)  # (M451)
    state, learned = apply_lesson(state, model, work=work)  # eq. (43); (M132), (M137)
    state = begin_lesson(state, model, work=work)
    return state, conclude(state, moments, learned, received.heading_rad, work.times(), model)


def step_by_sight(
    state: HybridState, scan: SignalScan, model: SignalModel, work: FeatureWork
) -> tuple[HybridState, HybridInfo]:
    """One step of hybrid SLAM without any features: what the line of sight alone gives."""
    work.begin()
    received = step_samples(scan, model)
    state = predict_agent(state, scan.time_s, model, work.seed)  # eqs. (19)-(23); (M133)
    state, moments = follow_by_particles(state, received, model, work=work)  # eqs. (24)-(32); (M134)-(M136)
    state = count_step(state, received, moments, work.front, model)  # (M451)
    return state, conclude(state, moments, Learned(), received.heading_rad, work.times(), model)


class HybridSlam(HybridFilter):
    """Hybrid SLAM, one snapshot at a time: samples in, agent and learned features out.

    Parameters
    ----------
    scene : Scene
        Anchors, region and filter settings; its walls and scatterers are never read.
    prior_map : Map, optional
        Map that an earlier agent left: learned features, or surfaces, whose images of anchors are features.
    agent : str, optional
        Which of the scene's agents (default: the first): start and prior.
    seed : int
    same_frame : bool
        The user's word that `prior_map` is in the scene's frame, where it shares no anchor with it.
    waveform : Waveform, optional
        Of the recording, `Recording.waveform`. Default: what the scene's radio would sample.

    Raises
    ------
    InputError
        A scene without agents, an unknown one, a map of another frame, a waveform of other anchors, or one
        that hybrid SLAM has no model of, see `require_hybrid`.
    """

    method = "hybrid"
    start = staticmethod(start)
    """The state before the first step; arguments are those of `FilterFront.start`."""
    advance = staticmethod(step)
    """One step; arguments are those of `FilterFront.advance`."""


class SightSlam(HybridFilter):
    """Hybrid SLAM's reference, the line of sight alone: particles all the way, and no map.

    Arguments are those of `gridslam.HybridSlam`; `prior_map` isn't used.
    """

    method = "los"
    uses_maps = False
    sight_alone = True
    start = staticmethod(start)
    """The state before the first step; arguments are those of `FilterFront.start`."""
    advance = staticmethod(step_by_sight)
    """One step; arguments are those of `FilterFront.advance`."""
