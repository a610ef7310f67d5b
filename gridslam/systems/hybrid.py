"""Hybrid SLAM [HybridSlam]: physics for the line of sight, learned features for all else, from samples.

All formulas stand in docs/model.md, section 15. Ours: agent and features share one belief, so that what is
learned stays as uncertain as the agent was that learned it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.estimate_tables import PathEstimate
from gridslam.estimates import Estimate
from gridslam.inference.management.features.feature_tables import feature_estimate, with_features
from gridslam.inference.management.features.hybrid_info import HybridInfo, conclude
from gridslam.inference.management.features.surface_features import image_features
from gridslam.inference.messages.features.feature_likelihood import Front, require_hybrid
from gridslam.inference.messages.features.following import (
    counted,
    follow_by_particles,
    follow_jointly,
    predict_agent,
    remember,
    snapshot,
)
from gridslam.inference.messages.features.learning import Learned
from gridslam.inference.messages.features.lessons import SETTLED, Beside, put_aside, take_up
from gridslam.inference.state.features.features import MOVING, FeatureBank
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, Segment
from gridslam.maps.frames import stamped
from gridslam.maps.map import Map
from gridslam.systems.hybrid_soundness import require_sound
from gridslam.systems.signal_front import SignalFilter
from gridslam.world.geometry import wrap
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan


@dataclass(frozen=True, eq=False)
class HybridWork:
    """What steps share and no state holds.

    Attributes
    ----------
    front : Front
        Tables of the waveform.
    seed : int
    beside : Beside
        Learns ahead of when it is due.
    """

    front: Front
    seed: int
    beside: Beside = field(default_factory=Beside)


def start(model: SignalModel, prior: Map | None = None) -> HybridState:
    """The state before the first step: the agent's prior, and what an earlier agent left.

    These are features, or surfaces, of which the anchors' images are features.

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
        left, joint = prior.features, prior.feature_covariance
        if left is None or not len(left):  # of a method that maps surfaces
            left, joint = image_features(prior.surfaces, prior.surface_covariance, model)
        belief = with_features(belief, left, joint, model.anchor_positions)
    empty = Segment.empty(anchors, elements, frequencies)
    return HybridState(belief, belief, empty, next_identity=len(belief.features))


def step(
    state: HybridState, scan: SignalScan, model: SignalModel, work: HybridWork
) -> tuple[HybridState, HybridInfo]:
    """One step, as the list of its messages ([HybridSlam], sections III to VI)."""
    began = time.perf_counter()
    got = snapshot(scan, model)
    state = predict_agent(state, scan.time_s, model, work.seed)  # eqs. (19)-(23)
    if state.step < SETTLED:
        state, moments = follow_by_particles(state, got, work.front, model, work.seed)  # eqs. (24)-(32)
    else:
        state, moments = follow_jointly(state, got, model)
    followed = time.perf_counter()
    state = counted(remember(state, got, moments), got)
    state, learned = take_up(state, work.beside, work.front, model)  # eq. (43)
    state = put_aside(state, work.beside, work.front, model)
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
    state = counted(state, got)
    seconds = {"follow": time.perf_counter() - began}
    return state, conclude(state, moments, Learned(), got.heading_rad, seconds, model)


class HybridSlam(SignalFilter[HybridState]):
    """The front of hybrid SLAM."""

    method = "hybrid"
    sight_alone: ClassVar[bool] = False
    """Whether particles stay all the way."""
    start = staticmethod(start)
    advance = staticmethod(step)

    def _workspace(self) -> HybridWork:
        return HybridWork(Front(self.waveform), self.seed)

    @staticmethod
    def moved(state: HybridState, position_m: Array, heading_rad: float) -> HybridState:
        """The state before the first step, with its prior about another start (m)."""
        mean = state.joint.mean.copy()
        mean[:2] = position_m
        belief = replace(state.joint, mean=mean)
        return replace(state, joint=belief, before=belief)

    @classmethod
    def require_sound(cls, state: HybridState, model: SignalModel, where: str) -> None:
        """Refuse a state from a file whose numbers can't be."""
        require_sound(state, model, where, always_particles=cls.sight_alone)

    def _advanced(self, scan: SignalScan) -> tuple[HybridState, HybridInfo]:
        with runtime.one_blas_thread():
            return super()._advanced(scan)

    def estimate(self, state: HybridState, scan: SignalScan, info: HybridInfo, began: float) -> Estimate:
        """Agent and lines of sight; the heading is the measured one."""
        covariance = np.zeros((5, 5))
        covariance[:4, :4], covariance[4, 4] = info.agent_covariance, info.heading_variance
        return Estimate(
            scan.step, scan.time_s, info.agent[:2].copy(), info.agent[2:].copy(),
            float(wrap(info.heading_rad)), covariance, paths=self._sights(info),
            effective_sample_size=info.health.effective_sample_size,
            seconds=time.perf_counter() - began, health=info.health,
        )  # fmt: skip

    def map(self) -> Map:
        """A grid of which nothing was observed, and the learned features."""
        table, joint = feature_estimate(self.state.joint, self.model.anchor_positions)
        blank = Map.of_scene(self.scene)
        sheet = replace(blank, features=table, feature_covariance=joint, provenance=self.latest())
        return stamped(sheet, self.scene)

    def _sights(self, info: HybridInfo) -> PathEstimate:
        """The lines of sight, each with the probability that it is there."""
        anchors, count = self.model.anchors, len(self.model.anchors)
        way = anchors[:, :2] - info.agent[:2]
        far, angle = np.hypot(*way.T), np.arctan2(way[:, 1], way[:, 0])
        points = np.full((count, 4, 2), np.nan)
        points[:, 0], points[:, 3] = anchors[:, :2], info.agent[:2]
        elements = len(self.waveform.agent_element_m)
        amplitude = np.sqrt(elements * info.los_power / info.noise) / np.maximum(far, 1e-3)
        return PathEstimate(
            np.arange(count), np.full((count, 2), -1), far, wrap(angle + np.pi - anchors[:, 2]),
            wrap(angle - info.heading_rad), amplitude, info.existence.copy(), points,
        )  # fmt: skip


class SightSlam(HybridSlam):
    """The front of its reference, the line of sight alone."""

    method = "los"
    uses_maps = False
    sight_alone = True
    advance: Any = staticmethod(step_by_sight)
