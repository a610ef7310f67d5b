"""Distances of an anchor's paths as the state predicts them, and the update of the state by their mode."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.samples.distance_mode import Mode, PathPrior
from gridslam.inference.state.belief import Belief
from gridslam.inference.state.rings import MOVING, Rings, follow, move, symmetric
from gridslam.inference.state.samples.images import DirectState, predict
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import unit

P_STAY, P_APPEAR = 0.97, 0.01
"""A path that is there stays so for a step; one that isn't appears."""
WALK_M = 1e-4
"""Random walk of an image per step, [LiangDirect], section IV."""
AWAY = 0.2
"""Probability that a path is there, below which it is away for now."""
LEAST_VARIANCE = 1e-10
"""Of a predicted distance beside the others, m^2: keeps their covariance regular."""


@dataclass(frozen=True, eq=False)
class AnchorPaths:
    """The paths of one anchor: its own, those of settled images, those of tentative ones.

    Attributes
    ----------
    anchor : int
    images : (S,) int
        Rows of the settled images.
    tentative : (R,) int
        Rows of the tentative ones.
    slope : (1 + S, N) 1
        Derivatives of the first 1 + S distances by the joint state.
    covariance : (1 + S, 1 + S) m^2
        Of them.
    visible : (1 + S,)
        Predicted probability that each path is there, given that its image exists.
    prior : PathPrior
        Of all 1 + S + R.
    """

    anchor: int
    images: NDArray[np.intp]
    tentative: NDArray[np.intp]
    slope: Array
    covariance: Array
    visible: Array
    prior: PathPrior

    @property
    def joint(self) -> int:
        """How many paths are functions of the joint state, 1 + S."""
        return 1 + len(self.images)


def predict_state(state: DirectState, time_s: float, audible: int, model: FilterModel) -> DirectState:
    """Motion of the agent in the joint belief and in every ring; survival ([LiangDirect], section II-B).

    Parameters
    ----------
    audible : int
        How many anchors were heard at this step.
    """
    state = replace(state, watch=state.watch.begun(audible))
    if state.time_s is None:
        return replace(state, time_s=time_s)
    elapsed, settings = time_s - state.time_s, model.settings
    rings = move(state.tentative.rings, elapsed, settings.acceleration_mps2)
    rings = replace(rings, existence=settings.survival * rings.existence)
    images = replace(
        state.images, existence=settings.survival * state.images.existence, age=state.images.age + 1
    )
    return replace(
        state,
        belief=predict(state.belief, elapsed, settings.acceleration_mps2, WALK_M),
        images=images,
        tentative=replace(state.tentative, rings=rings),
        time_s=time_s,
    )


def predict_paths(state: DirectState, anchor: int, model: FilterModel) -> AnchorPaths:
    """Distances of an anchor's paths, their covariance, and the power that is expected in each."""
    images, links = state.images, state.links
    own = np.flatnonzero(images.anchor == anchor)
    others = np.flatnonzero(state.tentative.rings.anchor == anchor)
    mean, slope = image_distances(state, own, model.anchor_positions[anchor])
    farther, doubt = curved(state, own, model.anchor_positions[anchor])
    covariance = symmetric(slope @ state.belief.covariance @ slope.T) + LEAST_VARIANCE * np.eye(len(mean))
    mean, covariance = mean + farther, covariance + doubt
    tentative = state.tentative.take(others)
    ring_mean, ring_variance = ring_distances(tentative.rings)

    visible = P_APPEAR + (P_STAY - P_APPEAR) * np.append(links.visible[anchor], images.visible[own])
    intensity = np.append(links.intensity[anchor], images.intensity[own])
    chance = visible * np.append(1.0, images.existence[own])
    away = np.concatenate([np.where(visible < AWAY, intensity, 0.0), np.zeros(len(others))])
    joint, size = len(mean), len(mean) + len(others)
    precision = np.zeros((size, size))
    precision[:joint, :joint] = np.linalg.inv(covariance)
    precision[range(joint, size), range(joint, size)] = 1 / ring_variance
    prior = PathPrior(
        np.concatenate([mean, ring_mean]),
        symmetric(precision),
        np.concatenate([chance * intensity, tentative.rings.existence * tentative.intensity]),
        away,
        np.concatenate([chance, P_STAY * tentative.rings.existence]),
    )
    return AnchorPaths(anchor, own, others, slope, covariance, visible, prior)


