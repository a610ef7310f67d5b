"""The turn of agent and map about the only anchor, or the only one in sight, which nothing tells without
departures; docs/model.md, (M493), (M494), (M553).

Distances and arrivals stay the same when all turns together. A filter that linearises at estimates that
move takes what they moved by for knowledge of the turn: it drifts, and is sure of it. So the turn is held
out of the belief while nothing tells it, and put back for whoever asks how sure the belief is.
"""

from __future__ import annotations

import math
from dataclasses import replace as changed
from operator import is_
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief, solved
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.beliefs.turn import direction
from gridslam.inference.messages.anchor_frames import with_common_turn
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import unit
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan

Turning = TypeVar("Turning", State, NetworkState)
"""What may turn: about one agent, or about several and their clocks."""
LEFT = 1e-6
"""Variance of the turn that stays in the belief (rad^2), so that it has a root."""
ANY = np.pi**2 / 3
"""That of a turn that may be any."""


def turn_followed(
    population: Population[State], told: bool, model: FilterModel, anchor: int = 0
) -> Population[State]:
    """The population before a scan, with the turn held out of each state, or put back.

    Parameters
    ----------
    told : bool
        Whether the scan tells it: it holds departures, or another anchor's line of sight.
    anchor : int
        About which all may turn, where it isn't held out yet.
    """
    if population.searching or population.best.samples is not None:
        return population
    return _followed(population, told, model, anchor)


def held_at_least(
    population: Population[Turning], variance: float, model: FilterModel
) -> Population[Turning]:
    """A population with the turn about the only anchor held out whatever a scan holds, (M566), (M568).

    Departures tell it no better than with `variance` (rad^2).
    """
    states = list[Turning]()
    for state in population.states:
        held = without_turn(state, model) if state.turn_variance is None else state
        states.append(replace(held, turn_variance=max(variance, held.turn_variance or 0.0)))
    return changed(population, states=tuple(states))


def turn_of_all(
    population: Population[NetworkState], scan: NetworkScan, model: NetworkModel
) -> Population[NetworkState]:
    """The population before a scan of several agents, which turn together about the only anchor there is.

    Those alone that have been there: what is told of the others' starts is of no turn of theirs. When one
    joins, the turn is put back, and that of all held out.
    """
    if len(model.anchor_names) > 1:
        return population
    told = any(own is not None and bool(np.isfinite(own.aod_rad).any()) for own in scan.scans)
    there = np.array([own is not None for own in scan.scans])
    states = list[NetworkState]()
    for state in population.states:
        turning = there if state.turning is None else state.turning | there
        if state.turning is None or (turning != state.turning).any():
            state = replace(put_back(state, model.agents[0]), turn_variance=None, turning=turning)
        states.append(state)
    population, own = changed(population, states=tuple(states)), model.agents[0]
    if told and own.mounting_variance:
        return held_at_least(population, own.mounting_variance, own)
    return _followed(population, told, own, 0)


def _followed(
    population: Population[Turning], told: bool, model: FilterModel, anchor: int
) -> Population[Turning]:
    if told and all(state.turn_variance is None for state in population.states):
        return population
    states = [
        replace(put_back(state, model), turn_variance=None) if told else without_turn(state, model, anchor)
        for state in population.states
    ]
    return changed(population, states=tuple(states))


def without_turn(state: Turning, model: FilterModel, anchor: int = 0) -> Turning:
    """The state with what it believes about the turn about an anchor held out of its belief, (M493), (M555).

    Once walls are mapped they keep it; until then an agent that goes on turns all there is.
    """
    belief, before = state.belief, state.turn_variance
    if before is not None and (len(belief.lines) or anchor != state.turn_anchor):
        return state
    way = direction(belief, model.places[anchor, :2], _turning(state))
    known = float(way @ solved(belief.covariance, way[:, None])[:, 0])
    held = max(1 / known - LEFT, 0.0)
    if before is not None and held <= LEFT:  # nothing has come since
        return state
    return replace(_wider(state, way, -held), turn_variance=held + (before or 0.0), turn_anchor=anchor)


