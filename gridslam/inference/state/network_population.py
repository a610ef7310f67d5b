"""Hypotheses about a network: whole states, each with a weight. Mostly there is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.state.network_state import NetworkState

COUNTS = 0.01
"""Weight from which on a hypothesis leaves a clock in doubt."""
ALIKE_M = 1.0
"""Offsets of a clock nearer than this are one mode, and so are places of an agent."""


@dataclass(frozen=True, eq=False)
class NetworkPopulation:
    """Hypotheses about all that a network believes. A value, as each state is.

    Attributes
    ----------
    states : tuple of NetworkState
        The likeliest first.
    log_weight : tuple of float
        Their exponentials sum to 1.
    """

    states: tuple[NetworkState, ...]
    log_weight: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        if not 0 < len(self.states) == len(self.log_weight):
            raise ValueError(f"{len(self.states)} states with {len(self.log_weight)} weights")

    def __len__(self) -> int:
        return len(self.states)

    @classmethod
    def weighed(cls, states: Sequence[NetworkState], log_weight: Array) -> Self:
        """Of states with any weights, the likeliest first."""
        log = log_weight - np.logaddexp.reduce(log_weight)
        order = np.argsort(-log, kind="stable").tolist()
        return cls(tuple(states[k] for k in order), tuple(float(log[k]) for k in order))

    @property
    def best(self) -> NetworkState:
        """The likeliest hypothesis."""
        return self.states[0]

    @property
    def offsets(self) -> Array:
        """Means of the anchors' clocks in every hypothesis, (K, J) m; (K, 0) if they are known."""
        clocks = self.best.belief.layout.devices[: self.best.belief.clocks]
        return np.array([state.belief.mean[clocks] for state in self.states])

    @property
    def places(self) -> Array:
        """Where the agents are in every hypothesis, (K, I, 2) m."""
        layout = self.best.belief.layout
        first = np.array([layout.pose(agent).start for agent in range(layout.agents)])
        rows = first[:, None] + np.arange(2)
        return np.array([state.belief.mean[rows] for state in self.states])

    @property
    def unset(self) -> NDArray[np.bool_]:
        """Anchors (J,) whose clocks the likeliest searches for, or another that counts has set elsewhere."""
        offset = self.offsets[np.array(self.log_weight) >= np.log(COUNTS)]
        searched = self.best.clocks.unset
        if len(offset) < 2 or not offset.shape[1]:
            return searched.copy()
        return np.asarray(searched | (np.abs(offset - offset[0]) > ALIKE_M).any(0))
