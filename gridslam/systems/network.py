"""Network SLAM: several agents, anchors whose clocks nobody set, measurements that don't say whose they are.

After [Venus2025network], with one correlated belief over agents, clocks and surfaces that all share, where
that has marginal beliefs and virtual anchors per anchor; docs/model.md, section 13.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.errors import InputError
from gridslam.inference.health.reasons import ASTRAY
from gridslam.inference.management.network.clock_rivals import advance
from gridslam.inference.management.network.merging import merge_and_prune_shared
from gridslam.inference.management.network.readout import CONFIRMED, network_estimate
from gridslam.inference.management.network.recovery import recover_agents
from gridslam.inference.management.poses.pose_recovery import recover_pose
from gridslam.inference.management.readout import surface_estimate
from gridslam.inference.management.step_info import StepInfo, conclude
from gridslam.inference.messages.birth_proposals import propose_births
from gridslam.inference.messages.births import add_births
from gridslam.inference.messages.clutter import learn_clutter
from gridslam.inference.messages.detections import mark_detections
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.network.clock_setting import doubt_clocks, loosened, set_clocks
from gridslam.inference.messages.network.motion import predict_all
from gridslam.inference.messages.prediction import predict_paths
from gridslam.inference.messages.ray_amplitudes import (
    predict_amplitudes,
    start_amplitudes,
    update_amplitudes,
)
from gridslam.inference.messages.updates import Exchange, update_surfaces_and_agent
from gridslam.inference.state.anchor_measurements import AnchorScan, split_by_anchor, whole_scan
from gridslam.inference.state.belief import lines_covariance
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.maps.map import Map
from gridslam.systems.filter_front import FilterFront
from gridslam.systems.front import bare_map, inherit_surfaces
from gridslam.systems.soundness import require_sound_networks
from gridslam.world.filter_model import FilterModel
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan
from gridslam.world.network_scene import network_model, require_agents
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene
from gridslam.world.start import Start

Works = tuple[Workspace, ...]
Turn = Callable[[State, Scan, NetworkState, float | None, FilterModel, Workspace], tuple[State, StepInfo]]
"""What one agent's scan says: its view of all, what was heard, what all believe, when the step before was."""


@dataclass(frozen=True, eq=False)
class NetworkInfo:
    """What happened at a step.

    Attributes
    ----------
    agents : tuple of StepInfo or None
        Of every agent; None for one that isn't there.
    """

    agents: tuple[StepInfo | None, ...]


def start(model: NetworkModel, prior: Map | None = None) -> NetworkState:
    """The state before the first step: priors of agents and clocks, surfaces of an earlier agent's map."""
    state = NetworkState.start(model)
    return state if prior is None else inherit_surfaces(state, prior)


def step(
    state: NetworkState, scan: NetworkScan, model: NetworkModel, work: Works
) -> tuple[NetworkState, NetworkInfo]:
    """One step: clocks by what all agents heard, then every agent's turn after those before it."""
    for own in work:
        own.begin()
    earlier_s = state.time_s
    state = predict_all(state, scan.time_s, scan.scans, model)  # (M104)
    state = recover_agents(state, scan.scans, earlier_s, model, work)
    state = set_clocks(state, scans_of_teachers(state, scan), model, works=work)  # (M103)
    state, infos = take_turns(state, scan, earlier_s, model, work, turn)
    state, told = merge_and_prune_shared(state, model, infos)
    return replace(state, step=state.step + 1), NetworkInfo(told)


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
    """
    infos = list[StepInfo | None]()
    for agent, heard in enumerate(scan.scans):
        info = None
        if heard is not None:
            part, info = turn(state.part(agent), heard, state, earlier_s, model.agents[agent], work[agent])
            if state.recorded(agent, part.monitor).teaches[agent]:
                state = doubt_clocks(loosened(state.having(agent, part)), info.exchanges, model)  # (M102)
            else:
                state, info = state.apart(agent, part), info.doubted(ASTRAY)
        infos.append(info)
    return state, infos


def turn(
    state: State,
    scan: Scan,
    network: NetworkState,
    earlier_s: float | None,
    model: FilterModel,
    work: Workspace,
) -> tuple[State, StepInfo]:
    """One agent's messages about its view: those of adaptive SLAM, over the paths of all anchors at once."""
    exchanges, reckoned = list[Exchange](), state.calibration
    model = work.calibrated(model, reckoned.turned)
    senders = np.flatnonzero(~network.clocks.unset).astype(np.int32)
    state, scans = by_anchor(state, scan, network, earlier_s, model, work)
    for heard in scans:
        radio = state.calibration.tuned(model.radio, heard.anchor)
        paths = predict_paths(state, heard.anchor, model, work=work)
        amplitudes = predict_amplitudes(state, paths, model.radio, work=work)
        cloud, ratios = evaluate(heard, paths, np.ones(len(paths)), amplitudes, radio, model, work=work)
        state, ratios, radio = learn_clutter(state, heard.anchor, ratios, radio, model)
        births, ratios = propose_births(state, heard, cloud, ratios, radio, model, senders, work=work)
        state, exchange = update_surfaces_and_agent(
            state, heard, paths, ratios, reckoned.turned, model, work=work
        )
        state = update_amplitudes(state, paths, amplitudes, heard, exchange, model.radio, work=work)
        state = mark_detections(state, paths.rays, exchange.responsible.sum(1), model, work=work)
        state, exchange, born = add_births(state, births, heard, exchange, radio, model, work=work)
        state = start_amplitudes(state, born, heard, model.radio)
        exchanges.append(exchange)
    return conclude(state, exchanges, reckoned, model, work)


