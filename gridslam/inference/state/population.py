"""Several hypotheses: whole states, each with a weight, whatever kind of state it is. Mostly there is one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import LATER, Array
from gridslam.inference.health.doubt import Doubt
from gridslam.inference.health.range_watch import RangeWatch
from gridslam.inference.health.sight_watch import SightWatch
from gridslam.inference.state.past import Past

S = TypeVar("S")
"""The kind of state."""
Same = Callable[[S, S], bool]
"""Whether two states are one world."""
Join = Callable[[S, S, float, float], S]
"""One state in place of two of one world, of their log weights."""
NONE = -1
GUARDED = 10
"""Steps for which the parent of a branching is kept whatever its weight."""


@dataclass(frozen=True, eq=False)
class Population(Generic[S]):
    """K hypotheses about all that a filter believes. A value, as each state is.

    Attributes
    ----------
    states : tuple of S, K
        The likeliest first.
    log_weight : tuple of float, K
        Their exponentials sum to 1.
    searching : bool
        Whether the start isn't found yet: the one state is the prior, moved on.
    waited : int
        Scans heard while searching.
    guard : int
        Which of the states is the unsplit parent that isn't pruned; `NONE` if there is none.
    since : int
        Steps since the latest branching.
    watch : Doubt
        Whether all hypotheses are wrong.
    ranges : RangeWatch or None
        What lines of sight that cross say of the distances; None before the first step.
    sights : SightWatch or None
        What lines of sight say of their anchors, at places that are well known; None before the first look.
    early : float
        Share of the latest steps at which a path arrived before the line of sight.
    past : Past or None
        What was received so far, where it may be looked at again; None where it won't be.

    Raises
    ------
    ValueError
        No states, or not a weight for each.
    """

    states: tuple[S, ...]
    log_weight: tuple[float, ...] = (0.0,)
    searching: bool = field(default=False, metadata=LATER)
    waited: int = field(default=0, metadata=LATER)
    guard: int = field(default=NONE, metadata=LATER)
    since: int = field(default=1_000_000, metadata=LATER)
    watch: Doubt = field(default_factory=Doubt, metadata=LATER)
    ranges: RangeWatch | None = None
    sights: SightWatch | None = field(default=None, metadata=LATER)
    early: float = field(default=0.0, metadata=LATER)
    past: Past[S] | None = field(default=None, metadata=LATER)

    FORMER_NAMES: ClassVar = ("ImagePopulation", "NetworkPopulation")
    """By which files of earlier versions call it."""

    def __post_init__(self) -> None:
        if not 0 < len(self.states) == len(self.log_weight):
            raise ValueError(f"{len(self.states)} states with {len(self.log_weight)} weights")

    def __len__(self) -> int:
        return len(self.states)

    @classmethod
    def of(cls, state: S, searching: bool = False) -> Self:
        """One hypothesis."""
        return cls((state,), searching=searching)

    @property
    def kind(self) -> Any:
        """Its type with that of its states, by which files are read."""
        whole: Any = type(self)
        return whole[type(self.best)]

    @property
    def best(self) -> S:
        """The likeliest hypothesis."""
        return self.states[0]

    @property
    def weights(self) -> Array:
        """Probability of every hypothesis, (K,)."""
        return np.exp(self.log_weight)

    def having(
        self, states: Sequence[S], log_weight: Array | Sequence[float], guard: int = NONE, **changes: Any
    ) -> Self:
        """The population with other states of any log weights, which are normalised, the likeliest first.

        Parameters
        ----------
        guard : int
            Which of these states is not pruned for a while.
        **changes
            Of other fields.
        """
        log = np.asarray(log_weight, dtype=float)
        total = np.logaddexp.reduce(log)
        order = np.argsort(-log, kind="stable").tolist()
        return replace(
            self,
            states=tuple(states[k] for k in order),
            log_weight=tuple(float(log[k] - total) for k in order) if len(order) > 1 else (0.0,),
            guard=NONE if guard == NONE else order.index(guard),
            **changes,
        )

    def take(self, rows: Sequence[int]) -> Self:
        """Some of the hypotheses; weights are normalised."""
        guard = rows.index(self.guard) if self.guard in rows else NONE
        log = [self.log_weight[k] for k in rows]
        return self.having([self.states[k] for k in rows], log, guard)

    def likely(self, hopeless: float, most: int | None = None) -> list[int]:
        """The first rows, whose log weight is less than `hopeless` behind the best; the guard for a while."""
        guarded, best = self._guarded, self.log_weight[0]
        most = len(self) if most is None else most
        return [
            k for k, log in enumerate(self.log_weight)
            if k == guarded or (log > best - hopeless and k < most)
        ]  # fmt: skip

    def pruned(self, hopeless: float, most: int | None = None) -> Self:
        """Without those that aren't `likely`."""
        rows = self.likely(hopeless, most)
        return self if len(rows) == len(self) else self.take(rows)

    def merged(
        self,
        same: Same[S],
        near: NDArray[np.bool_] | None = None,
        join: Join[S] | None = None,
        among: Sequence[int] | None = None,
    ) -> Self:
        """Hypotheses of one world merged into the likeliest of them, weights added; the guard only later.

        Parameters
        ----------
        same : callable
            Whether two states are one world.
        near : (K, K) bool, optional
            Which of them need to be asked for; default: all.
        join : callable, optional
            The state that stands for two; default: the likelier one as it is.
        among : sequence of int, optional
            Rows that are merged, the others dropped; default: all.
        """
        states, logs = list(self.states), list(self.log_weight)
        left, guarded = list(range(len(states)) if among is None else among), self._guarded
        guard, survivors = self.guard, list[int]()
        while left:
            one = left.pop(0)
            for other in list(left):
                if guarded != NONE and guarded in (one, other):
                    continue
                if (near is not None and not near[one, other]) or not same(states[one], states[other]):
                    continue
                if join is not None:
                    states[one] = join(states[one], states[other], logs[one], logs[other])
                logs[one] = float(np.logaddexp(logs[one], logs[other]))
                left.remove(other)
                guard = one if guard == other else guard
            survivors.append(one)
        if among is None and len(survivors) == len(states):
            return self
        return replace(self, states=tuple(states), log_weight=tuple(logs), guard=guard).take(survivors)

    @property
    def _guarded(self) -> int:
        """The row that is neither pruned nor merged as yet."""
        return self.guard if self.since <= GUARDED else NONE


def moments(weights: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) of a mixture of K Gaussians.

    Parameters
    ----------
    weights : (K,)
    means : (K, n)
        Angles unwrapped.
    covariances : (K, n, n)
    """
    mean = weights @ means
    gap = means - mean
    return mean, np.einsum("k,kij->ij", weights, covariances) + (weights[:, None] * gap).T @ gap
