"""One correlated Gaussian over agents, clocks and the surfaces that all share; docs/model.md, (M102).

Whatever an agent hears depends on a linear view of it: its own pose, the differences between the anchors'
clocks and its own, and the lines. So a step about one agent works on its view, and what it learned there is
taken over: the rest of the state, given the view, is as before.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief, carry, move_agent, solved
from gridslam.inference.beliefs.layout import AGENT, HEADING, PER_LINE, StateLayout
from gridslam.world.clocks import ClockModel
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import wrap


@dataclass(frozen=True)
class NetworkLayout(StateLayout):
    """Layout of a joint state of several agents, with rates of clocks between the clocks and the lines.

    Attributes
    ----------
    rates : int
        Of the anchors' clocks, then of the agents' (m/s): J + I, or 0 for clocks without rates.
    """

    rates: int = 0

    @property
    def head(self) -> int:
        """First entry of the lines."""
        return self.agents * self.per_agent + self.clocks + self.rates

    @property
    def anchor_clocks(self) -> slice:
        """Clocks of the anchors."""
        first = self.agents * self.per_agent
        return slice(first, first + self.clocks)

    @cached_property
    def devices(self) -> NDArray[np.intp]:
        """Clocks of all devices, (J + I,): of the anchors, then of the agents; none if they are known."""
        if not self.clocks:
            return np.zeros(0, np.intp)
        anchors = np.arange(self.clocks) + self.anchor_clocks.start
        return np.concatenate([anchors, np.arange(self.agents) * self.per_agent + AGENT])

    @property
    def clock_rates(self) -> slice:
        """Rates of all devices' clocks."""
        return slice(self.head - self.rates, self.head)


