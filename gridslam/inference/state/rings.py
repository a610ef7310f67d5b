"""Virtual anchors known by distance alone: each starts as a ring of hypotheses about its bearing.

A distance puts the image of an anchor on a circle about the agent, which no single Gaussian can hold, and on
a straight way two places, mirrored at the way, explain all distances equally well. So a tentative image is a
mixture beside the joint belief, one Gaussian per bearing; once it has shrunk to one place, it joins. (The
published method, [Leitinger2019bp], keeps particles of each image instead.)

The agent's error lasts over many steps, and a hypothesis that took it for fresh noise at each would soon be
sure of a wrong bearing. Hence every hypothesis is a Gaussian of agent and image together, [x, y, vx, vy,
image x, image y]: what the agent would be like if the hypothesis were true. It takes in what the joint
belief learns of the agent, as information; the joint belief learns nothing from rings until they join.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief, diagonal_together, give_birth
from gridslam.world.geometry import line_between, mirror_derivative, slant, unit
from gridslam.world.radio import RadioModel

BEARINGS = 72
"""Hypotheses per ring, 5 degrees apart: at 20 m the arc of one departs by 2 cm from its tangent."""
MOST_RINGS = 16
"""Rings kept per anchor, the likeliest first."""
LEAST_EXISTENCE = 0.01
"""Existence below which a ring is dropped, or not begun."""
SHRUNK_M, SHRUNK_SHARE = 0.25, 0.1
"""A ring joins when its deviation is below both: metres, and a share of image's distance to anchor."""
THIN = 0.3
"""Deviation across the ring that it must be below, too, in those of a measurement: two places are thicker."""
SURE = 0.95
"""Existence that it must have then."""
JITTER_M = 0.001
"""Random walk of an image per step."""
OVERLAP = 0.6
"""Deviation of a hypothesis along the ring at birth, in spacings: their sum is flat within 1 %."""
MOVING = 4
"""Entries of the agent in a hypothesis."""


@dataclass(frozen=True)
class Rings:
    """Tentative images of anchors: R rings of K hypotheses.

    Attributes
    ----------
    anchor : (R,) int
    existence : (R,) float64
    age, seen : (R,) int
        Steps since birth, steps with a detection.
    weight : (R, K) float64
        Probability of each hypothesis; rows sum to 1.
    mean : (R, K, 6) float64
        Agent and image, if the hypothesis is true.
    covariance : (R, K, 6, 6) float64
    """

    anchor: NDArray[np.intp]
    existence: Array
    age: NDArray[np.int64]
    seen: NDArray[np.int64]
    weight: Array
    mean: Array
    covariance: Array

    def __len__(self) -> int:
        return len(self.anchor)

    @classmethod
    def empty(cls) -> Rings:
        """No rings."""
        whole, size = np.zeros(0, np.int64), MOVING + 2
        return cls(
            np.zeros(0, np.intp), np.zeros(0), whole, whole, np.zeros((0, BEARINGS)),
            np.zeros((0, BEARINGS, size)), np.zeros((0, BEARINGS, size, size)),
        )  # fmt: skip

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Rings:
        """Some of the rings."""
        return Rings(*(getattr(self, f.name)[rows] for f in fields(self)))

    def joined(self, other: Rings) -> Rings:
        """These rings and then the others."""
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))
        return Rings(*(np.concatenate(pair) for pair in pairs))

    def put(self, rows: NDArray[np.intp], other: Rings) -> Rings:
        """The rings with `other` in place of `rows`."""
        columns = {f.name: getattr(self, f.name).copy() for f in fields(self)}
        for name, column in columns.items():
            column[rows] = getattr(other, name)
        return Rings(**columns)

    @property
    def matched(self) -> tuple[Array, Array]:
        """Mean (R, 6) and covariance (R, 6, 6) of every ring as one Gaussian."""
        mean = np.einsum("rk,rki->ri", self.weight, self.mean)
        off = self.mean - mean[:, None]
        return mean, np.einsum("rk,rkij->rij", self.weight, self.covariance + outer(off, off))


