"""Images in common walls hang together: settled ones are tied, rings settle where walls put them (M293)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, put
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.samples.common_walls import (
    ONE_BOUNCE,
    SINGLE,
    SURE,
    TIE_M,
    UNKNOWN,
    Places,
    farness,
    image_there,
    places_by_walls,
    said_m,
    widest,
)
from gridslam.inference.messages.samples.image_prediction import AWAY
from gridslam.inference.state.rings import MOVING, follow, symmetric
from gridslam.inference.state.samples.images import DirectState, Images
from gridslam.world.filter_model import FilterModel

TIED = 3.0
"""Deviation of a difference, in `TIE_M`, below which two images needn't be tied (again)."""
DECIDED = 20.0
"""Odds of a place, against all others and none, at which it is taken."""
NEAR_M = 1.0
"""How far a settled image may be from the place that it is tied to."""
FREE_M = 0.5
"""How far a place is from all settled images where a ring may settle."""
VISIBLE = 0.95
"""Visibility of a ring's path that has settled."""


def share_walls(state: DirectState, model: FilterModel) -> DirectState:
    """Tie a settled image of each anchor, and settle a ring, where walls that other images show put them.

    One of each at a time: places move with it, and the next step is soon. A ring that stands where a settled
    image's path was away from is that image, back again.
    """
    for anchor in range(len(model.anchor_positions)):
        state = _returned(state, anchor, model)
        places = places_by_walls(state, anchor, model)
        if len(places):
            tied = _tied(state, anchor, places, model)
            state = _settled(state, anchor, places, model) if tied is state else tied
    return state


def _tied(state: DirectState, anchor: int, places: Places, model: FilterModel) -> DirectState:
    """Correct the belief by "this image is at that place", for one image that surely is."""
    worth = places.log_worth(model.anchor_positions[anchor], model)
    known = (state.images.anchor == anchor) & (widest(state.place_covariances) < said_m(model))
    for row in np.flatnonzero(known).tolist():
        gap = state.places[row] - places.place
        near = np.flatnonzero((np.linalg.norm(gap, axis=1) < NEAR_M) & (places.maker != row))
        if not len(near):
            continue
        looking = -places.slope[near]
        looking[:, :, MOVING + 2 * row : MOVING + 2 * row + 2] += state.place_slopes[row]
        spread = looking @ state.belief.covariance @ np.swapaxes(looking, 1, 2)
        if widest(spread).min() < TIED * TIE_M:
            continue  # it hangs together with one of them already
        spread = spread + TIE_M**2 * np.eye(2)
        best = _decided(_log_normal(gap[near], spread) + worth[near])
        if best is not None:
            before, cross = state.belief, state.belief.covariance @ looking[best].T
            gain = np.linalg.solve(spread[best], cross.T).T
            after = Belief(
                before.mean - gain @ gap[near][best], symmetric(before.covariance - gain @ cross.T)
            )
            rings = follow(state.tentative.rings, before, after)
            images = _marked(state.images, row, places, int(near[best]))
            tentative = replace(state.tentative, rings=rings)
            return replace(state, belief=after, images=images, tentative=tentative)
    return state


def _settled(state: DirectState, anchor: int, places: Places, model: FilterModel) -> DirectState:
    """Make a ring the image at a place, for one ring that surely is there."""
    taken = state.places[state.images.anchor == anchor]
    free = np.flatnonzero(farness(places.place, taken) > FREE_M)
    if not len(free):
        return state
    worth = places.take(free).log_worth(model.anchor_positions[anchor], model)
    tentative, rings = state.tentative, state.tentative.rings
    for row in np.flatnonzero((rings.anchor == anchor) & (rings.existence > SURE)).tolist():
        best = _decided(_log_densities(state, row, places.place[free], places.covariance[free]) + worth)
        if best is not None:
            which = int(free[best])
            state = image_there(
                state, anchor, places, which, float(rings.existence[row]), VISIBLE,
                float(tentative.intensity[row]), float(tentative.heard[row]), int(rings.age[row]),
            )  # fmt: skip
            images = _marked(state.images, len(state.images) - 1, places, which)
            return replace(state, images=images, tentative=tentative.take(np.arange(len(rings)) != row))
    return state


def _returned(state: DirectState, anchor: int, model: FilterModel) -> DirectState:
    """Give an image that is away the path of a ring that surely stands in its place, for one ring (M545)."""
    images, tentative, rings = state.images, state.tentative, state.tentative.rings
    sure = np.flatnonzero((rings.anchor == anchor) & (rings.existence > SURE))
    away = np.flatnonzero((images.anchor == anchor) & ~images.proposed & (images.visible < AWAY))
    if not len(sure) or not len(away):
        return state
    away = away[widest(state.place_covariances[away]) < said_m(model)]
    if not len(away):
        return state
    place, covariance = state.places[away], state.place_covariances[away]
    span = np.linalg.norm(place - model.anchor_positions[anchor], axis=1)
    worth = np.log(SINGLE * images.existence[away] * 4 * np.pi * model.radius_m * span / UNKNOWN)
    for row in sure.tolist():
        best = _decided(_log_densities(state, row, place, covariance) + worth)
        if best is not None:
            image = away[best]
            images = replace(
                images,
                existence=put(images.existence, image, max(images.existence[image], rings.existence[row])),
                visible=put(images.visible, image, VISIBLE),
                intensity=put(images.intensity, image, tentative.intensity[row]),
                heard=put(images.heard, image, tentative.heard[row]),
            )
            return replace(state, images=images, tentative=tentative.take(np.arange(len(rings)) != row))
    return state


def _log_densities(state: DirectState, row: int, place: Array, covariance: Array) -> Array:
    """Log density (C,) of a ring's image at places (C, 2) known to covariances, 1/m^2."""
    rings = state.tentative.rings
    live = rings.weight[row] > 0
    gap = rings.mean[row, live][:, MOVING:] - place[:, None]
    spread = rings.covariance[row, live][:, MOVING:, MOVING:] + covariance[:, None]
    logs = _log_normal(gap, spread) + np.log(rings.weight[row, live])
    return np.asarray(np.logaddexp.reduce(logs, axis=1))


def _marked(images: Images, row: int, places: Places, which: int) -> Images:
    """An image over known walls, and the one that showed the (first) wall."""
    bounces: NDArray[np.int64] = images.bounces.copy()
    bounces[row] = places.bounces[which]
    bounces[places.maker[which]] = ONE_BOUNCE
    return replace(images, bounces=bounces)


def _decided(log_odds: Array) -> int | None:
    """Which place is by far likelier than all others and none, if one is."""
    best = int(log_odds.argmax())
    rest = np.logaddexp.reduce(np.append(np.delete(log_odds, best), 0.0))
    return best if log_odds[best] - rest > np.log(DECIDED) else None


def _log_normal(gap: Array, covariance: Array) -> Array:
    """Log density (...,) of gaps (..., 2), 1/m^2."""
    one, both, two = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    determinant = one * two - both**2
    squared = two * gap[..., 0] ** 2 - 2 * both * gap[..., 0] * gap[..., 1] + one * gap[..., 1] ** 2
    return np.asarray(-0.5 * squared / determinant - 0.5 * np.log(determinant) - np.log(2 * np.pi))