@dataclass(frozen=True)
class NetworkBelief(Belief):
    """Gaussian belief about several agents, clocks, and surfaces.

    Attributes
    ----------
    mean : (N,), covariance : (N, N) float64
        Ordered as `NetworkLayout` says.
    clocks : int
        J, or 0 if all clocks are known.
    agents, rates : int
    """

    agents: int = 1
    rates: int = 0

    @classmethod
    def start(cls, models: tuple[FilterModel, ...], clocks: ClockModel) -> NetworkBelief:
        """The priors of all agents and clocks, and no surfaces."""
        agents, unknown = len(models), not clocks.known.all()
        rates = clocks.anchors + agents if clocks.drifting and unknown else 0
        layout = NetworkLayout(agents, clocks.anchors if unknown else 0, 0, unknown, rates)
        mean, variance = np.zeros(layout.size), np.zeros(layout.size)
        for number, model in enumerate(models):
            mean[layout.pose(number)], variance[layout.pose(number)] = model.start_mean, model.start_variance
        if unknown:
            variance[layout.devices] = clocks.variance
        if rates:
            variance[layout.clock_rates] = np.where(clocks.known, 0.0, clocks.drift_m**2)
        return cls(mean, np.diag(variance), layout.clocks, agents, rates)

    @cached_property
    def layout(self) -> NetworkLayout:
        """Where things stand in it."""
        bare = NetworkLayout(self.agents, self.clocks, 0, self.clocks > 0, self.rates)
        surfaces, rest = divmod(len(self.mean) - bare.size, PER_LINE)
        if surfaces < 0 or rest:
            raise ValueError(f"no state of {len(self.mean)} entries with {self.agents} agents")
        return replace(bare, surfaces=surfaces)

    @property
    def alone(self) -> bool:
        """Whether the only agent's view is all that there is."""
        return self.agents == 1 and not self.clocks

    def projection(self, agent: int) -> Array:
        """T of an agent's view, ``view = T state``, (5 + J + 2 S, N)."""
        return _places(self.layout, agent).rows

    def view(self, agent: int, loose: Loose | None = None) -> Belief:
        """What an agent's measurements depend on: its pose, differences of clocks, and lines.

        Parameters
        ----------
        loose : Loose, optional
            Differences of clocks that stand in it as told, independent of all else.
        """
        if loose is not None:
            return loose.in_view(self.view(agent))
        if self.alone:
            return Belief(self.mean, self.covariance)
        if agent not in self._views:
            rows = self.projection(agent)
            covariance = rows @ self.covariance @ rows.T
            self._views[agent] = Belief(rows @ self.mean, 0.5 * (covariance + covariance.T), self.clocks)
        return self._views[agent]

    @cached_property
    def _views(self) -> dict[int, Belief]:
        """Views that were asked for."""
        return {}

    def updated(self, agent: int, view: Belief, loose: Loose | None = None) -> NetworkBelief:
        """The joint belief after an agent's view has become `view`, exactly.

        The view may have been updated in any way, and have new lines at its end. With
        ``G = cov(state, view) cov(view)^-1``, the mean moves by G times what the view's moved by, and the
        covariance by ``G (change of the view's) G^T``. What stands in the view itself is taken over; of
        differences of clocks that were `loose` in it, nothing is.
        """
        if self.alone:
            return replace(self, mean=view.mean, covariance=view.covariance)
        layout, (rows, _, _, rest) = self.layout, _places(self.layout, agent)
        before, count, own = self.view(agent, loose), len(rows), self.covariance
        new = len(view.mean) - count
        if new < 0 or new % PER_LINE or view.clocks != self.clocks:
            raise ValueError("this view isn't one of this belief")
        if loose is None:
            gain = solved(before.covariance, rows @ own[:, rest]).T
        else:
            keep, gain = loose.others(count), np.zeros((len(rest), count))
            inner = before.covariance[np.ix_(keep, keep)]
            gain[:, keep] = solved(inner, (rows @ own[:, rest])[keep]).T
        shift = view.mean[:count] - before.mean
        shift[HEADING] = wrap(shift[HEADING])
        source, order = _taken_over(layout, agent, new)
        change = view.covariance[:count, :count] - before.covariance
        taken = len(source)  # first what is taken over, then the rest; last of all in order
        mean, covariance = np.empty(len(order)), np.empty((len(order), len(order)))
        mean[:taken], mean[taken:] = view.mean[source], self.mean[rest] + gain @ shift
        covariance[:taken, :taken] = view.covariance[source[:, None], source]
        cross = gain @ view.covariance[:count][:, source]
        covariance[taken:, :taken], covariance[:taken, taken:] = cross, cross.T
        covariance[taken:, taken:] = own[rest[:, None], rest] + gain @ change @ gain.T
        covariance = covariance[order[:, None], order]
        return replace(self, mean=mean[order], covariance=0.5 * (covariance + covariance.T))

    def apart(self, agent: int, view: Belief) -> NetworkBelief:
        """The joint belief with an agent's pose as its view has it, independent of all else, which stays."""
        own, mean, covariance = self.layout.pose(agent), self.mean.copy(), self.covariance.copy()
        covariance[own], covariance[:, own] = 0.0, 0.0
        mean[own], covariance[own, own] = view.mean[:AGENT], view.covariance[:AGENT, :AGENT]
        return replace(self, mean=mean, covariance=covariance)

    def independent(self, entry: int, mean: float, variance: float) -> NetworkBelief:
        """The belief with one entry's replaced, independent of all others."""
        moved, covariance = self.mean.copy(), self.covariance.copy()
        moved[entry] = mean
        covariance[entry], covariance[:, entry] = 0.0, 0.0
        covariance[entry, entry] = variance
        return replace(self, mean=moved, covariance=covariance)

    def measured(self, plus: int, minus: int | None, offset: float, variance: float) -> NetworkBelief:
        """The belief once the difference of two entries (or one alone) was measured, by Kalman's formulas."""
        column = self.covariance[plus] - (0.0 if minus is None else self.covariance[minus])
        ahead = self.mean[plus] - (0.0 if minus is None else self.mean[minus])
        size = column[plus] - (0.0 if minus is None else column[minus]) + variance
        moved = self.mean + column * ((offset - ahead) / size)
        covariance = self.covariance - np.outer(column, column / size)
        return replace(self, mean=moved, covariance=0.5 * (covariance + covariance.T))

    def together(self, entries: list[int], offset: float, variance: float) -> NetworkBelief:
        """With some entries moved by the same offset, known with a variance."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[entries] += offset
        covariance[np.ix_(entries, entries)] += variance
        return replace(self, mean=mean, covariance=covariance)

    def alike(self, entry: int, other: int) -> NetworkBelief:
        """The belief with one entry as another, in all that is believed of it."""
        moved, covariance = self.mean.copy(), self.covariance.copy()
        moved[entry] = moved[other]
        covariance[entry] = covariance[other]
        covariance[:, entry] = covariance[:, other]
        return replace(self, mean=moved, covariance=covariance)

    def clock_offsets(self) -> tuple[Array, Array]:
        """Means (J + I,), m, and covariance of all clocks: the anchors', then the agents'."""
        own = self.layout.devices
        return self.mean[own], self.covariance[np.ix_(own, own)]


class Loose(NamedTuple):
    """Differences of clocks in an agent's view that tell nothing of anything else.

    Attributes
    ----------
    rows : (K,) int
        Of the view.
    mean, variance : (K,) m, m^2
    """

    rows: NDArray[np.intp]
    mean: Array
    variance: Array

    def in_view(self, view: Belief) -> Belief:
        """The view with these as they are told, independent of all else."""
        mean, covariance = view.mean.copy(), view.covariance.copy()
        covariance[self.rows], covariance[:, self.rows] = 0.0, 0.0
        mean[self.rows], covariance[self.rows, self.rows] = self.mean, self.variance
        return replace(view, mean=mean, covariance=covariance)

    def others(self, count: int) -> NDArray[np.intp]:
        """The other rows of a view of so many."""
        return np.setdiff1d(np.arange(count), self.rows)


class _Places(NamedTuple):
    """Where an agent's view stands in the state.

    Attributes
    ----------
    rows : (V, N)
        T.
    inside, where : (W,) int
        Entries of the state that stand in the view as they are, and where.
    rest : (R,) int
        The others.
    """

    rows: Array
    inside: NDArray[np.intp]
    where: NDArray[np.intp]
    rest: NDArray[np.intp]


@lru_cache(256)
def _places(layout: NetworkLayout, agent: int) -> _Places:
    """Where an agent's view stands in the state, once for all beliefs of a layout."""
    seen, pose = StateLayout(1, layout.clocks, layout.surfaces), np.arange(AGENT)
    rows = np.zeros((seen.size, layout.size))
    rows[pose, layout.pose(agent).start + pose] = 1.0
    if layout.clocks:
        differences = np.arange(layout.clocks) + AGENT
        rows[differences, layout.devices[: layout.clocks]] = 1.0
        rows[differences, layout.agent_clock(agent)] = -1.0
    lines = np.arange(PER_LINE * layout.surfaces)
    rows[seen.head + lines, layout.head + lines] = 1.0
    inside = np.concatenate([layout.pose(agent).start + pose, layout.head + lines])
    rest = np.setdiff1d(np.arange(layout.size), inside)
    rows.setflags(write=False)
    return _Places(rows, inside, np.concatenate([pose, seen.head + lines]), rest)