def by_anchor(
    state: State, scan: Scan, network: NetworkState, earlier_s: float | None, model: FilterModel,
    work: Workspace,
) -> tuple[State, list[AnchorScan]]:  # fmt: skip
    """A scan by anchors where it says whose it is, else whole; with all known, a lost agent is found."""
    if not network.labelled:
        return state, [work.once(whole_scan, scan, model)]
    scans = split_by_anchor(scan, model)
    if not state.belief.clocks:
        state = recover_pose(state, scans, earlier_s, model, work=work)
    return state, scans


class NetworkSlam(FilterFront[NetworkScan, Population[NetworkState]]):
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
    advance = staticmethod(step)
    keeps_grid = False
    model: NetworkModel

    @staticmethod
    def require_sound(believed: Any, model: Any, where: str) -> None:
        """Refuse hypotheses whose numbers can't be."""
        require_sound_networks(believed, where)

    def __init__(
        self,
        scene: Scene,
        prior_map: Map | None = None,
        agent: str | None = None,
        seed: int = 0,
        same_frame: bool = False,
        agents: Sequence[str] | None = None,
    ) -> None:
        self._names = list(agents) if agents is not None else agent.split(",") if agent else None
        if self._names is not None:
            require_agents(scene, self._names)
        super().__init__(scene, prior_map, None if self._names is None else self._names[0], seed, same_frame)

    def _model(self, model: FilterModel) -> NetworkModel:
        return network_model(self.scene, self._names or [model.agent])

    @property
    def state(self) -> Any:
        """What is believed after the latest step; of several hypotheses, the likeliest."""
        return self.now.believed.best

    def _begun(self, state: Any) -> Any:
        return Population.of(state)

    def _advanced(self, scan: NetworkScan) -> tuple[Any, Any]:
        return advance(self.now.believed, scan, self.model, self.work, self.advance)

    def _workspace(self) -> Works:
        first = Workspace(self.model.agents[0], self.seed, self.keeps_grid)
        cells = first.require_cells() if self.keeps_grid else None
        return first, *(Workspace(model, self.seed, cells=cells) for model in self.model.agents[1:])

    def _checked(self, scan: Any, after: float | None) -> Any:
        self._single = isinstance(scan, Scan)
        pseudo = self.scene.clocks is not None
        if self._single:  # a row that doesn't say whose it is takes a NetworkScan
            scan = scan.checked(len(self.model.anchors), after, pseudo=pseudo)
            scan = NetworkScan(scan.step, scan.time_s, (scan,))
        if not isinstance(scan, NetworkScan):
            raise InputError(
                "NetworkSlam.step", type(scan).__name__, "a NetworkScan, or the Scan of one agent"
            )
        return scan.checked(len(self.model.anchors), after, len(self.model.agents), pseudo)

    @staticmethod
    def moved(state: NetworkState, position_m: Array, heading_rad: float) -> NetworkState:
        """The state before the first step, with the first agent's prior about another start (m, rad)."""
        return started_at(state, 0, position_m, heading_rad)

    @staticmethod
    def started_at(state: Any, agent: int, position_m: Array, heading_rad: float) -> Any:
        """The state before the first step, with an agent's prior about another start (m, rad)."""
        return started_at(state, agent, position_m, heading_rad)

    def start_all(self, starts: Mapping[str, Start]) -> None:
        """Believe in other starts than the scene's.

        Raises
        ------
        InputError
            A step was taken already.
        """
        state = self.state
        if state.time_s is not None:
            raise InputError("start", f"told after {state.step} steps", "before the first")
        for name, told in starts.items():
            number = self.model.names.index(name)
            state = self.started_at(state, number, told.position_m, told.heading_rad)
        self.now = self.now._replace(believed=self._begun(state))

    def estimate(
        self, believed: Population[NetworkState], scan: NetworkScan, info: NetworkInfo, began: float
    ) -> Any:
        """Estimates of agents, surfaces and clocks."""
        whole = network_estimate(believed, scan, info.agents, self.model, began, works=self.work)
        return whole.agents[self.agent] if self._single else whole

    def map(self) -> Map:
        """The map as it stands: detected surfaces, and a grid of which nothing was observed."""
        state = self.state
        table = surface_estimate(state.part(0), work=self.work[0])
        found = (table.existence > self.model.settings.detect_above) & (state.surfaces.seen >= CONFIRMED)
        joint = lines_covariance(state.belief, found)
        return bare_map(self, table.take(found), state.surfaces.reflection[found], joint)


def started_at(state: NetworkState, agent: int, position_m: Array, heading_rad: float) -> NetworkState:
    """The state before the first step, with an agent's prior about another start (m, rad)."""
    mean = state.belief.mean.copy()
    mean[state.belief.layout.pose(agent).start + np.array([0, 1, 4])] = [*position_m, heading_rad]
    return replace(state, belief=replace(state.belief, mean=mean))
