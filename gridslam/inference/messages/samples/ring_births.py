"""Rings of hypotheses about the bearing of new images (M82), (M83)."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.inference.messages.samples.image_births import OWN_PLACE_M, NewDistance
from gridslam.inference.state.belief import Belief
from gridslam.inference.state.rings import BEARINGS, MOVING, Rings, outer
from gridslam.inference.state.samples.images import DirectState, Tentative
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import line_between, unit

OVERLAP = 0.6
"""Deviation of a hypothesis along the ring at birth, in spacings."""


def add_tentative(state: DirectState, anchor: int, new: list[NewDistance], model: FilterModel) -> DirectState:
    """Begin a ring for every new path, and keep the likeliest few of the anchor."""
    begun, belief = list[NewDistance](), state.belief
    toward = _toward()
    position, weights = model.anchor_positions[anchor], list[Array]()
    for path in new:
        image = belief.mean[:2] + path.distance * toward
        weight = _density(image, position, model)
        if weight.sum() > 0:
            begun.append(path)
            weights.append(weight / weight.sum())
    if begun:
        fresh = _rings(belief, anchor, begun, np.array(weights))
        intensity = np.array([path.intensity for path in begun])
        tentative = state.tentative.joined(Tentative(fresh, intensity, np.ones(len(begun))))
        state = replace(state, tentative=tentative)
    return state


def _density(image: Array, position: Array, model: FilterModel) -> Array:
    """Of images (K, 2): surfaces are uniform over the lines that cross the region."""
    line, span = line_between(position, image), np.linalg.norm(image - position, axis=-1)
    crosses = np.abs((unit(line[:, 0]) @ model.middle) - line[:, 1]) < model.radius_m
    return np.asarray(crosses * (span > OWN_PLACE_M) / np.maximum(span, 0.1))


def _toward() -> Array:
    """Unit vectors of the hypotheses, (K, 2)."""
    return unit(np.asarray(2 * np.pi / BEARINGS * np.arange(BEARINGS), np.float64))


def _rings(belief: Belief, anchor: int, new: list[NewDistance], weight: Array) -> Rings:
    """Rings (n) about the agent."""
    count = len(new)
    distance = np.array([path.distance for path in new])[:, None]
    variance = np.array([path.variance for path in new])[:, None]
    toward = np.broadcast_to(_toward(), (count, BEARINGS, 2))
    across = np.stack([-toward[..., 1], toward[..., 0]], -1)
    arc = np.square(OVERLAP * 2 * np.pi / BEARINGS * distance)[..., None, None]
    mean = np.zeros((count, BEARINGS, MOVING + 2))
    mean[..., :MOVING] = belief.mean[:MOVING]
    mean[..., MOVING:] = belief.mean[:2] + distance[..., None] * toward
    entry = np.array([0, 1, 2, 3, 0, 1])  # the image shares the error of the agent's position
    covariance = np.broadcast_to(belief.covariance[np.ix_(entry, entry)], (*mean.shape, MOVING + 2)).copy()
    covariance[..., MOVING:, MOVING:] += variance[..., None, None] * outer(toward, toward) + arc * outer(
        across, across
    )
    whole = np.zeros(count, np.int64)
    return Rings(
        np.full(count, anchor, np.intp), np.array([path.existence for path in new]), whole, whole + 1, weight,
        mean, covariance,
    )  # fmt: skip
