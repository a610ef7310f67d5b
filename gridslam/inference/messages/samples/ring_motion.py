"""What tentative images tell of the agent's motion before their place is known (M538).

A ring's distance changes as the agent moves, whichever of its hypotheses is true. Each of these is a Gaussian
of agent and image together, so that by how much surer of the agent all have become at a step, weighed,
is what the step has told, whatever is unknown of the image.
"""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief, diagonal_together
from gridslam.inference.messages.samples.image_prediction import AnchorPaths
from gridslam.inference.state.rings import MOVING, SURE, Rings, follow, outer, symmetric
from gridslam.inference.state.samples.images import DirectState

IN_SIGHT, LOUD = 0.99, 10.0
"""Visibility and SNR from which on a line of sight holds the agent's place."""
HOLDING = 2
"""Lines of sight that hold it: with one alone agent and images may be turned about its anchor."""
LEAST, LEFT = 1e-3, 1e-6
"""Share of a variance that must have gone for it to be told, and that is left at least."""
VELOCITY = slice(2, MOVING)
"""Entries of the agent."""


def tell_motion(before: DirectState, state: DirectState, paths: AnchorPaths) -> DirectState:
    """Give the joint belief what the sure rings of an anchor have learned of the agent at this step (M538).

    Parameters
    ----------
    before : DirectState
        Before the rings learned.
    state : DirectState
        After that.

    Notes
    -----
    Rings share what is unknown of the agent's way so far, and each is told what the others learn as if it
    were independent: so all together tell no more than one of them. Where no lines of sight hold the place,
    several tell of the velocity alone.
    """
    old, new, links = before.tentative.rings, state.tentative.rings, state.links
    telling = (new.existence > SURE) & (new.age > 0)
    in_sight = (links.visible > IN_SIGHT) & (links.intensity > LOUD * links.noise)
    share = int(telling.sum())
    entry = slice(0, MOVING) if share == 1 or in_sight.sum() >= HOLDING else VELOCITY
    for row in paths.tentative[telling[paths.tentative]].tolist():
        belief = _told(state.belief, _agent(old, row), _agent(new, row), entry, share)
        if belief is None:
            continue
        rings = state.tentative.rings
        others = np.flatnonzero(np.arange(len(rings)) != row)
        rings = rings.put(others, follow(rings.take(others), state.belief, belief))
        state = replace(state, belief=belief, tentative=replace(state.tentative, rings=rings))
    return state


def _agent(rings: Rings, row: int) -> tuple[Array, Array]:
    """Mean (4,) and covariance (4, 4) of the agent, over all hypotheses of a ring."""
    weight, each = rings.weight[row], rings.mean[row, :, :MOVING]
    mean = weight @ each
    off = each - mean
    spread = rings.covariance[row, :, :MOVING, :MOVING] + outer(off, off)
    return mean, np.einsum("k,kij->ij", weight, spread)


def _told(
    belief: Belief, before: tuple[Array, Array], after: tuple[Array, Array], entry: slice, share: int
) -> Belief | None:
    """The joint belief with what made one Gaussian of the agent's entries another one, as measurements.

    None where that is nothing.
    """
    value, own = diagonal_together(after[1][entry, entry], before[1][entry, entry])
    frame = np.zeros((MOVING, len(value)))
    frame[entry] = own
    shift = frame.T @ (after[0] - before[0])
    mean, covariance = belief.mean, belief.covariance
    told = np.flatnonzero(value < 1 - LEAST)
    for one in told.tolist():
        left = max(float(value[one]), LEFT)
        along, variance = frame[:, one], share * left / (1 - left)
        off = along @ (before[0] - mean[:MOVING]) + shift[one] / (1 - left)
        cross = covariance[:, :MOVING] @ along
        whole = along @ cross[:MOVING] + variance
        mean = mean + cross * (off / whole)
        covariance = covariance - np.outer(cross, cross) / whole
    return Belief(mean, symmetric(covariance)) if len(told) else None
