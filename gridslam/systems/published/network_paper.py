"""Network SLAM as published: particles of agents, clocks and every anchor's virtual anchors, each apart.

[Venus2025network]; kept to compare with `gridslam.systems.network`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.estimates import Estimate
from gridslam.inference.management.network.readout import NetworkEstimate
from gridslam.inference.management.published.particle_readout import (
    agent_moments,
    feature_paths,
    feature_surfaces,
)
from gridslam.inference.messages.published.network_particle_births import add_network_births, propose_network
from gridslam.inference.messages.published.network_particle_ratios import evaluate_network
from gridslam.inference.messages.published.network_particles import (
    associate_network,
    move_network,
    update_network,
)
from gridslam.inference.scans.anchor_measurements import of_all_anchors
from gridslam.inference.state.published.network_particles import CLOCK, NetworkParticleState
from gridslam.maps.map import Map
from gridslam.systems.front import bare_map
from gridslam.systems.network_front import NetworkFront
from gridslam.systems.published.soundness import require_sound_network
from gridslam.world.clocks import NS
from gridslam.world.filter_model import detected
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan
from gridslam.world.radio import BINS, SPEED_OF_LIGHT

UNSET_M = 3 * NS
"""Standard deviation from which on a clock counts as searched for."""


@dataclass(frozen=True, eq=False)
class NetworkParticleInfo:
    """What happened at a step.

    Attributes
    ----------
    given : tuple of (M,) int or None
        Of every agent, the anchor that each measurement is believed to be of, -1 for clutter and doubt; None
        for an agent that isn't there.
    """

    given: tuple[NDArray[np.intp] | None, ...]


def start(model: NetworkModel, prior: Map | None = None) -> NetworkParticleState:
    """The state before the first step; a virtual anchor is nothing that a map's surfaces could stand for."""
    return NetworkParticleState.start(model)


def step(
    state: NetworkParticleState, scan: NetworkScan, model: NetworkModel, work: int
) -> tuple[NetworkParticleState, NetworkParticleInfo]:
    """One step, as the list of its messages: the agents in turn, each after what the others have said.

    Parameters
    ----------
    work : int
        The seed.
    """
    draw = np.random.default_rng([work, state.step])
    state = move_network(state, scan.time_s, scan.scans, model, draw)  # (12), (13)
    given: list[NDArray[np.intp] | None] = [None] * len(scan.scans)
    for agent, own in enumerate(scan.scans):
        if own is None:
            continue
        anchor_scan = of_all_anchors(own, model.agents[agent].radio.threshold)
        seen = evaluate_network(state, agent, anchor_scan, model.agents[agent])  # (17), (18)
        new = propose_network(state, agent, anchor_scan, model.agents[agent], draw)  # (23)
        found = associate_network(seen, new.odds)  # (21)
        state = update_network(state, agent, seen, found, draw)
        state = add_network_births(state, new, found, draw)  # (24) to (26)
        given[agent] = np.where(own.anchor >= 0, own.anchor, found.given)
    return replace(state, step=state.step + 1), NetworkParticleInfo(tuple(given))


class PublishedNetworkSlam(NetworkFront[NetworkParticleState]):
    """Network SLAM as published, one step of all agents at a time; arguments: `gridslam.NetworkSlam`."""

    method = "network-paper"
    uses_maps = False
    by_particles = True
    start = staticmethod(start)
    advance = staticmethod(step)
    require_sound = staticmethod(require_sound_network)

    def _workspace(self) -> Any:
        self.scene.require_planar()
        if self.model.clocks.drifting:
            where = f"{self.scene.name}: clocks.drift_prior_ppb"
            raise InputError(where, "clocks with rates", "clocks of one state, or --method network")
        return self.seed

    @staticmethod
    def started_at(state: Any, agent: int, position_m: Array, heading_rad: float) -> Any:
        """The state before the first step, with an agent's prior about another start (m, rad)."""
        agents = state.agents.copy()
        mean, _ = agent_moments(agents[agent, :, :CLOCK])
        agents[agent, :, :2] += np.asarray(position_m) - mean[:2]
        agents[agent, :, 4] += heading_rad - mean[4]
        return replace(state, agents=agents)

    def estimate(self, believed: Any, scan: NetworkScan, info: Any, began: float) -> Any:
        """Means and covariances over particles."""
        state: NetworkParticleState = believed
        model = self.model
        table = feature_surfaces(state.features, model.anchor_positions)
        found = detected(table.existence, model.settings)
        sure = state.features.take(found)
        agents, labels = dict[str, Estimate | None](), dict[str, NDArray[np.intp]]()
        for number, (name, anchor_scan, given) in enumerate(
            zip(model.names, scan.scans, info.given, strict=True)
        ):
            agents[name] = None
            if anchor_scan is None or given is None:
                continue
            mean, covariance = agent_moments(state.agents[number, :, :CLOCK])
            paths = feature_paths(sure, mean, model.anchors)
            agents[name] = Estimate(
                scan.step, scan.time_s, mean[:2], mean[2:4], float(mean[4]), covariance, table, paths,
                found, float(state.agents.shape[1]), time.perf_counter() - began,
            )  # fmt: skip
            labels[name] = given
        offsets = np.concatenate([state.clocks, state.agents[:, :, CLOCK]])
        variance = np.diag(offsets.var(-1)) / SPEED_OF_LIGHT**2
        whole = NetworkEstimate(
            scan.step, scan.time_s, agents, (*model.anchor_names, *model.names),
            offsets.mean(-1) / SPEED_OF_LIGHT, variance, state.clocks.std(-1) > UNSET_M, labels,
        )  # fmt: skip
        return whole.agents[self.agent] if self._single else whole

    def map(self) -> Map:
        """The map as it stands: surfaces of detected virtual anchors, and an unobserved grid."""
        table = feature_surfaces(self.state.features, self.model.anchor_positions)
        found = table.take(detected(table.existence, self.model.settings))
        return bare_map(self, found, np.full((len(found), BINS), 1 / BINS))