@lru_cache(256)
def _taken_over(layout: NetworkLayout, agent: int, new: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Entries of a view with `new` more that stand in the state after it, and where each entry of that state
    is among these and then the rest."""
    rows, inside, where, rest = _places(layout, agent)
    source = np.concatenate([where, np.arange(len(rows), len(rows) + new)])
    order = np.argsort(np.concatenate([inside, np.arange(layout.size, layout.size + new), rest]))
    return source, order


def predict_network(
    belief: NetworkBelief, dt: float, models: tuple[FilterModel, ...], clocks: ClockModel,
    moved: NDArray[np.bool_], shift: float, feet: Array, wider: Array, walk: Array | None = None,
) -> NetworkBelief:  # fmt: skip
    """Agents that are there move with near-constant velocity, headings and clocks walk, lines jitter.

    Clocks with rates move by them: ``F = [[1, dt], [0, 1]]``, ``Q = q_b^2 [[dt, 0], [0, 0]]
    + q_d^2 [[dt^3/3, dt^2/2], [dt^2/2, dt]]``.

    Parameters
    ----------
    moved : (I,) bool
        Which agents are there.
    shift : float, m
        Jitter of a surface along its normal at the point where it is hit.
    feet : (S,) m
        Where along each line it is hit.
    wider : (S, 2)
        How many times as far each surface shifts, and turns.
    walk : (D, D) m^2, optional
        By how much all clocks walk in a second; default: as `clocks` tells, each by itself.
    """
    layout, mean, covariance = belief.layout, belief.mean.copy(), belief.covariance.copy()
    for number in np.flatnonzero(moved).tolist():
        settings, x = models[number].settings, layout.pose(number).start
        move_agent(mean, covariance, x, dt, settings.acceleration_mps2, np.radians(settings.heading_deg))
    own = layout.devices[~clocks.known] if layout.clocks else layout.devices
    if layout.rates:
        rates = (np.arange(layout.rates) + layout.clock_rates.start)[~clocks.known]
        carry(mean, covariance, own, rates, dt)
        power = clocks.drift_walk_m**2
        covariance[own, own] += power * dt**3 / 3
        covariance[rates, rates] += power * dt
        covariance[own, rates] += power * dt**2 / 2
        covariance[rates, own] += power * dt**2 / 2
    if walk is None:
        covariance[own, own] += clocks.walk_m**2 * dt
    elif layout.clocks:
        covariance[np.ix_(layout.devices, layout.devices)] += walk * dt
    angle, offset = np.arange(layout.size)[layout.angles], np.arange(layout.size)[layout.offsets]
    # a turn by w about tangential coordinate t changes the offset by t w
    slid, turn = (shift * wider[:, 0]) ** 2, (shift / 5.0 * wider[:, 1]) ** 2
    lever = turn * feet
    covariance[angle, angle] += turn
    covariance[angle, offset] += lever
    covariance[offset, angle] += lever
    covariance[offset, offset] += lever * feet + slid
    return replace(belief, mean=mean, covariance=covariance)
