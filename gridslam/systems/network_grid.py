"""Network grid SLAM: network SLAM with one occupancy grid and one set of coefficients for all agents.

[Li2026grid] has one agent, [Venus2025network] no grid; equations without a key are those of [Li2026grid].
docs/model.md, section 13.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.inference.management.network.fresh_look import look_afresh
from gridslam.inference.management.network.merging import merge_and_prune_shared
from gridslam.inference.management.network.recovery import recover_agents
from gridslam.inference.management.no_mirrors import drop_shared_no_mirrors
from gridslam.inference.management.step_info import NetworkInfo, StepInfo, conclude
from gridslam.inference.messages.birth_proposals import propose_births
from gridslam.inference.messages.births import add_births
from gridslam.inference.messages.cells import cast_paths
from gridslam.inference.messages.clutter import learn_clutter
from gridslam.inference.messages.double_bounces import put_off_double_bounces
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.mirrors import weigh_angles
from gridslam.inference.messages.network.cells import update_shared_cells
from gridslam.inference.messages.network.clock_setting import set_clocks
from gridslam.inference.messages.network.clock_ties import challenge_ties
from gridslam.inference.messages.network.departures import without_doubtful_departures, without_open_clocks
from gridslam.inference.messages.network.double_births import without_double_bounces
from gridslam.inference.messages.network.motion import predict_all
from gridslam.inference.messages.network.walk import learn_walk
from gridslam.inference.messages.reflection import Reflected
from gridslam.inference.messages.scatterers import weigh_forms
from gridslam.inference.messages.sight_births import leave_sights
from gridslam.inference.messages.strengths import correct_by_strengths
from gridslam.inference.messages.surface_walk import learn_shared_walks
from gridslam.inference.messages.updates import Exchange, in_turn, update_surfaces_and_agent
from gridslam.inference.state.grid import Grid
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.maps.map import Map
from gridslam.systems import network
from gridslam.systems.network import Works, by_anchor, scans_of_teachers, take_turns
from gridslam.systems.network_front import NetworkFilter
from gridslam.world.filter_model import FilterModel
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan
from gridslam.world.scan import Scan


def start(model: NetworkModel, prior: Map | None = None) -> NetworkState:
    """The state before the first step: priors of agents and clocks, and an earlier agent's map."""
    state = network.start(model, prior)
    if prior is None:
        return replace(state, grid=Grid.empty(model.agents[0].grid.shape))
    return replace(state, grid=Grid.inherited(prior.evidence, prior.observed, prior.coefficient))


def step(
    state: NetworkState, scan: NetworkScan, model: NetworkModel, work: Works
) -> tuple[NetworkState, NetworkInfo]:
    """One step: clocks, every agent's turn, and what all of them together say of the cells."""
    for own in work:
        own.begin()
    earlier_s = state.time_s
    predicted = state = predict_all(state, scan.time_s, scan.scans, model)  # (M104)
    state = recover_agents(state, scan.scans, earlier_s, model, work)
    state = look_afresh(state, scan.scans, model, work)  # (M492)
    state = challenge_ties(state, scans_of_teachers(state, scan), model, works=work)  # (M531)
    state = set_clocks(state, scans_of_teachers(state, scan), model, works=work)  # (M103)
    recalled = state
    state, infos = take_turns(state, scan, earlier_s, model, work, turn)
    used = [
        own.calibrated(one, info.turned) if info is not None and teaches else None
        for info, one, own, teaches in zip(infos, model.agents, work, state.teaches, strict=True)
    ]
    state = update_shared_cells(state, used, works=work)  # eqs. (43) to (46)
    state = learn_walk(predicted, state, model)  # (M331)
    state = learn_shared_walks(recalled, state)  # (M361)
    state = drop_shared_no_mirrors(state, model)  # (M517), (M548)
    state, merging = merge_and_prune_shared(state, model, infos)
    return replace(state, step=state.step + 1), NetworkInfo(merging)


def turn(
    state: State, agent: int, scan: Scan, network: NetworkState, earlier_s: float | None, model: FilterModel,
    work: Workspace,
) -> tuple[State, StepInfo]:  # fmt: skip
    """One agent's messages about its view: those of grid SLAM, over the paths of all anchors at once."""
    exchanges, calibration_used = list[Exchange](), state.calibration
    model = work.calibrated(model, calibration_used.turned)
    senders = np.flatnonzero(network.clocks.bearing(agent, network.labelled)).astype(np.int32)
    state, scans = by_anchor(state, scan, network, earlier_s, model, work)
    for anchor_scan in scans:
        radio = state.calibration.tuned(model.radio, anchor_scan.anchor)
        paths, visible = cast_paths(state, anchor_scan.anchor, model, work=work)  # eq. (1)
        amplitudes = Reflected(visible.products, radio)  # eq. (2)
        cloud, ratios = evaluate(anchor_scan, paths, visible.validity, amplitudes, radio, model, work=work)
        state, ratios, radio = learn_clutter(state, anchor_scan.anchor, ratios, radio, model)
        births, ratios = propose_births(  # eq. (11)
            state, anchor_scan, cloud, ratios, radio, model, senders, work=work
        )
        births, ratios = leave_sights(births, state, anchor_scan, paths, ratios, radio)  # (M549)
        births = without_double_bounces(  # (M491)
            births, state, anchor_scan, cloud, ratios, radio, model, senders, work=work
        )
        ratios = without_open_clocks(ratios, paths.rays, network, agent)  # (M496)
        sure = without_doubtful_departures(ratios, paths.rays, state, model)  # (M461)
        state, exchange = update_surfaces_and_agent(
            state, anchor_scan, paths, sure, calibration_used.turned, model, work=work
        )
        state = correct_by_strengths(state, anchor_scan, exchange, radio, model)  # (M542)
        state = weigh_angles(state, paths, ratios, exchange)  # (M517)
        state = weigh_forms(state, paths, ratios, exchange, model)  # (M559)
        births = put_off_double_bounces(births, state, anchor_scan, radio, model)  # (M516)
        state, exchange, _ = add_births(state, births, anchor_scan, exchange, radio, model, work=work)
        exchanges.append(exchange)
    exchanges = in_turn(exchanges)
    return conclude(state, exchanges, calibration_used, model, work)


class NetworkGridSlam(NetworkFilter):
    """Network grid SLAM, one step of all agents at a time; arguments as those of `gridslam.NetworkSlam`."""

    method = "network_grid"
    keeps_grid = True
    start = staticmethod(start)
    advance = staticmethod(step)

    def map(self) -> Map:
        """The map as it stands: evidence, coefficients, detected surfaces."""
        grid = self.state.grid
        assert grid is not None
        return replace(
            super().map(),
            evidence=grid.whole_evidence().astype(np.float32),
            coefficient=grid.coefficient,
            observed=grid.observed.copy(),
        )