def image_distances(state: DirectState, rows: NDArray[np.intp], position: Array) -> tuple[Array, Array]:
    """Distances (1 + S,) of an anchor and its settled images, and their slopes (1 + S, N) by the state."""
    place = np.concatenate([position[None], state.places[rows]])
    away = state.belief.mean[:2] - place
    distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-6)
    toward = away / distance[:, None]
    slope = np.zeros((len(place), len(state.belief.mean)))
    slope[:, :2] = toward
    by_polar = -np.einsum("si,sij->sj", toward[1:], state.place_slopes[rows])
    for side in range(2):
        slope[1 + np.arange(len(rows)), MOVING + 2 * rows + side] = by_polar[:, side]
    return distance, slope


def curved(state: DirectState, rows: NDArray[np.intp], position: Array) -> tuple[Array, Array]:
    """What the curvature of distances adds to their mean (1 + S,) and covariance (1 + S, 1 + S) (M156).

    A belief that is wide across a path is straight, and the circle of equal distance bends away from it: by
    1 cm at 4 m for a deviation of 0.3 m, more than a strong path's own. A distance bends with the way across
    the path, and with the bearing of its image, whose place goes round in a circle.
    """
    mean, images = state.belief.mean, np.arange(len(rows))
    place = np.concatenate([position[None], state.places[rows]])
    away = mean[:2] - place
    distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-6)
    toward, count = away / distance[:, None], len(place)
    across = np.stack([-toward[:, 1], toward[:, 0]], -1)
    turn, bend = np.zeros((2 * count, len(mean))), np.zeros(2 * count)
    turn[:count, :2], bend[:count] = across, 1 / distance
    by_polar = -np.einsum("si,sij->sj", across[1:], state.place_slopes[rows])
    for side in range(2):
        turn[1 + images, MOVING + 2 * rows + side] = by_polar[:, side]
    polar = mean[MOVING:].reshape(-1, 2)[rows]
    turn[count + 1 + images, MOVING + 2 * rows] = 1.0
    bend[count + 1 :] = polar[:, 1] * (toward[1:] * unit(polar[:, 0])).sum(-1)
    spread = turn @ state.belief.covariance @ turn.T
    farther = 0.5 * bend * spread.diagonal()
    doubt = 0.5 * np.outer(bend, bend) * spread**2
    return (
        farther[:count] + farther[count:],
        doubt[:count, :count] + doubt[:count, count:] + doubt[count:, :count] + doubt[count:, count:],
    )


def ring_distances(rings: Rings) -> tuple[Array, Array]:
    """Mean and variance (R,) of the distance of every ring, matched over its hypotheses."""
    distance, spread, _ = hypothesis_distances(rings)
    mean = (rings.weight * distance).sum(-1)
    return mean, (rings.weight * (spread + (distance - mean[:, None]) ** 2)).sum(-1)


def hypothesis_distances(rings: Rings) -> tuple[Array, Array, Array]:
    """Distance (R, K), its variance, and its covariance with agent and image (R, K, 6)."""
    away = rings.mean[..., MOVING:] - rings.mean[..., :2]
    distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-6)
    toward = away / distance[..., None]
    slope = np.concatenate([-toward, np.zeros_like(toward), toward], -1)
    gain = np.einsum("rkij,rkj->rki", rings.covariance, slope)
    return distance, np.maximum((gain * slope).sum(-1), 1e-12), gain


def update_state(state: DirectState, paths: AnchorPaths, mode: Mode) -> DirectState:
    """Update agent and settled images by the mode of their distances; rings follow (M80)."""
    joint = paths.joint
    before = state.belief
    reached, narrowed = mode.distance[:joint], mode.covariance[:joint, :joint]
    gain = np.linalg.solve(paths.covariance, paths.slope @ before.covariance).T
    mean = before.mean + gain @ (reached - paths.prior.mean[:joint])
    covariance = before.covariance - gain @ (paths.covariance - narrowed) @ gain.T
    after = Belief(mean, symmetric(covariance))
    rings = follow(state.tentative.rings, before, after)
    return replace(state, belief=after, tentative=replace(state.tentative, rings=rings))
