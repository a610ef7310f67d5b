"""The front door of hybrid SLAM and of its references: samples in, agent and learned features out."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import ClassVar

import numpy as np

from gridslam.arrays import Array
from gridslam.estimate_tables import PathEstimate
from gridslam.estimates import Estimate
from gridslam.inference.health.signal_watch import EARLY
from gridslam.inference.management.features.feature_tables import feature_estimate
from gridslam.inference.management.features.hybrid_info import HybridInfo
from gridslam.inference.management.features.inherited_surfaces import KnownSurfaces, surfaces_after
from gridslam.inference.management.features.mirror_cells import mirrors_of
from gridslam.inference.management.features.sharing import handed_over, with_others
from gridslam.inference.management.features.surface_features import Images
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.lessons import HybridWork
from gridslam.inference.state.features.hybrid_state import HybridState
from gridslam.maps.frames import stamped
from gridslam.maps.map import Map
from gridslam.systems.hybrid_soundness import require_sound
from gridslam.systems.signal_front import SignalFilter
from gridslam.world.geometry import wrap
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan


def given_features(prior: Map, model: SignalModel) -> Images:
    """The features that an earlier agent's map gives to the next one."""
    left = prior.features, prior.feature_covariance, prior.surfaces, prior.surface_covariance
    return handed_over(*left, model)


class HybridFilter(SignalFilter[HybridState]):
    """The front of systems whose state is `HybridState`; a system adds its `start` and `advance`."""

    sight_alone: ClassVar[bool] = False
    """Whether particles stay all the way."""

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

    @property
    def lost(self) -> bool:
        """Whether paths have arrived before its lines of sight lately, as they can't."""
        return bool(self.state.early > EARLY)

    def _inherited(self, prior: Map) -> Map:
        return prior

    def map(self) -> Map:
        """Features, what mirrors among them say of surfaces and cells, and those of the map before.

        A lost agent adds nothing to the map that it began with.
        """
        belief, earlier = self.state.joint, self.inherited
        if earlier is not None and self.lost:
            return earlier
        table, joint = feature_estimate(belief, self.model.anchor_positions)
        mirrors = mirrors_of(table, belief, self.model)
        own_map = Map.of_scene(self.scene) if earlier is None else earlier
        known = KnownSurfaces.of(own_map.surfaces, own_map.surface_reflection, own_map.surface_covariance)
        start = None if earlier is None else given_features(earlier, self.model)
        known = surfaces_after(known, start, mirrors, table, joint, belief.sightings)
        if earlier is not None:
            table, joint = with_others(table, joint, earlier.features, earlier.feature_covariance, self.model)
        own_map = replace(
            own_map, features=table, feature_covariance=joint, provenance=self.latest(), anchors=None,
            evidence=own_map.evidence + mirrors.grid.evidence,
            observed=own_map.observed | mirrors.grid.observed,
            coefficient=own_map.coefficient + mirrors.grid.coefficient,
        )  # fmt: skip
        if len(known.table):
            own_map = replace(
                own_map, surfaces=known.table, surface_reflection=known.reflection,
                surface_covariance=known.covariance,
            )  # fmt: skip
        return stamped(own_map, self.scene)

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
