"""Many surfaces: those out of sight leave the joint belief, and come back when they may be seen again.

Two messages of a step, `recall` before any measurement is used and `park` after all of them. While all
surfaces together are no more than one joint belief takes, neither does anything. docs/model.md, (M575).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.management.in_sight import BELIEVED, out_of_reach, shortest_path
from gridslam.inference.management.merging import MOST_SURFACES, are_one
from gridslam.inference.messages.motion import BEYOND_DOUBT
from gridslam.inference.state.arrangement import arranged, lasting, without
from gridslam.inference.state.parked import Parked
from gridslam.inference.state.state import State
from gridslam.world.filter_model import FilterModel, detected
from gridslam.world.geometry import unit, wrap

NEARBY_M = 1.0
"""By how much a wall may reach beyond the stretch that was hit, to be recalled."""
YOUNG = 30
"""Age up to which a surface may turn out to be one that is parked."""
FAR_RAD, FAR_M = 0.1, 0.5
"""Turn and gap from which on they are none."""


def recall(state: State, model: FilterModel) -> State:
    """Bring back the parked surfaces that may be seen from where the agent is, the nearest if not all fit in.

    May be seen: a single bounce from some anchor off the stretch that was hit is possible, with no occupied
    cell in its way; or a young surface may be the same wall.
    """
    parked = state.parked
    if parked is None:
        return state
    near = shortest_path(state, parked.lines, parked.surfaces, NEARBY_M, model)
    wanted = np.isfinite(near) | same_as_young(state, parked).any(0)
    if not wanted.any():
        return state
    bank = state.surfaces
    stay = np.ones(len(bank), bool)
    if len(bank) + int(wanted.sum()) > MOST_SURFACES:  # elsewhere all of a sudden, as an agent that was lost
        stay = ~(settled(state, model) & out_of_reach(state, np.ones(len(bank), bool), model))
    room = max(MOST_SURFACES - int(stay.sum()), 0)
    order = np.argsort(np.where(wanted, np.minimum(near, 1e9), np.inf), kind="stable")
    back = np.zeros(len(parked), bool)
    back[order[: min(room, int(wanted.sum()))]] = True
    left = int(np.count_nonzero(wanted & ~back))
    state = replace(state, monitor=replace(state.monitor, dropped=left))
    return arranged(state, np.concatenate([stay, back])) if room else state


def park(recalled: State, state: State, model: FilterModel) -> State:
    """Let parked surfaces follow what the step has learned; of too many, park those that are out of sight.

    Out of sight: no ray over it is believed in, and none is possible. Where more are in sight than one joint
    belief takes, the least likely are set aside, too (those not believed in are dropped); health says so.

    Parameters
    ----------
    recalled : State
        Before the step's measurements were used.
    """
    if recalled.parked is not None:
        rows = lasting(recalled, state)
        parked = recalled.parked.following(recalled.belief, state.belief, rows)
        state = replace(state, parked=parked)
    bank = state.surfaces
    if len(state.every_existence) <= MOST_SURFACES:
        return state
    sure = detected(bank.existence, model.settings)
    away = hidden(state, model)
    stay = np.flatnonzero(~away)
    beyond = stay[np.argsort(-bank.existence[stay], kind="stable")[MOST_SURFACES:]]
    if len(beyond):
        crowded = state.monitor.dropped + int(sure[beyond].sum())
        state = replace(state, monitor=replace(state.monitor, dropped=crowded))
        away[beyond] = True
    state, away = without(state, away & ~sure), away[~(away & ~sure)]
    if not away.any():
        return state
    outside = 0 if state.parked is None else len(state.parked)
    return arranged(state, np.concatenate([~away, np.zeros(outside, bool)]))


def settled(state: State, model: FilterModel) -> NDArray[np.bool_]:
    """Which surfaces of the joint belief are believed in and confirmed, (S,)."""
    bank = state.surfaces
    return detected(bank.existence, model.settings) & (bank.seen >= BEYOND_DOUBT)


def hidden(state: State, model: FilterModel) -> NDArray[np.bool_]:
    """Which surfaces of the joint belief are to be parked, (S,)."""
    bank = state.surfaces
    away = out_of_reach(state, settled(state, model) & (bank.likeliest_ray < BELIEVED), model)
    if away.any() and state.parked is not None:
        away &= ~same_as_young(state, state.parked).any(1)
    return away


def same_as_young(state: State, parked: Parked) -> NDArray[np.bool_]:
    """Which young surfaces of the joint belief may be the same wall as which parked ones, (S, P).

    By `are_one`, within the joint covariance of both, of those near each other by turn, and gap where the
    young one was hit.
    """
    bank, lines, own = state.surfaces, parked.lines, state.belief.lines
    place = own[:, 1, None] * unit(own[:, 0]) + bank.foot[:, None] * unit(own[:, 0] + 0.5 * np.pi)
    turn = wrap(own[:, None, 0] - lines[:, 0])
    turn = np.where(np.abs(turn) > 0.5 * np.pi, wrap(turn + np.pi), turn)
    gap = lines[:, 1] - place @ unit(lines[:, 0]).T
    same = (np.abs(turn) < FAR_RAD) & (np.abs(gap) < FAR_M) & (bank.age <= YOUNG)[:, None]
    same &= bank.owner[:, None] == parked.surfaces.owner
    for young, old in np.argwhere(same).tolist():
        rows, there = state.belief.layout.line(young), 2 * old + np.arange(2)
        cross = parked.cross[np.ix_(there, rows)]
        joint = np.block([
            [parked.covariance[np.ix_(there, there)], cross],
            [cross.T, state.belief.covariance[np.ix_(rows, rows)]],
        ])  # fmt: skip
        same[young, old] = are_one(lines[old], own[young], joint, float(bank.foot[young]))
    return same
