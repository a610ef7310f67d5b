"""Where agents, clocks, heights and lines stand in a joint belief."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

AGENT = 5
"""Entries of an agent's pose: x, y, vx, vy, heading."""
HEADING = 4
POSE = np.array([0, 1, HEADING])
OF_POSE = np.ix_(POSE, POSE)
"""Entries of position and heading in an agent's pose, and of their covariance."""
PER_LINE = 2


@dataclass(frozen=True)
class StateLayout:
    """Layout of a joint state.

    The state is [pose of agent 1, its clock | ... | clocks of anchors | angle, offset of line 1 | ...]: poses
    of 5 entries, x, y (m), vx, vy (m/s), heading (rad); clocks as distances (m). Kernels take a view of one
    agent: no clock of its own, and instead of anchors' clocks their differences to it, if any are unknown.
    Where heights are unknown, rises (m) stand in the clocks' place: docs/model.md, (M261).

    Attributes
    ----------
    agents : int
    clocks : int
        Of anchors, J, or 0 where they are known.
    surfaces : int
    own_clocks : bool
        Whether each agent's clock stands after its pose.
    rises : int
        Of anchors above the agent, or 0 where heights are known.

    Examples
    --------
    >>> network = StateLayout(agents=2, clocks=3, surfaces=1, own_clocks=True)
    >>> network.size, network.pose(1), network.agent_clock(1), network.anchor_clocks, network.line(0).tolist()
    (17, slice(6, 11, None), 11, slice(12, 15, None), [15, 16])
    """

    agents: int = 1
    clocks: int = 0
    surfaces: int = 0
    own_clocks: bool = False
    rises: int = field(default=0, kw_only=True)

    @classmethod
    @lru_cache(64)
    def of_view(cls, size: int, clocks: int = 0, rises: int = 0) -> StateLayout:
        """Layout of a view of one agent by its number of entries.

        Raises
        ------
        ValueError
            There is no such view.
        """
        surfaces, rest = divmod(size - AGENT - clocks - rises, PER_LINE)
        if surfaces < 0 or rest:
            raise ValueError(f"no state of {size} entries with {clocks} clocks, {rises} rises")
        return cls(1, clocks, surfaces, rises=rises)

    @property
    def per_agent(self) -> int:
        """Entries of an agent."""
        return AGENT + self.own_clocks

    @cached_property
    def head(self) -> int:
        """First entry of the lines."""
        return self.agents * self.per_agent + self.unknowns

    @property
    def unknowns(self) -> int:
        """Entries between agents and lines: clocks, or rises."""
        return self.clocks + self.rises

    @property
    def size(self) -> int:
        """Number of entries N."""
        return self.head + PER_LINE * self.surfaces

    def pose(self, agent: int = 0) -> slice:
        """Position, velocity and heading of an agent."""
        return slice(agent * self.per_agent, agent * self.per_agent + AGENT)

    def agent_clock(self, agent: int) -> int:
        """An agent's clock.

        Raises
        ------
        ValueError
            Agents' clocks are no part of this state.
        """
        if not self.own_clocks:
            raise ValueError("this state has no clocks of agents")
        return agent * self.per_agent + AGENT

    @property
    def anchor_clocks(self) -> slice:
        """Clocks of the anchors; in a view, their differences to the agent's."""
        return slice(self.agents * self.per_agent, self.agents * self.per_agent + self.clocks)

    @property
    def heights(self) -> slice:
        """Rises of the anchors above the agent."""
        return slice(self.head - self.rises, self.head)

    @property
    def lines(self) -> slice:
        """Angle and offset of line after line."""
        return slice(self.head, self.size)

    @property
    def angles(self) -> slice:
        """Angles of the lines."""
        return slice(self.head, self.size, PER_LINE)

    @property
    def offsets(self) -> slice:
        """Offsets of the lines."""
        return slice(self.head + 1, self.size, PER_LINE)

    def line(self, surfaces: ArrayLike) -> NDArray[np.intp]:
        """Angle and offset of the lines of `surfaces` (...,), shape ``(..., 2)``."""
        return self.head + PER_LINE * np.asarray(surfaces)[..., None] + np.arange(PER_LINE)

    @property
    def owner(self) -> NDArray[np.intp]:
        """What each entry belongs to, (N,): 0 for agents, clocks, rises, then 1 and on for surfaces."""
        lines = 1 + np.repeat(np.arange(self.surfaces), PER_LINE)
        return np.concatenate([np.zeros(self.head, np.intp), lines])
