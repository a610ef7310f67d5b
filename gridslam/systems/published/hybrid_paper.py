"""Hybrid SLAM's learning as published: features from random places, by two networks of the anchor's position.

Kept to compare with: particles all the way, and a map taken as exact; [HybridSlam], sections IV to VI.
"""

from __future__ import annotations

from gridslam.inference.management.features.hybrid_info import HybridInfo, conclude
from gridslam.inference.messages.features.following import (
    FeatureWork,
    count_step,
    follow_by_particles,
    predict_agent,
    remember,
    step_samples,
)
from gridslam.inference.messages.features.learning import Learned
from gridslam.inference.messages.features.network_learning import learn_by_networks
from gridslam.inference.state.features.hybrid_state import HybridState
from gridslam.maps.map import Map
from gridslam.systems.hybrid import start as start_hybrid
from gridslam.systems.hybrid_front import HybridFilter
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan


def start(model: SignalModel, prior: Map | None = None) -> HybridState:
    """The state before the first step; an earlier map has no place in the networks."""
    return start_hybrid(model)


def step(
    state: HybridState, scan: SignalScan, model: SignalModel, work: FeatureWork
) -> tuple[HybridState, HybridInfo]:
    """One step, as the list of its messages ([HybridSlam], sections III to VI)."""
    work.begin()
    received = step_samples(scan, model)
    state = predict_agent(state, scan.time_s, model, work.seed)  # eqs. (19)-(23)
    state, moments = follow_by_particles(state, received, model, work=work)  # eqs. (24)-(32)
    state = remember(state, received, moments)
    state = count_step(state, received, moments, work.front, model)  # (M451)
    state = learn_by_networks(state, model, work=work)  # eqs. (42), (43)
    return state, conclude(state, moments, Learned(), received.heading_rad, work.times(), model)


class PublishedHybridSlam(HybridFilter):
    """Hybrid SLAM's learning as published, to compare with.

    Parameters
    ----------
    scene, prior_map, agent, seed, same_frame, waveform
        As `HybridSlam`; the map isn't used.
    """

    method = "hybrid-paper"
    uses_maps = False
    sight_alone = True
    start = staticmethod(start)
    advance = staticmethod(step)
