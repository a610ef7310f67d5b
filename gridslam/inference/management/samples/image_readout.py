"""Estimates for users of direct SLAM: images as surfaces, and the paths believed in."""

from __future__ import annotations

import dataclasses

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.estimate_tables import HypothesisEstimate, PathEstimate, RingEstimate, SurfaceEstimate
from gridslam.inference.state.population import Population, moments
from gridslam.inference.state.rings import MOVING
from gridslam.inference.state.samples.images import DirectState
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import crossing, direction, line_between, mirror_derivative, unit, wrap

KNOWN_M = 0.3
"""Deviation of an image's place below which the points of its surface that are hit count."""
LEAST_WEIGHT = 1e-3
"""Of a ring's hypothesis that is reported."""
UNKNOWN_REFLECTION = 0.5, 1 / 12
"""Mean and variance of a coefficient of which nothing is known."""


def image_lines(state: DirectState, model: FilterModel) -> tuple[Array, Array]:
    """Lines (S, 2) halfway between anchors and images, rad and m, and their covariances (S, 2, 2)."""
    place, anchor = state.places, model.anchor_positions[state.images.anchor]
    line = line_between(anchor, place)
    back = np.linalg.inv(mirror_derivative(line, anchor))
    return line, back @ state.place_covariances @ np.swapaxes(back, 1, 2)


def image_surfaces(state: DirectState, model: FilterModel) -> SurfaceEstimate:
    """Table of the surfaces behind all settled images; each serves its own anchor."""
    line, covariance = image_lines(state, model)
    images, size = state.images, len(state.images)
    mean, variance = UNKNOWN_REFLECTION
    return SurfaceEstimate.from_lines(
        line, covariance, np.full(size, mean), np.full(size, variance), images.existence.copy(),
        images.extent.copy(), images.identity.copy(), images.anchor.copy(),
    )  # fmt: skip


def moving_moments(population: Population[DirectState]) -> tuple[Array, Array]:
    """Mean (4,) and covariance (4, 4) of position and velocity in the mixture of all hypotheses."""
    means = np.array([state.belief.mean[:MOVING] for state in population.states])
    own = np.array([state.belief.covariance[:MOVING, :MOVING] for state in population.states])
    return moments(population.weights, means, own)


def image_hypotheses(population: Population[DirectState]) -> HypothesisEstimate:
    """Table of all hypotheses; headings are those of the motion."""
    means = np.array([state.belief.mean[:MOVING] for state in population.states])
    return HypothesisEstimate(
        population.weights, means[:, :2], np.arctan2(means[:, 3], means[:, 2]),
        np.array([state.belief.covariance[:2, :2] for state in population.states]),
        np.array([len(state.images) for state in population.states], np.int64),
    )  # fmt: skip


def image_rings(state: DirectState) -> RingEstimate:
    """Table of the tentative images' likely places, ring by ring."""
    rings = state.tentative.rings
    ring, place = np.nonzero(rings.weight >= LEAST_WEIGHT)
    return RingEstimate(
        ring, rings.anchor[ring].astype(np.int64), rings.existence[ring], rings.weight[ring, place],
        rings.mean[ring, place, MOVING:],
    )  # fmt: skip


def note_hits(state: DirectState, model: FilterModel) -> DirectState:
    """Widen the stretch of each surface that was hit by where its path meets it now."""
    images, place = state.images, state.places
    spread = np.sqrt(np.trace(state.place_covariances, axis1=1, axis2=2))
    line = line_between(model.anchor_positions[images.anchor], place)
    hit = _hits(state, place, line)
    along = (hit * unit(line[:, 0] + 0.5 * np.pi)).sum(-1)
    counts = (images.visible > 0.5) & (spread < KNOWN_M)
    low, high = np.fmin(images.extent[:, 0], along), np.fmax(images.extent[:, 1], along)
    extent = np.where(counts[:, None], np.stack([low, high], -1), images.extent)
    return replace(state, images=dataclasses.replace(images, extent=extent))


def image_paths(state: DirectState, model: FilterModel, heading_rad: float) -> PathEstimate:
    """Lines of sight and single bounces, anchor by anchor, as the state has them."""
    images, links, mean = state.images, state.links, state.belief.mean[:2]
    positions, anchors = model.anchor_positions, np.arange(len(model.anchor_positions))
    owner = np.concatenate([anchors, images.anchor])
    order = np.argsort(owner, kind="stable")  # of each anchor, its own path first
    owner, bounced = owner[order], order >= len(anchors)
    image = order[bounced] - len(anchors)
    source, here = positions[owner], np.broadcast_to(mean, (len(owner), 2))
    place = source.copy()
    place[bounced] = state.places[image]
    hit = np.full(place.shape, np.nan)
    hit[bounced] = _hits(state, place[bounced], line_between(source[bounced], place[bounced]))
    numbers = np.concatenate([np.full(len(anchors), -1), images.identity])[order]
    level = np.concatenate([links.intensity, images.intensity])[order]
    visible = np.concatenate([links.visible, images.existence * images.visible])[order]
    return PathEstimate(
        owner, np.stack([numbers, numbers], -1), np.maximum(np.linalg.norm(mean - place, axis=-1), 1e-6),
        wrap(direction(source, np.where(bounced[:, None], hit, here)) - model.anchor_orientations[owner]),
        wrap(direction(mean, np.where(bounced[:, None], hit, source)) - heading_rad),
        np.sqrt(level / np.maximum(links.noise, 1e-300)[owner]), visible,
        np.stack([source, hit, hit, here], 1),
    )  # fmt: skip


def motion_heading(mean: Array, own: Array) -> tuple[float, Array]:
    """Direction of motion, which is all that distances tell of a heading, and covariance (5, 5) with it.

    An agent that may turn on the spot has another heading: this one is of the velocity. Its variance is at
    most that of any direction.

    Parameters
    ----------
    mean, own : (4,) and (4, 4)
        Of position and velocity.
    """
    velocity = mean[2:4]
    speed = float(np.hypot(*velocity))
    slope = np.zeros((5, 4))
    slope[:4] = np.eye(4)
    heading = float(np.arctan2(velocity[1], velocity[0])) if speed > 0 else 0.0
    if speed > 0:
        slope[4, 2:] = np.array([-velocity[1], velocity[0]]) / speed**2
    covariance = slope @ own @ slope.T
    most = np.pi**2 / 3
    if speed == 0 or covariance[4, 4] > most:
        covariance[4, :] = covariance[:, 4] = 0.0
        covariance[4, 4] = most
    return heading, covariance


def _hits(state: DirectState, place: Array, line: Array) -> Array:
    """Where each image's path meets its surface, (S, 2) m."""
    agent = np.broadcast_to(state.belief.mean[:2], place.shape)
    share = crossing(agent, place, line)
    return np.asarray(agent + share[:, None] * (place - agent))
