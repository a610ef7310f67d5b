"""Settled images of one anchor that are one and the same become one.

A path that was lost for a while may begin a second image of the same wall; the two then share its power, each
with a visibility between 0 and 1, and either may let the other drift.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.state.rings import MOVING, follow, symmetric
from gridslam.inference.state.samples.images import DirectState

SAME, NEAR_M = 9.0, 0.5
"""Squared distance, by the joint covariance, and distance below which two images are one."""


def merge_images(state: DirectState) -> DirectState:
    """Merge pairs of images, the nearest first, until no two are one."""
    while True:
        pair = _closest(state)
        if pair is None:
            return state
        state = _merged(state, *pair)


def _closest(state: DirectState) -> tuple[int, int] | None:
    """Rows of the two images of one anchor that agree best, if any do; the likelier first."""
    anchor, place = state.images.anchor, state.places
    gap = np.linalg.norm(place[:, None] - place[None], axis=-1)
    best, found = SAME, None
    proposed = state.images.proposed
    pairs = (gap < NEAR_M) & (anchor[:, None] == anchor) & ~(proposed[:, None] | proposed)
    for one, other in np.argwhere(np.triu(pairs, 1)).tolist():
        looking = _difference(state, one, other)
        spread = looking @ state.belief.covariance @ looking.T
        off = place[one] - place[other]
        squared = float(off @ np.linalg.solve(spread, off))
        if squared < best:
            best, found = squared, (one, other)
    if found is None:
        return None
    chance = state.images.existence * state.images.heard
    return found if chance[found[0]] >= chance[found[1]] else (found[1], found[0])


def _difference(state: DirectState, one: int, other: int) -> Array:
    """Derivative of the difference of two places by the joint state, (2, N)."""
    slopes, looking = state.place_slopes, np.zeros((2, len(state.belief.mean)))
    looking[:, MOVING + 2 * one : MOVING + 2 * one + 2] = slopes[one]
    looking[:, MOVING + 2 * other : MOVING + 2 * other + 2] = -slopes[other]
    return looking


def _merged(state: DirectState, one: int, other: int) -> DirectState:
    """Correct the belief by "both are one", and drop the second."""
    before, looking = state.belief, _difference(state, one, other)
    cross = before.covariance @ looking.T
    gain = np.linalg.solve(looking @ cross, cross.T).T
    off = state.places[one] - state.places[other]
    after = Belief(before.mean - gain @ off, symmetric(before.covariance - gain @ cross.T))
    rings = follow(state.tentative.rings, before, after)
    images = state.images
    visible, intensity = images.visible.copy(), images.intensity.copy()
    visible[one] = max(visible[one], visible[other])
    intensity[one] = max(intensity[one], intensity[other])
    state = replace(
        state, belief=after, images=replace(images, visible=visible, intensity=intensity),
        tentative=replace(state.tentative, rings=rings),
    )  # fmt: skip
    return state.keep(np.arange(len(images)) != other)
