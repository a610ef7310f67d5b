"""Network SLAM: several agents, anchors whose clocks nobody set, measurements that don't say whose they are.

After [Venus2025network], with one correlated belief over agents, clocks and surfaces that all share, where
that has marginal beliefs and virtual anchors per anchor; docs/model.md, section 13.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import replace
from gridslam.inference.health.reasons import ASTRAY, CLOCK_CONTESTED, CLOCK_OPEN
from gridslam.inference.management.network.early_arrivals import watched_sights
from gridslam.inference.management.network.fresh_look import look_afresh
from gridslam.inference.management.network.merging import merge_and_prune_shared
from gridslam.inference.management.network.recovery import recover_agents
from gridslam.inference.management.no_mirrors import drop_shared_no_mirrors
from gridslam.inference.management.poses.pose_recovery import recover_pose
from gridslam.inference.management.step_info import NetworkInfo, StepInfo, conclude
from gridslam.inference.messages.birth_gates import admitted_births
from gridslam.inference.messages.births import add_births
from gridslam.inference.messages.clutter import learn_clutter
from gridslam.inference.messages.detections import mark_detections
from gridslam.inference.messages.double_bounces import put_off_double_bounces
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.mirrors import weigh_angles
from gridslam.inference.messages.network.clock_setting import doubt_clocks, loosened, set_clocks
from gridslam.inference.messages.network.clock_ties import challenge_ties
from gridslam.inference.messages.network.departures import without_doubtful_departures, without_open_clocks
from gridslam.inference.messages.network.motion import predict_all
from gridslam.inference.messages.network.walk import learn_walk
from gridslam.inference.messages.path_prediction import predict_paths
from gridslam.inference.messages.ray_amplitudes import (
    predict_amplitudes,
    start_amplitudes,
    update_amplitudes,
)
from gridslam.inference.messages.scatterers import weigh_forms
from gridslam.inference.messages.strengths import correct_by_strengths
from gridslam.inference.messages.surface_walk import learn_shared_walks
from gridslam.inference.messages.updates import Exchange, in_turn, update_surfaces_and_agent
from gridslam.inference.scans.anchor_measurements import AnchorScan, split_by_anchor, whole_scan
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.maps.map import Map
from gridslam.systems.front import inherit_surfaces
from gridslam.systems.network_front import NetworkFilter
from gridslam.world.filter_model import FilterModel
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan
from gridslam.world.scan import Scan

Works = tuple[Workspace, ...]
Turn = Callable[
    [State, int, Scan, NetworkState, float | None, FilterModel, Workspace], tuple[State, StepInfo]
]
"""What one agent's scan says: its view of all, which it is, what was heard, what all believe, when the step
before was."""


def start(model: NetworkModel, prior: Map | None = None) -> NetworkState:
    """The state before the first step: priors of agents and clocks, surfaces of an earlier agent's map."""
    state = NetworkState.start(model)
    return state if prior is None else inherit_surfaces(state, prior)


def step(
    state: NetworkState, scan: NetworkScan, model: NetworkModel, work: Works
) -> tuple[NetworkState, NetworkInfo]:
    """One step: clocks by what all agents heard, then every agent's turn after those before it."""
    earlier_s = state.time_s
    predicted, recalled = before_turns(state, scan, model, work)
    state, infos = take_turns(recalled, scan, earlier_s, model, work, turn)
    return after_turns(predicted, recalled, state, infos, model)


def before_turns(
    state: NetworkState, scan: NetworkScan, model: NetworkModel, work: Works
) -> tuple[NetworkState, NetworkState]:
    """Motion and clocks: what a step begins with, before any agent's turn.

    Returns
    -------
    (predicted, recalled)
        predicted: after motion alone; recalled: with lost agents found and clocks set, where turns begin.
    """
    for own in work:
        own.begin()
    earlier_s = state.time_s
    predicted = state = predict_all(state, scan.time_s, scan.scans, model)  # (M104)
    state = recover_agents(state, scan.scans, earlier_s, model, work)  # docs/model.md, section 13
    state = look_afresh(state, scan.scans, model, work)  # (M492)
    state = challenge_ties(state, scans_of_teachers(state, scan), model, works=work)  # (M531)
    state = set_clocks(state, scans_of_teachers(state, scan), model, works=work)  # (M103)
    return predicted, state


