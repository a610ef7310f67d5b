"""Rival modes of clocks, kept as hypotheses where one of them isn't sure; docs/model.md, (M106).

Where departures aren't measured, a wall behind an anchor explains all of its paths by a longer bias, and
arrivals hardly tell. Whole worlds do: in the wrong one the line of sight is left over, and no wall explains
what comes before it. Where they are, a mode is in doubt for the first steps alone: poses needn't wait.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.management.network.clock_replay import Step, evidence, stepped
from gridslam.inference.messages.network.clock_setting import tells_no_departure
from gridslam.inference.state.network.clock_search import (
    FIRST_STEPS,
    LOBE_M,
    LOBE_VARIANCE,
    MODE_COUNTS,
    ClockSearch,
)
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.population import Population
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan

Modes = dict[int, list[NDArray[np.bool_]]]
"""Cells (C,) of every mode of an anchor's clock; the last may be all that is left."""
REACH_M, MOST = 1.25, 5
"""Half width of a mode, and modes of one clock at most."""
EARLY_LEAST, EARLY_MOST = 0.2, 2
"""Where departures are measured: share of the mass from which on a mode is a hypothesis, and how many."""
HOPELESS, CAP = 30.0, 48
"""Log weight behind the best at which a hypothesis is pruned; hypotheses at most."""
PARTICLES = 512
"""Drawn for each agent in each of several hypotheses, at most."""
COUNTS, ALIKE_M = 0.01, 1.0
"""Weight from which on a hypothesis leaves a clock in doubt; offsets of a clock nearer than this are one,
and so are places of an agent."""


def advance_population(
    population: Population[NetworkState], scan: NetworkScan, model: NetworkModel, works: Sequence[Workspace],
    step: Step,
) -> tuple[Population[NetworkState], Any]:  # fmt: skip
    """One step of all hypotheses; of one whose clocks have rival modes by then, instead of a branch for each.

    Parameters
    ----------
    step : callable
        The system's, of one state.

    Returns
    -------
    (population, info)
        info: of the likeliest.
    """
    states, logs, infos = list[NetworkState](), list[float](), list[Any]()
    room = CAP - len(population)
    _limit(works, len(population) > 1)
    for before, log in zip(population.states, population.log_weight, strict=True):
        after, info = stepped(before, scan, model, works, step)
        parts = [(before, 0.0)]
        if room > 0:
            modes = rival_modes if tells_no_departure(scan.scans) else early_modes
            parts = branches(before, after, modes(after.clocks), room + 1, model.clocks.walk_m)
        if len(population) == len(parts) == 1:
            return replace(population, states=(after,)), info
        _limit(works, True)
        room -= len(parts) - 1
        for branch, share in parts:
            if len(parts) > 1:
                after, info = stepped(branch, scan, model, works, step)
            states.append(after)
            infos.append(info)
            logs.append(log + share + evidence(after, info, model))
    return reduced(population.having(states, logs)), infos[int(np.argmax(logs))]


def _limit(works: Sequence[Workspace], several: bool) -> None:
    for work in works:
        work.particles.limit = PARTICLES if several else None


def rival_modes(search: ClockSearch) -> Modes:
    """Modes of open clocks that have several, the likeliest first, then what is left if it counts."""
    return _modes(search, search.searched, (REACH_M, MOST, MODE_COUNTS, np.inf))


def early_modes(search: ClockSearch) -> Modes:
    """In the first steps of a search, modes that are likely but not sure, and what is left.

    A line of sight that was missed, or clutter in its place, leaves a clock in doubt for a step or two.
    """
    early = search.unset & (search.since <= FIRST_STEPS) & (not search.framed)
    return _modes(search, early, (LOBE_M, EARLY_MOST, EARLY_LEAST, LOBE_VARIANCE))


def _modes(search: ClockSearch, sought: NDArray[np.bool_], rule: tuple[float, int, float, float]) -> Modes:
    """Modes of some clocks that have several.

    Parameters
    ----------
    rule : tuple
        Half width of a mode (m), how many of one clock at most, the least share of the mass that each has,
        and its largest variance (m^2).
    """
    reach, most, least, widest = rule
    found: Modes = {}
    for anchor in np.flatnonzero(sought & (search.since > 0)).tolist():
        left = search.mass[anchor]
        modes = list[NDArray[np.bool_]]()
        while len(modes) < most and left.max() > 0:
            near = np.abs(search.centre - search.centre[left.argmax()]) <= reach
            share = left[near].sum()
            mean = left[near] @ search.centre[near] / share
            if share < least or left[near] @ (search.centre[near] - mean) ** 2 > widest * share:
                break
            modes.append(near & (left > 0))
            left = np.where(near, 0.0, left)
        if left.sum() >= MODE_COUNTS:  # its line of sight may have been missed as yet
            modes.append(left > 0)
        if len(modes) > 1:
            found[anchor] = modes
    return found