def with_turn(state: Turning, model: FilterModel) -> Turning:
    """The state for who asks how sure it is, (M494), (M553): the turn in its belief, and a ring's depth."""
    if isinstance(state, State):
        state = with_common_turn(state)
    if not state.turn_variance:
        return state
    place = model.places[state.turn_anchor, :2]
    inwards = curvature(state.belief, place, _turning(state))
    return _wider(put_back(state, model), inwards, shortened(state.turn_variance))


def position_spread(state: State, model: FilterModel) -> float:
    """Deviation of the position, m, of the state `with_turn`: all of it that every step asks for."""
    xx, yy = state.belief.covariance.diagonal()[:2].tolist()
    if state.turn_variance:  # across the way to the anchor; and along it
        x, y = (model.places[state.turn_anchor, :2] - state.belief.mean[:2]).tolist()
        turn, depth = state.turn_variance, shortened(state.turn_variance)
        xx, yy = xx + turn * (y * y) + depth * (x * x), yy + turn * (x * x) + depth * (y * y)
    own = state.mountings
    with_all = own.turn_variance * math.dist(own.pivot, state.belief.mean[:2]) ** 2 if own else 0.0
    return math.sqrt(xx + yy + with_all)


def put_back(state: Turning, model: FilterModel) -> Turning:
    """The state to go on from with the turn in its belief, (M494)."""
    if not state.turn_variance:
        return state
    place = model.places[state.turn_anchor, :2]
    return _wider(state, direction(state.belief, place, _turning(state)), state.turn_variance)


def all_with_turn(population: Population[Turning], model: FilterModel) -> Population[Turning]:
    """Hypotheses to go on from, each with the turn in its belief, (M494)."""
    states = tuple(with_turn(state, model) for state in population.states)
    return population if all(map(is_, states, population.states)) else changed(population, states=states)


def off_ring(state: State, model: FilterModel) -> Belief:
    """The belief without what an agent that goes round the anchor about which all turns may have gone.

    Its place on the ring isn't told by that anchor's line of sight either.
    """
    belief = state.belief
    if not state.turn_variance:  # or walls of an earlier map tell it
        return belief
    way = np.zeros(len(belief.mean))
    x, y = belief.mean[:2] - model.places[state.turn_anchor, :2]
    way[0], way[1], way[HEADING] = -y, x, 1.0
    known = float(way @ solved(belief.covariance, way[:, None])[:, 0])
    return replace(belief, covariance=belief.covariance - max(1 / known - LEFT, 0.0) * np.outer(way, way))


def curvature(belief: Belief, place: Array, turning: NDArray[np.bool_] | None = None) -> Array:
    """By how much these changes change, per rad, (N,): all runs on circles about the place."""
    mean, lines, layout = belief.mean, belief.lines, belief.layout
    inwards = np.zeros(len(mean))
    for agent in range(layout.agents) if turning is None else np.flatnonzero(turning).tolist():
        own, at = mean[layout.pose(agent)], layout.pose(agent).start
        inwards[at : at + 2] = place - own[:2]
        inwards[at + 2 : at + 4] = -own[2:4]
    inwards[layout.offsets] = -unit(lines[:, 0]) @ place
    return inwards


def shortened(variance: float) -> float:
    """Mean square of 1 - cos of a turn of this variance: how deep, in radii, its part of a circle is."""
    return 1.0 - 2 * math.exp(-0.5 * variance) + 0.5 * (1 + math.exp(-2 * variance))


def _turning(state: State | NetworkState) -> NDArray[np.bool_] | None:
    return state.turning if isinstance(state, NetworkState) else None


def _wider(state: Turning, way: Array, variance: float) -> Turning:
    belief = state.belief
    wider = state.believing(replace(belief, covariance=belief.covariance + variance * np.outer(way, way)))
    if not isinstance(wider, State):
        return wider
    return replace(wider, mountings=state.mountings)  # however its anchor stands, all may turn about it
