"""Rings of hypotheses about the bearing of new images (M82), (M83)."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.inference.messages.samples.image_births import OWN_PLACE_M, NewDistance
from gridslam.inference.state.rings import directions, rings_about
from gridslam.inference.state.samples.images import DirectState, Tentative
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import line_between, unit


def add_tentative(state: DirectState, anchor: int, new: list[NewDistance], model: FilterModel) -> DirectState:
    """Begin a ring for every new path, and keep the likeliest few of the anchor."""
    likely, belief = list[NewDistance](), state.belief
    toward = directions()
    position, weights = model.anchor_positions[anchor], list[Array]()
    for path in new:
        image = belief.mean[:2] + path.distance * toward
        weight = _density(image, position, model)
        if weight.sum() > 0:
            likely.append(path)
            weights.append(weight / weight.sum())
    if likely:
        distance, variance, existence, intensity = np.array(
            [(path.distance, path.variance, path.existence, path.intensity) for path in likely]
        ).T
        fresh = rings_about(belief, anchor, distance, variance, existence, np.array(weights))
        tentative = state.tentative.joined(Tentative(fresh, intensity, np.ones(len(likely))))
        state = replace(state, tentative=tentative)
    return state


def _density(image: Array, position: Array, model: FilterModel) -> Array:
    """Of images (K, 2): surfaces are uniform over the lines that cross the region."""
    line, span = line_between(position, image), np.linalg.norm(image - position, axis=-1)
    crosses = np.abs((unit(line[:, 0]) @ model.middle) - line[:, 1]) < model.radius_m
    return np.asarray(crosses * (span > OWN_PLACE_M) / np.maximum(span, 0.1))