def branches(
    before: NetworkState, after: NetworkState, modes: Modes, most: int, walk_m: float
) -> list[tuple[NetworkState, float]]:
    """The state before a step with each likely combination of modes, and the log of its prior mass.

    Parameters
    ----------
    after : NetworkState
        After the step: its histograms say what is likely.
    most : int
        Combinations at most.
    walk_m : float
        By which clocks walk in a root second.
    """
    mass = after.clocks.mass
    likely = [[np.log(mass[anchor, own].sum()) for own in cells] for anchor, cells in modes.items()]
    ranked = likeliest_choices(likely, most)
    made, earlier = [], before.clocks.log
    whole = np.logaddexp.reduce(earlier, axis=1)
    for sum_of_logs, pick in ranked:
        if sum_of_logs < ranked[0][0] - HOPELESS:
            break
        chosen = {anchor: cells[k] for (anchor, cells), k in zip(modes.items(), pick, strict=True)}
        share = sum(
            float(np.logaddexp.reduce(earlier[anchor, cells]) - whole[anchor])
            for anchor, cells in chosen.items()
        )
        made.append((having_modes(before, chosen, walk_m), share))
    return made


def having_modes(before: NetworkState, chosen: dict[int, NDArray[np.bool_]], walk_m: float) -> NetworkState:
    """The state with open clocks in some cells (C,), now and, but for their walk, as their search began."""
    clocks, search = before.clocks, before.search
    for anchor, cells in chosen.items():
        clocks = clocks.within(anchor, cells)
    if search is not None:
        began, first = search.before, search.before.clocks
        since = search.scans[0].time_s if began.time_s is None else began.time_s
        walked = walk_m**2 * (cast(float, before.time_s) - since)
        for anchor, cells in chosen.items():
            if first.unset[anchor]:
                first = first.within(anchor, cells, walked)
        search = replace(search, before=replace(began, clocks=first))
    return replace(before, clocks=clocks, search=search)


def likeliest_choices(likely: list[list[float]], most: int) -> list[tuple[float, tuple[int, ...]]]:
    """The `most` combinations of one choice each with the largest sums of logs, largest first.

    Choice by choice, since what isn't among the best of some is not among the best of all.
    """
    best = [(0.0, tuple[int, ...]())]
    for own in likely:
        longer = [(log + float(one), (*pick, k)) for log, pick in best for k, one in enumerate(own)]
        best = sorted(longer, key=lambda choice: -choice[0])[:most]
    return best


def reduced(population: Population[NetworkState]) -> Population[NetworkState]:
    """Without hypotheses far behind the best; those that have become the same merge into the likelier one.

    Weights are added. One that still searches for a clock isn't the same as another yet.
    """
    population = population.pruned(HOPELESS)
    offset, place = offsets(population), places(population)
    near = np.asarray((np.abs(offset[:, None] - offset) < ALIKE_M).all(-1))
    near &= (np.abs(place[:, None] - place) < ALIKE_M).all((-1, -2))
    return population.merged(lambda _, other: not other.clocks.searched.any(), near)


def offsets(population: Population[NetworkState]) -> Array:
    """Means of the anchors' clocks in every hypothesis, (K, J) m; (K, 0) if they are known."""
    belief = population.best.belief
    clocks = belief.layout.devices[: belief.clocks]
    return np.array([state.belief.mean[clocks] for state in population.states])


def places(population: Population[NetworkState]) -> Array:
    """Where the agents are in every hypothesis, (K, I, 2) m."""
    layout = population.best.belief.layout
    first = np.array([layout.pose(agent).start for agent in range(layout.agents)])
    rows = first[:, None] + np.arange(2)
    return np.array([state.belief.mean[rows] for state in population.states])


def unset_clocks(population: Population[NetworkState]) -> NDArray[np.bool_]:
    """Anchors (J,) whose clocks the likeliest searches for, or another that counts has set elsewhere."""
    offset = offsets(population)[np.array(population.log_weight) >= np.log(COUNTS)]
    searched = population.best.clocks.unset_anchors
    if len(offset) < 2 or not offset.shape[1]:
        return searched.copy()
    return np.asarray(searched | (np.abs(offset - offset[0]) > ALIKE_M).any(0))
