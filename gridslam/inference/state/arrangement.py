"""Which surfaces stand in the joint belief, and which are parked beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.beliefs.belief import keep
from gridslam.inference.beliefs.layout import PER_LINE
from gridslam.inference.state.parked import Parked
from gridslam.inference.state.state import State


def arranged(state: State, active: NDArray[np.bool_]) -> State:
    """The state with other surfaces in its joint belief, ordered by their numbers; nothing is forgotten.

    Rays between a parked and another surface start as ones that nothing told of for long.

    Parameters
    ----------
    active : (S + P,) bool
        Of those in the belief, then of the parked ones, which are to stand in it.
    """
    belief, parked, head = state.belief, state.parked, state.belief.layout.head
    bank, mean, joint = state.surfaces, belief.mean, belief.covariance
    if parked is not None:
        bank = bank.joined(parked.surfaces)
        mean = np.concatenate([mean, parked.mean])
        joint = np.block([[joint, parked.cross.T], [parked.cross, parked.covariance]])
    rows, away = (_ordered(bank.identity, chosen) for chosen in (active, ~active))
    own = np.concatenate([np.arange(head), _entries(rows, head)])
    left = _entries(away, head)
    rest = None
    if len(away):
        rest = Parked(bank.take(away), mean[left], joint[np.ix_(left, left)], joint[np.ix_(left, own)])
    there = replace(belief, mean=mean[own], covariance=joint[np.ix_(own, own)])
    return mountings_followed(state, replace(state, belief=there, surfaces=bank.take(rows), parked=rest))


def unparked(state: State) -> State:
    """The state with all surfaces in its joint belief."""
    if state.parked is None:
        return state
    return arranged(state, np.ones(len(state.surfaces) + len(state.parked), bool))


def without(state: State, dropped: NDArray[np.bool_]) -> State:
    """The state without some surfaces (S,) of its joint belief."""
    if not dropped.any():
        return state
    parked, left = state.parked, ~dropped
    if parked is not None:
        rows = np.concatenate([np.ones(state.belief.layout.head, bool), np.repeat(left, PER_LINE)])
        parked = replace(parked, cross=parked.cross[:, rows])
    rest = replace(
        state, belief=keep(state.belief, left), surfaces=state.surfaces.take(left), parked=parked
    )  # fmt: skip
    return mountings_followed(state, rest)


def mountings_followed(before: State, state: State) -> State:
    """The state with its mountings, (M569), as what the joint belief has become since `before` has them."""
    if before.mountings is None or state.belief is before.belief:
        return state
    rows = lasting(before, state)
    return replace(state, mountings=before.mountings.following(before.belief, state.belief, rows))


def lasting(before: State, after: State) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Entries of a joint belief that are in a later one still, and where, (R,) each."""
    head = before.belief.layout.head
    _, old, new = np.intersect1d(before.surfaces.identity, after.surfaces.identity, return_indices=True)
    first = np.arange(head)
    return np.concatenate([first, _entries(old, head)]), np.concatenate([first, _entries(new, head)])


def _ordered(identity: NDArray[np.int64], chosen: NDArray[np.bool_]) -> NDArray[np.intp]:
    rows = np.flatnonzero(chosen)
    return np.asarray(rows[np.argsort(identity[rows], kind="stable")])


def _entries(rows: NDArray[np.intp], head: int) -> NDArray[np.intp]:
    return (head + PER_LINE * rows[:, None] + np.arange(PER_LINE)).reshape(-1)
