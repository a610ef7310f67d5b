"""Network grid SLAM: network SLAM with one occupancy grid and one set of coefficients for all agents.

[Li2026grid] has one agent, [Venus2025network] no grid; equations without a key are those of [Li2026grid].
docs/model.md, section 13.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gridslam.inference.management.step_info import NetworkInfo, StepInfo, conclude
from gridslam.inference.messages.birth_gates import admitted_births
from gridslam.inference.messages.births import add_births
from gridslam.inference.messages.cells import cast_paths
from gridslam.inference.messages.clutter import learn_clutter
from gridslam.inference.messages.double_bounces import put_off_double_bounces
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.mirrors import weigh_angles
from gridslam.inference.messages.network.cells import update_shared_cells
from gridslam.inference.messages.network.departures import without_doubtful_departures, without_open_clocks
from gridslam.inference.messages.reflection import Reflected
from gridslam.inference.messages.scatterers import weigh_forms
from gridslam.inference.messages.strengths import correct_by_strengths
from gridslam.inference.messages.updates import Exchange, in_turn, update_surfaces_and_agent
from gridslam.inference.state.grid import Grid
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.maps.map import Map
from gridslam.systems import grid, network
from gridslam.systems.network import Works, after_turns, bearing_anchors, before_turns, by_anchor, take_turns
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
    earlier_s = state.time_s
    predicted, recalled = before_turns(state, scan, model, work)
    state, infos = take_turns(recalled, scan, earlier_s, model, work, turn)
    used = models_used(state, infos, model, work)
    state = update_shared_cells(state, used, works=work)  # eqs. (43) to (46)
    return after_turns(predicted, recalled, state, infos, model)


def models_used(
    state: NetworkState, infos: Sequence[StepInfo | None], model: NetworkModel, work: Works
) -> list[FilterModel | None]:
    """Every agent's model as its turn had it; None for an agent that isn't there, or teaches nothing."""
    return [
        own.calibrated(one, info.turned) if info is not None and teaches else None
        for info, one, own, teaches in zip(infos, model.agents, work, state.teaches, strict=True)
    ]


def turn(
    state: State, agent: int, scan: Scan, network: NetworkState, earlier_s: float | None, model: FilterModel,
    work: Workspace,
) -> tuple[State, StepInfo]:  # fmt: skip
    """One agent's messages about its view: most of those of grid SLAM, on all anchors' paths at once.

    Paths are open, and as loud, as cells and coefficients have them; what is left out of a step of one
    agent and what is added is as in `network.turn`, whose arguments these are.
    """
    exchanges, calibration_used = list[Exchange](), state.calibration
    model = work.calibrated(model, calibration_used.turned)
    senders = bearing_anchors(network, agent)
    state, scans = by_anchor(state, scan, network, earlier_s, model, work)
    for anchor_scan in scans:
        radio = state.calibration.tuned(model.radio, anchor_scan.anchor)
        paths, visible = cast_paths(state, anchor_scan.anchor, model, work=work)  # eq. (1)
        amplitudes = Reflected(visible.products, radio)  # eq. (2)
        cloud, ratios = evaluate(anchor_scan, paths, visible.validity, amplitudes, radio, model, work=work)
        state, ratios, radio = learn_clutter(state, anchor_scan, ratios, radio, model)
        births, ratios = admitted_births(  # eq. (11), (M549), (M491)
            state, anchor_scan, cloud, paths, ratios, radio, model, senders, work=work
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
    """Network grid SLAM, one step of all agents at a time: network SLAM with one occupancy grid of all.

    Parameters
    ----------
    scene : Scene
        Radio, anchors, priors of clocks, grid and filter settings; its walls are never read.
    prior_map : Map, optional
        Map that an earlier agent left: evidence, coefficients and surfaces.
    agent : str, optional
        Names of agents with commas between; default: the first.
    seed : int
    same_frame : bool
        The user's word that `prior_map` is in the scene's frame, where it shares no anchor with it.
    agents : sequence of str, optional
        Names of agents, in the order in which they are heard within a step, instead of `agent`.

    Raises
    ------
    InputError
        A scene without agents, an unknown one, one twice, a map of another frame, or too many cells.

    Notes
    -----
    `step` takes a `NetworkScan` and returns a `NetworkEstimate`. Of one agent, it takes a `Scan`, too, and
    then returns an `Estimate`, as other methods do.
    """

    method = "network_grid"
    keeps_grid = True
    start = staticmethod(start)
    """The state before the first step; arguments are those of `FilterFront.start`."""
    advance = staticmethod(step)
    """One step; arguments are those of `FilterFront.advance`."""

    def map(self) -> Map:
        """The map as it stands: evidence, coefficients, detected surfaces."""
        return grid.with_cells(super().map(), self.state.part(0))
