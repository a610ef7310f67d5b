"""Several hypotheses: whole states, each with a weight. Mostly there is one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.state.layout import AGENT
from gridslam.inference.state.range_watch import RangeWatch
from gridslam.inference.state.state import State
from gridslam.world.geometry import wrap

NONE = -1


@dataclass(frozen=True)
class Watch:
    """What is kept to tell whether all hypotheses are wrong.

    Attributes
    ----------
    lead, loud : float
        Log evidence above that of the best pose without any map, and loud measurements, with forgetting.
    doubtful : int
        Steps for which another search by one scan alone is worth while.
    elsewhere : float
        By how much a scan and no map favour another pose than the believed one, nats beyond what one
        measurement can say, with forgetting.
    """

    lead: float = 0.0
    loud: float = 0.0
    doubtful: int = 0
    elsewhere: float = 0.0


@dataclass(frozen=True, eq=False)
class Population:
    """Hypotheses about all that a filter believes. A value, as each state is.

    Attributes
    ----------
    states : tuple of State
        The likeliest first.
    log_weight : tuple of float
        Their exponentials sum to 1.
    searching : bool
        Whether the start isn't found yet: the one state is the prior, moved on.
    waited : int
        Scans heard while searching.
    guard : int
        Which of the states is the unsplit parent that isn't pruned; `NONE` if there is none.
    since : int
        Steps since the latest branching.
    watch : Watch
    ranges : RangeWatch or None
        What lines of sight that cross say of the distances; None before the first step.
    """

    states: tuple[State, ...]
    log_weight: tuple[float, ...] = (0.0,)
    searching: bool = False
    waited: int = 0
    guard: int = NONE
    since: int = 1_000_000
    watch: Watch = field(default_factory=Watch)
    ranges: RangeWatch | None = None

    def __len__(self) -> int:
        return len(self.states)

    @classmethod
    def of(cls, state: State, searching: bool = False) -> Self:
        """One hypothesis."""
        return cls((state,), searching=searching)

    @property
    def best(self) -> State:
        """The likeliest hypothesis."""
        return self.states[0]

    @property
    def weights(self) -> Array:
        """Probability of every hypothesis, (K,)."""
        return np.exp(self.log_weight)

    @property
    def poses(self) -> Array:
        """Means of the agent's pose, (K, 3) m, m, rad."""
        return np.array([state.belief.mean[[0, 1, 4]] for state in self.states])

    def weighed(self, log_weight: Array) -> Self:
        """The same with other weights, which are normalised, the likeliest first."""
        if len(self) == 1:
            return self
        total = np.logaddexp.reduce(log_weight)
        order = np.argsort(-log_weight, kind="stable").tolist()
        guard = NONE if self.guard == NONE else order.index(self.guard)
        return replace(
            self,
            states=tuple(self.states[k] for k in order),
            log_weight=tuple(float(log_weight[k] - total) for k in order),
            guard=guard,
        )

    def take(self, rows: list[int]) -> Self:
        """Some of the hypotheses, in their order; weights are normalised."""
        guard = rows.index(self.guard) if self.guard in rows else NONE
        kept = replace(
            self,
            states=tuple(self.states[k] for k in rows),
            log_weight=tuple(self.log_weight[k] for k in rows) if len(rows) > 1 else (0.0,),
            guard=guard,
        )
        return kept.weighed(np.array(kept.log_weight))

    def agent(self) -> tuple[Array, Array]:
        """Mean (5,) and covariance (5, 5) of the agent in the mixture of all hypotheses."""
        if len(self) == 1:
            belief = self.best.belief
            return belief.mean[:AGENT].copy(), belief.covariance[:AGENT, :AGENT].copy()
        weights, first = self.weights, self.best.belief.mean[4]
        each = np.array([state.belief.mean[:AGENT] for state in self.states])
        each[:, 4] = first + wrap(each[:, 4] - first)
        mean = weights @ each
        gap = each - mean
        own = np.array([state.belief.covariance[:AGENT, :AGENT] for state in self.states])
        return mean, np.einsum("k,kij->ij", weights, own) + (weights[:, None] * gap).T @ gap