def after_turns(
    predicted: NetworkState,
    recalled: NetworkState,
    state: NetworkState,
    infos: Sequence[StepInfo | None],
    model: NetworkModel,
) -> tuple[NetworkState, NetworkInfo]:
    """Walks of clocks and surfaces, and which surfaces stay: what a step ends with.

    Parameters
    ----------
    predicted, recalled : NetworkState
        What `before_turns` returned.
    infos : sequence of StepInfo or None
        What happened in every agent's turn.
    """
    state = learn_walk(predicted, state, model)  # (M331)
    state = learn_shared_walks(recalled, state)  # (M361)
    state = drop_shared_no_mirrors(state, model)  # (M517), (M548)
    state, infos = merge_and_prune_shared(state, model, infos)  # (M513), (M574)
    return replace(state, step=state.step + 1), NetworkInfo(tuple(infos))


def scans_of_teachers(state: NetworkState, scan: NetworkScan) -> list[Scan | None]:
    """What was heard by the agents that aren't lost; None for the others."""
    return [own if teaches else None for own, teaches in zip(scan.scans, state.teaches, strict=True)]


def take_turns(
    state: NetworkState,
    scan: NetworkScan,
    earlier_s: float | None,
    model: NetworkModel,
    work: Works,
    turn: Turn,
) -> tuple[NetworkState, list[StepInfo | None]]:
    """Every agent's turn after those before it; an agent that isn't there has none.

    One that is lost hears what all have mapped, and teaches nothing until it is followed again.

    Parameters
    ----------
    earlier_s : float or None
        Time of the step before; None at the first.
    work : tuple of Workspace
        One for every agent.
    turn : callable
        One agent's turn; see `Turn`.

    Returns
    -------
    (state, infos)
        infos: what happened in every agent's turn; None for one that isn't there.
    """
    infos = list[StepInfo | None]()
    for agent, (own_scan, own_model, own_work) in enumerate(zip(scan.scans, model.agents, work, strict=True)):
        info = None
        if own_scan is not None:
            part = without_turns(state, agent)
            part, info = turn(part, agent, own_scan, state, earlier_s, own_model, own_work)
            part, info = watched_sights(part, info, own_scan, own_model, work=own_work)  # (M532)
            state, info = take_in(state, agent, part, info, model)
        infos.append(info)
    return state, infos


def take_in(
    state: NetworkState, agent: int, part: State, info: StepInfo, model: NetworkModel
) -> tuple[NetworkState, StepInfo]:
    """What all believe after an agent's turn, and the turn's health with what its place and clock say.

    Parameters
    ----------
    part : State
        The agent's view after its turn.
    """
    if state.recorded(agent, part.monitor).teaches[agent]:
        state = loosened(state.having(agent, part))  # (M102); open clocks (M103)
        state = doubt_clocks(state, agent, info.exchanges, model)
    else:
        state, info = state.apart(agent, part), replace(info.doubted(ASTRAY), teaches=False)
    if state.clocks.adrift(agent):
        info = info.doubted(CLOCK_OPEN)
    elif state.clocks.contested(agent):
        info = info.doubted(CLOCK_CONTESTED)
    return state, info


def without_turns(state: NetworkState, agent: int) -> State:
    """An agent's part; no anchor is taken to be turned while its clock is open, or one that the pose needs.

    Of an open clock, angles alone choose which path is the line of sight; and a wrong clock moves a pose that
    needs it, from where all anchors seem turned.
    """
    part, open_ = state.part(agent), state.clocks.open_to(agent)
    doubtful = np.full_like(open_, open_.any()) if state.clocks.framed else open_
    return replace(part, calibration=part.calibration.unturned(doubtful))


