"""Distances of an anchor's paths as the state predicts them, and the update of the state by their mode."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.samples.distance_mode import Mode, PathPrior
from gridslam.inference.messages.samples.image_births import FoundDistances
from gridslam.inference.messages.samples.signal_likelihood import log_ratio
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
    state = replace(state, watch=state.watch.next_step(audible))
    if state.time_s is None:
        return replace(state, time_s=time_s)
    elapsed, settings = time_s - state.time_s, model.settings
    rings = move(state.tentative.rings, elapsed, settings.acceleration_mps2)
    rings = replace(rings, existence=settings.survival * rings.existence)
    images = dataclasses.replace(
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
    mean, slope, covariance = image_distances(state, own, model.anchor_positions[anchor])
    joint, size = len(mean), len(mean) + len(others)
    # rows: mean, weight, power if it is away for now, chance; of its own path, of images, of rings
    path, precision = np.zeros((4, size)), np.zeros((size, size))
    visible, intensity, exists = np.empty(joint), np.empty(joint), np.ones(joint)
    visible[0], visible[1:] = links.visible[anchor], images.visible[own]
    visible = P_APPEAR + (P_STAY - P_APPEAR) * visible
    intensity[0], intensity[1:] = links.intensity[anchor], images.intensity[own]
    exists[1:] = images.existence[own]
    chance = visible * exists
    path[:, :joint] = mean, chance * intensity, np.where(visible < AWAY, intensity, 0.0), chance
    inverse = np.linalg.inv(covariance)
    precision[:joint, :joint] = 0.5 * (inverse + inverse.T)
    if len(others):
        rings = state.tentative.rings.take(others)
        path[0, joint:], ring_variance = ring_distances(rings)
        path[1, joint:] = rings.existence * state.tentative.intensity[others]
        path[3, joint:] = P_STAY * rings.existence
        precision[range(joint, size), range(joint, size)] = 1 / ring_variance
    prior = PathPrior(path[0], precision, path[1], path[2], path[3])
    return AnchorPaths(anchor, own, others, slope, covariance, visible, prior)


def image_distances(
    state: DirectState, rows: NDArray[np.intp], position: Array
) -> tuple[Array, Array, Array]:
    """Distances (1 + S,) of an anchor and its settled images, slopes (1 + S, N) by the state, covariance.

    Curvature adds to mean and covariance (M156): a belief that is wide across a path is straight, and the
    circle of equal distance bends away from it, by 1 cm at 4 m for a deviation of 0.3 m, more than a strong
    path's own. A distance bends with the way across the path, and with the bearing of its image, whose place
    goes round in a circle.

    Parameters
    ----------
    rows : (S,) int
        Of the images.
    position : (2,) m
        Of the anchor.
    """
    mean, count = state.belief.mean, 1 + len(rows)
    away = np.empty((count, 2))
    away[0], away[1:] = mean[:2] - position, mean[:2] - state.places[rows]
    distance = np.maximum(np.sqrt((away * away).sum(-1)), 1e-6)
    toward = away / distance[:, None]
    by = _derivatives(state, rows, toward)
    slope, turned = by[:count], by[count:]
    bearing, span = mean[MOVING + 2 * rows], mean[MOVING + 2 * rows + 1]
    bend = np.concatenate([1 / distance, span * (toward[1:] * unit(bearing)).sum(-1)])
    spread = turned @ state.belief.covariance @ turned.T
    farther, doubt = 0.5 * bend * spread.diagonal(), 0.5 * (bend[:, None] * bend) * spread**2
    distance += farther[:count]
    distance[1:] += farther[count:]
    covariance = symmetric(slope @ state.belief.covariance @ slope.T) + doubt[:count, :count]
    covariance[1:] += doubt[count:, :count]
    covariance[:, 1:] += doubt[:count, count:]
    covariance[1:, 1:] += doubt[count:, count:]
    covariance[range(count), range(count)] += LEAST_VARIANCE
    return distance, slope, covariance


def _derivatives(state: DirectState, rows: NDArray[np.intp], toward: Array) -> Array:
    """Derivatives (1 + S + 1 + S + S, N) by the state: of distances, ways across, and bearings of images.

    Parameters
    ----------
    toward : (1 + S, 2)
        Unit vectors from the anchor and its images to the agent.
    """
    count = len(toward)
    across = np.stack([-toward[:, 1], toward[:, 0]], -1)
    by, image = np.zeros((3 * count - 1, len(state.belief.mean))), np.arange(1, count)
    by[:count, :2], by[count : 2 * count, :2] = toward, across
    place, turn = state.place_slopes[rows], MOVING + 2 * rows
    for part, direction in enumerate((toward, across)):
        polar = (direction[1:, :, None] * place).sum(1)
        by[part * count + image, turn], by[part * count + image, turn + 1] = -polar[:, 0], -polar[:, 1]
    by[2 * count + image - 1, turn] = 1.0
    return by


def ring_distances(rings: Rings) -> tuple[Array, Array]:
    """Mean and variance (R,) of the distance of every ring, matched over its hypotheses."""
    away = rings.mean[..., MOVING:] - rings.mean[..., :2]
    distance = np.maximum(np.sqrt((away * away).sum(-1)), 1e-6)
    slope = np.zeros((*distance.shape, MOVING + 2))
    np.divide(away, distance[..., None], out=slope[..., MOVING:])
    np.negative(slope[..., MOVING:], out=slope[..., :2])
    gain = (rings.covariance @ slope[..., None])[..., 0]
    spread = (gain * slope).sum(-1)
    mean = (rings.weight * distance).sum(-1)
    off = distance - mean[:, None]
    return mean, (rings.weight * (np.maximum(spread, 1e-12) + off * off)).sum(-1)


def update_state(state: DirectState, paths: AnchorPaths, found: FoundDistances) -> DirectState:
    """Update agent and settled images by the mode of their distances; rings follow (M80)."""
    before, mode = state.belief, found.mode
    reached, narrowed = weighed_by_presence(paths, mode, presence(state, paths, found))
    gain = np.linalg.solve(paths.covariance, paths.slope @ before.covariance).T
    mean = before.mean + gain @ (reached - paths.prior.mean[: paths.joint])
    covariance = before.covariance - gain @ (paths.covariance - narrowed) @ gain.T
    after = Belief(mean, symmetric(covariance))
    rings = follow(state.tentative.rings, before, after)
    return replace(state, belief=after, tentative=replace(state.tentative, rings=rings))


def presence(state: DirectState, paths: AnchorPaths, found: FoundDistances) -> Array:
    """How much (1 + S,) each path of the joint belief tells: the line of sight as much as it is there (M443).

    Its place is known, so that all that its mode says is of the agent. An image's path that is away mostly
    moves its own image. And two that cross stand in for each other: on top of the other neither is needed,
    though together they tell well.
    """
    matched, own = found.apart
    ratio = log_ratio(matched[:1], own[:1], state.links.intensity[[paths.anchor]])[0]
    chance = paths.prior.chances[0]
    odds = chance * float(np.exp(np.clip(ratio, -50.0, 50.0)))
    there = np.ones(paths.joint)
    there[0] = odds / (odds + 1 - chance)
    return there


def weighed_by_presence(paths: AnchorPaths, mode: Mode, there: Array) -> tuple[Array, Array]:
    """Distances (1 + S,) m and covariance of the joint belief, of paths that tell in part.

    A path that is away has a power that is expected on average, and its mode settles on noise (M443).

    Parameters
    ----------
    there : (1 + S,)
        How much each tells, see `presence`.
    """
    joint = paths.joint
    shift = mode.distance[:joint] - paths.prior.mean[:joint]
    precision, root = _inverse(paths.covariance), np.sqrt(there)
    gained = root[:, None] * (_inverse(mode.covariance[:joint, :joint]) - precision) * root
    covariance = _inverse(precision + gained)
    reached = paths.prior.mean[:joint] + covariance @ (there * (precision @ shift) + gained @ shift)
    return reached, covariance


def _inverse(matrix: Array) -> Array:
    return symmetric(np.asarray(np.linalg.inv(matrix), np.float64))