def directions() -> Array:
    """Unit vectors from the agent to the hypotheses of a ring, (K, 2)."""
    return unit(np.asarray(2 * np.pi / BEARINGS * np.arange(BEARINGS), np.float64))


def rings_about(
    belief: Belief, anchor: int, distance: Array, variance: Array, existence: Array, weight: Array
) -> Rings:
    """Rings (n) about the agent: of new images, whose hypotheses share the error of its position.

    Parameters
    ----------
    distance, variance : (n,) m, m^2
        Of every image as seen from above.
    existence : (n,)
    weight : (n, K)
        Of the bearings.
    """
    count, far = len(distance), distance[:, None]
    toward = np.broadcast_to(directions(), (count, BEARINGS, 2))
    across = np.stack([-toward[..., 1], toward[..., 0]], -1)
    arc = np.square(OVERLAP * 2 * np.pi / BEARINGS * far)[..., None, None]
    mean = np.zeros((count, BEARINGS, MOVING + 2))
    mean[..., :MOVING] = belief.mean[:MOVING]
    mean[..., MOVING:] = belief.mean[:2] + far[..., None] * toward
    entry = np.array([0, 1, 2, 3, 0, 1])
    covariance = np.broadcast_to(belief.covariance[np.ix_(entry, entry)], (*mean.shape, MOVING + 2)).copy()
    covariance[..., MOVING:, MOVING:] += variance[:, None, None, None] * outer(toward, toward) + arc * outer(
        across, across
    )
    anchors, age = np.full(count, anchor, np.intp), np.zeros(count, np.int64)
    return Rings(anchors, existence, age, age + 1, weight, mean, covariance)


def move(rings: Rings, dt: float, acceleration: float) -> Rings:
    """Move the agent of every hypothesis as `belief.predict` does; images stand still but for a jitter."""
    forward, noise = np.eye(MOVING + 2), np.zeros((MOVING + 2, MOVING + 2))
    forward[0, 2] = forward[1, 3] = dt
    for axis in range(2):
        noise[axis:MOVING:2, axis:MOVING:2] = pushed(dt, acceleration)
    noise[MOVING:, MOVING:] = JITTER_M**2 * np.eye(2)
    live = rings.weight > 0
    mean, covariance = rings.mean.copy(), rings.covariance.copy()
    mean[live] = rings.mean[live] @ forward.T
    covariance[live] = forward @ rings.covariance[live] @ forward.T + noise
    return replace(rings, age=rings.age + 1, mean=mean, covariance=covariance)


def pushed(dt: float, acceleration: float) -> Array:
    """Covariance (2, 2) that white acceleration gives place and velocity of one axis, (M16)."""
    push = acceleration * np.array([0.5 * dt**2, dt])
    return np.outer(push, push)


def follow(rings: Rings, before: Belief, after: Belief) -> Rings:
    """Take in what the joint belief learned of the agent, as the information by which it grew.

    Hypotheses of weight 0 are left as they are.
    """
    old, new = (b.covariance[:MOVING, :MOVING] for b in (before, after))
    same = np.array_equal(old, new) and np.array_equal(before.mean[:MOVING], after.mean[:MOVING])
    if not len(rings) or same:
        return rings
    # in the frame where the old covariance is 1 and the new one diagonal
    value, frame = diagonal_together(new, old)
    value, spread = np.maximum(value, 1e-6), old @ frame
    shift = frame.T @ (after.mean[:MOVING] - before.mean[:MOVING])
    surer = value < 1
    learned = np.concatenate([
        before.mean[:MOVING, None], (frame @ np.where(surer, shift / value, 0.0))[:, None],
        frame * np.sqrt(np.where(surer, 1 / value - 1, 0.0)),
        spread * np.where(surer, 0.0, value - 1) @ spread.T,
    ], 1)  # fmt: skip
    mean, covariance = rings.mean.copy(), rings.covariance.copy()
    log = np.full(rings.weight.shape, -np.inf)
    runtime.start()
    from gridslam.kernels.messages.rings import follow_rings

    follow_rings(rings.weight, learned, mean, covariance, log)
    return replace(rings, weight=weighed(rings.weight, log), mean=mean, covariance=covariance)


