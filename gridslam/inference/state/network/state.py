"""The state of a filter of several agents: what a step needs of the steps before, and a checkpoint holds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import LATER, Array, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.calibration import Calibration
from gridslam.inference.beliefs.layout import AGENT
from gridslam.inference.health.monitor import HealthMonitor
from gridslam.inference.state.grid import Grid
from gridslam.inference.state.network.belief import Loose, NetworkBelief
from gridslam.inference.state.network.clock_search import ClockSearch
from gridslam.inference.state.network.clock_walk import ClockWalk
from gridslam.inference.state.presence import FRESH_SIGHT
from gridslam.inference.state.ray_amplitudes import RayAmplitudes
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import FRESH_DOUBLE, FRESH_SINGLE, SurfaceBank
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan


@dataclass(frozen=True, eq=False)
class AgentRecord:
    """What is kept of one agent beside the joint belief, the surfaces and the rays.

    Attributes
    ----------
    calibration : Calibration
        Of the radio, as this agent hears it.
    monitor : HealthMonitor
    amplitudes : RayAmplitudes
        Of the paths to this agent.
    """

    calibration: Calibration
    monitor: HealthMonitor
    amplitudes: RayAmplitudes


@dataclass(frozen=True, eq=False)
class ClockSteps:
    """The steps of a search for clocks, by which they can be taken again.

    Attributes
    ----------
    before : NetworkState
        Before the first of them.
    scans : tuple of NetworkScan
        What was heard at each.
    log_evidence : float
        Of what was heard, as the steps were taken.
    """

    before: NetworkState
    scans: tuple[NetworkScan, ...]
    log_evidence: float


@dataclass(frozen=True, eq=False)
class NetworkState:
    """What is believed of I agents and J anchors after a step. A value, as `State` is.

    Attributes
    ----------
    belief : NetworkBelief
        Of all agents, clocks and lines.
    surfaces : SurfaceBank
        Potential surfaces, with the rays of all links: ``single`` is (I J, S), the first agent's first.
    los : (I J,)
        Existence of the lines of sight.
    records : tuple of AgentRecord
    clocks : ClockSearch
        Clocks of anchors that aren't set yet.
    here : (I,) bool
        Which agents were there at the latest step.
    labelled : bool
        Whether the latest measurements said whose they are.
    step, next_identity : int
        Steps taken; number of the next new surface.
    time_s : float or None
        Of the latest step; None before the first.
    grid : Grid, optional
        Occupancy and coefficients of cells, of all agents (network grid SLAM).
    walks : ClockWalk, optional
        How far clocks seem to walk, once that is learned; see `messages.network.walk`.
    search : ClockSteps, optional
        The steps since clocks were last all set.
    began_s : float, optional
        Time of the first step.
    turn_variance : float, optional
        Of the turn of agents and lines about the only anchor, rad^2, where nothing has told it and `belief`
        is without it: docs/model.md, (M493). None where the belief holds it.
    turn_anchor : int
        About which.
    turning : (I,) bool, optional
        Whose turn it is: the agents that have been there.
    """

    belief: NetworkBelief
    surfaces: SurfaceBank
    los: Array
    records: tuple[AgentRecord, ...]
    clocks: ClockSearch
    here: NDArray[np.bool_]
    labelled: bool = True
    step: int = 0
    next_identity: int = 0
    time_s: float | None = None
    grid: Grid | None = None
    walks: ClockWalk | None = None
    search: ClockSteps | None = None
    began_s: float | None = field(default=None, metadata=LATER)
    turn_variance: float | None = field(default=None, metadata=LATER)
    turn_anchor: int = field(default=0, metadata=LATER)
    turning: NDArray[np.bool_] | None = field(default=None, metadata=LATER)

    @classmethod
    def start(cls, model: NetworkModel) -> Self:
        """Before the first step: the priors of agents and clocks, and no surfaces."""
        anchors, agents = len(model.anchor_names), len(model.agents)
        record = AgentRecord(Calibration.start(anchors), HealthMonitor(), RayAmplitudes())
        return cls(
            NetworkBelief.start(model.agents, model.clocks), SurfaceBank.empty(agents * anchors, anchors),
            np.full(agents * anchors, FRESH_SIGHT), (record,) * agents, ClockSearch.start(model.clocks),
            np.zeros(agents, bool),
        )  # fmt: skip

    def believing(self, belief: NetworkBelief) -> Self:
        """This state with another belief about the same."""
        return replace(self, belief=belief)

    def links(self, agent: int) -> slice:
        """Rows of an agent's rays."""
        anchors = len(self.los) // len(self.records)
        return slice(agent * anchors, (agent + 1) * anchors)

    @property
    def teaches(self) -> NDArray[np.bool_]:
        """Which agents' measurements say something of what all share, (I,) bool: those that aren't astray.

        If all are, it is the map or a clock that is wrong, and all are heard.
        """
        astray = np.array([record.monitor.astray for record in self.records])
        return np.asarray(~astray | astray.all())

    def loose(self, agent: int) -> Loose | None:
        """Differences of clocks that an agent's distances tell nothing of yet, by their histograms.

        None where no agent's clock is wide: then `belief` itself holds open clocks independent of all else.
        """
        clocks = self.clocks
        if not clocks.framed or not clocks.open_to(agent).any():
            return None
        layout, mean = self.belief.layout, self.belief.mean
        ahead = mean[layout.agent_clock(agent)]
        if clocks.frame_of(agent):
            ahead = ahead - mean[layout.agent_clock(clocks.frame_of(agent) - 1)]
        anchors = np.flatnonzero(clocks.open_to(agent))
        first = clocks.rows(clocks.frame_of(agent)).start
        moments = np.array([clocks.moments(first + int(anchor)) for anchor in anchors])
        return Loose(AGENT + anchors, moments[:, 0] - ahead, moments[:, 1])

    def part(self, agent: int) -> State:
        """What one agent's messages work on: its view, the surfaces with its own rays, its record."""
        return self._part(agent, self.belief.view(agent, self.loose(agent)))

    def part_of(self, agent: int) -> State:
        """What `part` says of an agent, with clocks as `belief` has them, whether they are set or not."""
        return self._part(agent, self.belief.view(agent))

    def _part(self, agent: int, view: Belief) -> State:
        own, record = self.links(agent), self.records[agent]
        single, double = self.surfaces.single[own].copy(), self.surfaces.double[own].copy()
        return State(
            view, replace(self.surfaces, single=single, double=double),
            self.los[own].copy(), record.calibration, record.monitor, self.step, self.next_identity,
            self.time_s, self.grid, record.amplitudes,
            turn_variance=self.turn_variance, turn_anchor=self.turn_anchor,
        )  # fmt: skip

    def recorded(self, agent: int, monitor: HealthMonitor) -> Self:
        """The whole with an agent's health as it was found to be."""
        records = list(self.records)
        records[agent] = replace(records[agent], monitor=monitor)
        return replace(self, records=tuple(records))

    def apart(self, agent: int, part: State) -> Self:
        """The whole after the messages of an agent that is lost: its pose and health, nothing shared."""
        return replace(self.recorded(agent, part.monitor), belief=self.belief.apart(agent, part.belief))

    def having(self, agent: int, part: State) -> Self:
        """The whole after an agent's messages, (M102); new surfaces have fresh rays to all others."""
        own, bank, count = self.links(agent), part.surfaces, len(part.surfaces)
        before = len(self.surfaces)
        single = np.full((len(self.los), count), FRESH_SINGLE)
        double = np.full((len(self.los), count, count), FRESH_DOUBLE)
        single[:, :before], double[:, :before, :before] = self.surfaces.single, self.surfaces.double
        single[own], double[own] = bank.single, bank.double
        los, records = self.los.copy(), list(self.records)
        los[own] = part.los
        records[agent] = AgentRecord(part.calibration, part.monitor, part.amplitudes or RayAmplitudes())
        return replace(
            self,
            belief=self.belief.updated(agent, part.belief, self.loose(agent)),
            surfaces=replace(bank, single=single, double=double),
            los=los,
            records=tuple(records),
            next_identity=part.next_identity,
            grid=part.grid,
        )
