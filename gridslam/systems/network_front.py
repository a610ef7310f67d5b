"""The front doors of systems that hear several agents at once: scans of all in, estimates of all out."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.errors import InputError
from gridslam.inference.beliefs.belief import lines_covariance
from gridslam.inference.management.free_turn import put_back, turn_of_all
from gridslam.inference.management.network.clock_rivals import advance_population
from gridslam.inference.management.network.readout import CONFIRMED, network_estimate
from gridslam.inference.management.readout import surface_estimate
from gridslam.inference.management.step_info import NetworkInfo
from gridslam.inference.scans.unsure_orientations import all_as_sure_as_anchors
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.population import Population
from gridslam.inference.workspace.workspace import Workspace
from gridslam.maps.map import Map
from gridslam.systems.far_regions import moved_estimate, moved_map
from gridslam.systems.filter_front import FilterFront
from gridslam.systems.front import bare_map
from gridslam.systems.network_soundness import require_sound_networks
from gridslam.world.filter_model import FilterModel, detected
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan
from gridslam.world.network_scene import network_model, require_agents
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene
from gridslam.world.start import Start, require_scene

Believed = TypeVar("Believed")


class NetworkFront(FilterFront[NetworkScan, Believed]):
    """The front of systems of several agents, whatever their state; a system adds `started_at`.

    Arguments are those of `gridslam.NetworkSlam`; `start` and `advance` get a `NetworkModel`.
    """

    model: NetworkModel

    def __init__(
        self,
        scene: Scene,
        prior_map: Map | None = None,
        agent: str | None = None,
        seed: int = 0,
        same_frame: bool = False,
        agents: Sequence[str] | None = None,
    ) -> None:
        require_scene(scene)
        self._names = list(agents) if agents is not None else agent.split(",") if agent else None
        if self._names is not None:
            require_agents(scene, self._names)
        super().__init__(scene, prior_map, None if self._names is None else self._names[0], seed, same_frame)

    def _model(self, model: FilterModel) -> NetworkModel:
        network = network_model(self.scene, self._names or [model.agent])
        return replace(network, agents=tuple(map(self._prepared, network.agents)))

    def _checked(self, scan: Any, after: float | None) -> Any:
        self._single = isinstance(scan, Scan)
        pseudo = self.scene.clocks is not None
        if self._single:  # a row that doesn't say whose it is takes a NetworkScan
            scan = scan.checked(len(self.model.anchors), after, pseudo=pseudo)
            scan = NetworkScan(scan.step, scan.time_s, (scan,))
        if not isinstance(scan, NetworkScan):
            found = type(scan).__name__
            raise InputError(f"{type(self).__name__}.step", found, "a NetworkScan, or the Scan of one agent")
        return scan.checked(len(self.model.anchors), after, len(self.model.agents), pseudo)

    @staticmethod
    @abstractmethod
    def started_at(state: Any, agent: int, position_m: Array, heading_rad: float) -> Any:
        """The state before the first step, with an agent's prior about another start (m, rad)."""

    @classmethod
    def moved(cls, state: Any, position_m: Array, heading_rad: float) -> Any:
        """The state before the first step, with the first agent's prior about another start (m, rad)."""
        return cls.started_at(state, 0, position_m, heading_rad)

    def start_all(self, starts: Mapping[str, Start]) -> None:
        """Believe in other starts than the scene's.

        Parameters
        ----------
        starts : dict of agent to Start
            Of whoever isn't in it the scene's stays.

        Raises
        ------
        InputError
            A step was taken already.
        """
        state = self.state
        if state.time_s is not None:
            raise InputError("start", f"told after {state.step} steps", "before the first")
        for name, start in starts.items():
            number = self.model.names.index(name)
            state = self.started_at(state, number, start.position_m - self.model.origin_m, start.heading_rad)
        self.now = self.now._replace(believed=self._begun(state))


class NetworkFilter(NetworkFront[Population[NetworkState]]):
    """The front of systems whose state is `NetworkState`; a system adds its `start` and `advance`."""

    centres = True
    keeps_grid = False
    """Whether it maps cells."""

    @staticmethod
    def require_sound(believed: Any, model: Any, where: str) -> None:
        """Refuse hypotheses whose numbers can't be."""
        require_sound_networks(believed, model, where)

    @property
    def state(self) -> NetworkState:
        """What is believed after the latest step; of several hypotheses, the likeliest."""
        state: NetworkState = self.now.believed.best
        return state

    def _begun(self, state: NetworkState) -> Population[NetworkState]:
        return Population.of(state)

    def _advanced(self, scan: NetworkScan) -> tuple[Population[NetworkState], NetworkInfo]:
        scan = all_as_sure_as_anchors(scan, self.model)  # (M568)
        believed = turn_of_all(self.now.believed, scan, self.model)
        return advance_population(believed, scan, self.model, self.work, self.advance)

    def _workspace(self) -> tuple[Workspace, ...]:
        first = Workspace(self.model.agents[0], self.seed, self.keeps_grid)
        cells = first.require_cells() if self.keeps_grid else None
        return first, *(Workspace(model, self.seed, cells=cells) for model in self.model.agents[1:])

    @staticmethod
    def started_at(state: NetworkState, agent: int, position_m: Array, heading_rad: float) -> NetworkState:
        """The state before the first step, with an agent's prior about another start (m, rad)."""
        mean = state.belief.mean.copy()
        mean[state.belief.layout.pose(agent).start + np.array([0, 1, 4])] = [*position_m, heading_rad]
        return replace(state, belief=replace(state.belief, mean=mean))

    def estimate(
        self, believed: Population[NetworkState], scan: NetworkScan, info: NetworkInfo, began: float
    ) -> Any:
        """Estimates of agents, surfaces and clocks."""
        near = network_estimate(believed, scan, info.agents, self.model, began, works=self.work)
        agents = {name: own and moved_estimate(own, self.model.origin_m) for name, own in near.agents.items()}
        whole = replace(near, agents=agents)
        return whole.agents[self.agent] if self._single else whole

    def map(self) -> Map:
        """The map as it stands: detected surfaces, and a grid of which nothing was observed."""
        state = put_back(self.state, self.model.agents[0])
        table = surface_estimate(state.part(0), work=self.work[0])
        found = detected(table.existence, self.model.settings) & (state.surfaces.seen >= CONFIRMED)
        joint = lines_covariance(state.belief, found)
        near = bare_map(self, table.take(found), state.surfaces.reflection[found], joint)
        return moved_map(near, self.model.origin_m)
