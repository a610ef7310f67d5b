"""How far the lines of surfaces walk from step to step: those of curved walls do; docs/model.md, (M361)."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief, line_entries
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.world.geometry import wrap

GAIN = 0.1
"""Of the logarithm by a step."""
DOUBT = 0.5
"""By how much a correction must be above its expected square to speak for a walk: most walls are flat."""
MOST_SURPRISED = 5.0
"""What one step may say at most, in expected squares."""
LEAST = -0.5
"""Of the logarithm: how much must speak for a walk before a line that has stood still moves at all."""
WIDEST = (30.0, 100.0)
"""Times a flat wall's walk at most: shift, turn."""
MOST = np.log(WIDEST)
LEAST_GAIN = 1e-3
"""Share of its variance that a line must lose at a step for the step to judge its walk."""


def learn_surface_walks(predicted: State, state: State) -> State:
    """The state after a step with the walks of its lines judged by how far the step has moved them; (M361).

    A line that stands for a flat wall is corrected by as much as its covariance shrinks. One that stands for
    a curved wall, along which it is dragged from piece to piece, is corrected by more.

    Parameters
    ----------
    predicted : State
        At the same time, before what was heard; its surfaces are the first of `state`.

    Raises
    ------
    ValueError
        They aren't.
    """
    if state.samples is not None:  # particles walk as published
        return state
    bank = with_walks(predicted.surfaces, predicted.belief, state.surfaces, state.belief)
    return replace(state, surfaces=bank)


def learn_shared_walks(predicted: NetworkState, state: NetworkState) -> NetworkState:
    """The state with walks of surfaces that agents share, judged by what all have heard at a step; (M361)."""
    bank = with_walks(predicted.surfaces, predicted.belief, state.surfaces, state.belief)
    return replace(state, surfaces=bank)


def with_walks(before: SurfaceBank, predicted: Belief, bank: SurfaceBank, belief: Belief) -> SurfaceBank:
    """Surfaces after a step with their walks, by the beliefs before and after; see `learn_surface_walks`."""
    count = len(before)
    same = bank.identity is before.identity
    if not same and not np.array_equal(bank.identity[:count], before.identity):
        raise ValueError("the state after a step doesn't begin with the surfaces before it")
    if not count:
        return bank
    foot = before.foot
    change = belief.lines[:count] - predicted.lines
    moved = np.empty((count, 2))
    moved[:, 1] = turned = wrap(change[:, 0])
    moved[:, 0] = change[:, 1] - foot * turned
    earlier = _at_foot(predicted, foot)
    gained = earlier - _at_foot(belief, foot)
    informed = gained > LEAST_GAIN * earlier
    surprise = moved**2 / np.where(informed, gained, np.inf) - 1 - DOUBT
    learned = bank.walk.copy()
    learned[:count] += GAIN * informed * np.minimum(surprise, MOST_SURPRISED)
    return replace(bank, walk=np.minimum(np.maximum(learned, LEAST), MOST))


def _at_foot(belief: Belief, foot: Array) -> Array:
    """Variances of shift and turn of the first lines about the places where they were hit, (S, 2)."""
    turn, _, cross, offset = (entries[: len(foot)] for entries in line_entries(belief))
    spread = np.empty((len(foot), 2))
    spread[:, 0], spread[:, 1] = offset - 2 * foot * cross + foot**2 * turn, turn
    return spread