def prune(rings: Rings, survival: float) -> Rings:
    """Drop unlikely rings, and the least likely beyond `MOST_RINGS` per anchor."""
    rings = replace(rings, existence=survival * rings.existence)
    return rings.take((rings.existence > LEAST_EXISTENCE) & (ranks(rings) < MOST_RINGS))


def ranks(rings: Rings) -> NDArray[np.intp]:
    """How many rings of the same anchor are likelier than each, (R,)."""
    order = np.argsort(-rings.existence, kind="stable")
    place = np.zeros(len(rings), np.intp)
    for anchor in np.unique(rings.anchor):
        own = order[rings.anchor[order] == anchor]
        place[own] = np.arange(len(own))
    return place


def shrunk(rings: Rings, anchors: Array, radio: RadioModel) -> NDArray[np.intp]:
    """Rings that have shrunk to one place, the mirrored one gone, and surely exist.

    `anchors` (J, 6) is `FilterModel.places`.
    """
    if not len(rings):
        return np.zeros(0, np.intp)
    mean, covariance = rings.matched
    thickness, width = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[:, MOVING:, MOVING:]), 0)).T
    level = np.linalg.norm(mean[:, MOVING:] - mean[:, :2], axis=-1)
    distance = slant(level, anchors[rings.anchor, 3])
    thin = THIN * radio.distance_std(radio.amplitude(distance, 0.5)) * distance / np.maximum(level, 1e-6)
    span = np.linalg.norm(mean[:, MOVING:] - anchors[rings.anchor, :2], axis=-1)
    return np.flatnonzero(
        (width < SHRUNK_M) & (width < SHRUNK_SHARE * span) & (thickness < thin) & (rings.existence > SURE)
    )


def join(rings: Rings, row: int, belief: Belief, place: Array) -> Belief:
    """Give the joint belief what one ring knows: agent, image, and how they hang together.

    Parameters
    ----------
    place : (2,) m
        The ring's anchor; the line between it and the image is appended.
    """
    mean, covariance = (part[0] for part in rings.take(np.array([row])).matched)
    belief, by_agent, spread = agent_taken_in(belief, mean, covariance)
    line = line_between(place, mean[MOVING:])
    by_image = np.linalg.inv(mirror_derivative(line, place))
    by_state = np.zeros((2, len(belief.mean)))
    by_state[:, :MOVING] = by_image @ by_agent
    value, vector = np.linalg.eigh(spread)
    return give_birth(belief, line, by_state, by_image @ vector, np.maximum(value, 0.0))


def agent_taken_in(belief: Belief, mean: Array, covariance: Array) -> tuple[Belief, Array, Array]:
    """What a ring as one Gaussian knows of the agent, taken in by the joint belief.

    Parameters
    ----------
    mean, covariance : (6,), (6, 6)
        Agent and image, that in any two coordinates.

    Returns
    -------
    (belief, by_agent, spread)
        by_agent (2, 4): slopes of the image by the agent; spread (2, 2): its covariance, given the agent.
    """
    agent, image = slice(0, MOVING), slice(MOVING, None)
    # the rest of the state follows the agent, to which alone the ring refers
    lean = np.linalg.solve(belief.covariance[agent, agent], belief.covariance[agent]).T
    changed = covariance[agent, agent] - belief.covariance[agent, agent]
    belief = Belief(
        belief.mean + lean @ (mean[agent] - belief.mean[agent]),
        symmetric(belief.covariance + lean @ changed @ lean.T),
    )
    by_agent = np.asarray(np.linalg.solve(covariance[agent, agent], covariance[agent, image]).T, float)
    return belief, by_agent, covariance[image, image] - by_agent @ covariance[agent, image]


def weighed(weight: Array, log: Array) -> Array:
    """Weights (R, K) times exp(log), normalised."""
    scaled = weight * np.exp(log - log.max(-1, keepdims=True, initial=-np.inf))
    return np.asarray(scaled / scaled.sum(-1, keepdims=True))


def outer(left: Array, right: Array) -> Array:
    """Outer products of vectors (..., N)."""
    return left[..., :, None] * right[..., None, :]


def symmetric(matrix: Array) -> Array:
    """The symmetric part: rounding leaves a little of the other."""
    return 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