def turn(
    state: State,
    agent: int,
    scan: Scan,
    network: NetworkState,
    earlier_s: float | None,
    model: FilterModel,
    work: Workspace,
) -> tuple[State, StepInfo]:
    """One agent's messages about its view: most of those of adaptive SLAM, on all anchors' paths at once.

    Left out are what earlier steps left over (M251), elevations and levels (M302) to (M305), anchors at
    unsure places (M569), outages (M580), and what spares or parks walls out of sight (M495), (M575). Added,
    where clocks aren't known: births held against double bounces (M491), what isn't to correct anything
    (M461), (M496), and lengths by amplitudes (M542).

    Parameters
    ----------
    state : State
        The agent's view.
    agent : int
        Its index.
    network : NetworkState
        What all believe as the turn begins.
    earlier_s : float or None
        Time of the step before; None at the first.
    """
    exchanges, calibration_used = list[Exchange](), state.calibration
    model = work.calibrated(model, calibration_used.turned)
    senders = bearing_anchors(network, agent)
    state, scans = by_anchor(state, scan, network, earlier_s, model, work)
    for anchor_scan in scans:
        radio = state.calibration.tuned(model.radio, anchor_scan.anchor)
        paths = predict_paths(state, anchor_scan.anchor, model, work=work)
        amplitudes = predict_amplitudes(state, paths, anchor_scan, model.radio, work=work)
        cloud, ratios = evaluate(anchor_scan, paths, np.ones(len(paths)), amplitudes, radio, model, work=work)
        state, ratios, radio = learn_clutter(state, anchor_scan, ratios, radio, model)
        births, ratios = admitted_births(  # (M549), (M491)
            state, anchor_scan, cloud, paths, ratios, radio, model, senders, work=work
        )
        ratios = without_open_clocks(ratios, paths.rays, network, agent)  # (M496)
        sure = without_doubtful_departures(ratios, paths.rays, state, model)  # (M461)
        state, exchange = update_surfaces_and_agent(
            state, anchor_scan, paths, sure, calibration_used.turned, model, work=work
        )
        state = correct_by_strengths(  # (M542)
            state, anchor_scan, exchange, radio, model, weakened=True
        )
        state = weigh_angles(state, paths, ratios, exchange)  # (M517)
        state = weigh_forms(state, paths, ratios, exchange, model)  # (M559)
        state = update_amplitudes(state, paths, amplitudes, anchor_scan, exchange, model, work=work)
        state = mark_detections(state, paths.rays, exchange.responsible.sum(1), model, work=work)
        births = put_off_double_bounces(births, state, anchor_scan, radio, model)  # (M516)
        state, exchange, born = add_births(state, births, anchor_scan, exchange, radio, model, work=work)
        state = start_amplitudes(state, born, anchor_scan, model.radio)
        exchanges.append(exchange)
    exchanges = in_turn(exchanges)
    return conclude(state, exchanges, calibration_used, model, work)


def bearing_anchors(network: NetworkState, agent: int) -> NDArray[np.int32]:
    """Numbers of the anchors whose paths to an agent may bear surfaces."""
    return np.flatnonzero(network.clocks.bearing(agent, network.labelled)).astype(np.int32)


def by_anchor(
    state: State, scan: Scan, network: NetworkState, earlier_s: float | None, model: FilterModel,
    work: Workspace,
) -> tuple[State, Sequence[AnchorScan]]:  # fmt: skip
    """A scan by anchors where it says whose it is, else whole; with all known, a lost agent is found.

    Arguments are those of `turn`.

    Returns
    -------
    (state, scans)
        scans: of one anchor each, the surest first; or one of all.
    """
    if not network.labelled:
        return state, [work.once(whole_scan, scan, model)]
    scans = split_by_anchor(scan, model)
    if not state.belief.clocks:
        state = recover_pose(state, scans, earlier_s, model, work=work)
    return state, scans.surest_first


class NetworkSlam(NetworkFilter):
    """Network SLAM, one step of all agents at a time.

    Parameters
    ----------
    scene : Scene
        Radio, anchors, priors of clocks and filter settings; its walls are never read.
    prior_map : Map, optional
        Map that an earlier agent left, of which the surfaces are used.
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
        A scene without agents, an unknown one, one twice, or a map of another frame.

    Notes
    -----
    `step` takes a `NetworkScan` and returns a `NetworkEstimate`. Of one agent, it takes a `Scan`, too, and
    then returns an `Estimate`, as other methods do.
    """

    method = "network"
    start = staticmethod(start)
    """The state before the first step; arguments are those of `FilterFront.start`."""
    advance = staticmethod(step)
    """One step; arguments are those of `FilterFront.advance`."""
