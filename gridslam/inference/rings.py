"""Virtual anchors known by distance alone: each starts as a ring of hypotheses about its bearing.

A distance puts the image of an anchor on a circle about the agent, which no single Gaussian can hold, and on a
straight way two places, mirrored at the way, explain all distances equally well. So a tentative image is a
mixture beside the joint belief, one Gaussian per bearing; once the mixture has shrunk to one place, it joins
the belief. (The published method keeps particles instead: Leitinger et al., "A belief propagation algorithm
for multipath-based SLAM", IEEE Trans. Wireless Commun. 18(12), 2019, section VI.)

The agent's error lasts over many steps, and a hypothesis that took it for fresh noise at each would soon be
sure of a wrong bearing. Hence every hypothesis is a Gaussian of agent and image together, [x, y, vx, vy,
image x, image y]: what the agent would be like if the hypothesis were true. It takes in what the joint
belief learns of the agent, as information; the joint belief learns nothing from rings until they join.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import line_between, mirror_derivative, unit
from gridslam.inference.belief import AGENT, Belief, give_birth
from gridslam.inference.heard import Heard
from gridslam.inference.likelihood import DetectionTable, deviations
from gridslam.inference.rays import P_STAY
from gridslam.signal import REFLECTION_BINS, SignalModel

Array = NDArray[np.float64]
BEARINGS = 72
"""Hypotheses per ring, 5 degrees apart: at 20 m the arc of one departs by 2 cm from its tangent."""
OVERLAP = 0.6
"""Deviation of a hypothesis along the ring at birth, in spacings: their sum is flat within 1 %."""
MOST_RINGS = 16
"""Rings kept per anchor, the likeliest first."""
LEAST_EXISTENCE = 0.01
"""Existence below which a ring is dropped, or not begun."""
SHRUNK_M, SHRUNK_SHARE = 0.25, 0.1
"""A ring joins when its deviation is below both: metres, and a share of the image's distance to the anchor."""
THIN_M = 0.03
"""Deviation across the ring that it must be below, too: two places beside each other are thicker."""
SURE = 0.95
"""Existence that it must have then."""
JITTER_M = 0.001
"""Random walk of an image per step."""
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
        """The same with `other` in place of the rings `rows`."""
        columns = {f.name: getattr(self, f.name).copy() for f in fields(self)}
        for name, column in columns.items():
            column[rows] = getattr(other, name)
        return Rings(**columns)

    @property
    def matched(self) -> tuple[Array, Array]:
        """Mean (R, 6) and covariance (R, 6, 6) of every ring as one Gaussian."""
        mean = np.einsum("rk,rki->ri", self.weight, self.mean)
        off = self.mean - mean[:, None]
        return mean, np.einsum("rk,rkij->rij", self.weight, self.covariance + _outer(off, off))


def move(rings: Rings, dt: float, acceleration: float) -> Rings:
    """Move the agent of every hypothesis as `belief.predict` does; images stand still but for a jitter."""
    forward, noise = np.eye(MOVING + 2), np.zeros((MOVING + 2, MOVING + 2))
    forward[0, 2] = forward[1, 3] = dt
    push = acceleration * np.array([0.5 * dt**2, dt])
    for axis in range(2):
        entry = np.array([axis, axis + 2])
        noise[np.ix_(entry, entry)] = np.outer(push, push)
    noise[MOVING:, MOVING:] = JITTER_M**2 * np.eye(2)
    covariance = forward @ rings.covariance @ forward.T + noise
    return replace(rings, age=rings.age + 1, mean=rings.mean @ forward.T, covariance=covariance)


def follow(rings: Rings, before: Belief, after: Belief) -> Rings:
    """Take in what the joint belief learned of the agent, as the information by which it grew."""
    old, new = (b.covariance[:MOVING, :MOVING] for b in (before, after))
    if not len(rings) or before is after:
        return rings
    # in the frame where the old covariance is 1 and the new one diagonal
    root = np.linalg.cholesky(old)
    value, vector = np.linalg.eigh(np.linalg.inv(root) @ new @ np.linalg.inv(root).T)
    value, frame = np.maximum(value, 1e-6), np.linalg.inv(root).T @ vector
    shift = frame.T @ (after.mean[:MOVING] - before.mean[:MOVING])
    surer = value < 1
    information = frame * np.where(surer, 1 / value - 1, 0.0) @ frame.T
    push = frame @ np.where(surer, shift / value, 0.0)
    doubt = root @ vector * np.where(surer, 0.0, value - 1) @ vector.T @ root.T
    agent, prior = rings.mean[..., :MOVING] - before.mean[:MOVING], rings.covariance.copy()
    prior[..., :MOVING, :MOVING] += doubt
    both, own = prior[..., :MOVING], prior[..., :MOVING, :MOVING]
    inner = np.eye(MOVING) + information @ own
    pull = push - agent @ information
    solved = np.linalg.solve(inner, np.concatenate([np.broadcast_to(information, own.shape), pull[..., None]], -1))
    covariance = prior - both @ solved[..., :MOVING] @ np.swapaxes(both, -1, -2)
    step = (both @ solved[..., MOVING:])[..., 0]
    log = (
        (agent * push).sum(-1)
        - 0.5 * ((agent @ information) * agent).sum(-1)
        + 0.5 * (pull * step[..., :MOVING]).sum(-1)
        - 0.5 * np.log(np.linalg.det(inner))
    )
    return replace(
        rings, weight=_weighed(rings.weight, log), mean=rings.mean + step, covariance=_symmetric(covariance)
    )


@dataclass(frozen=True)
class Worth:
    """What measurements are worth to the rings of one anchor.

    Attributes
    ----------
    rows : (L,) int
        Rings of that anchor.
    ratio : (L, K, M)
        p_d f(z | hypothesis) / (mu_fa f_fa(z)).
    detection : (L,)
    gap : (L, K, M) m
        Measured minus predicted distance.
    spread, noise : (L, K) and (M,), m^2
        Variances of the predicted and of the measured distance.
    gain : (L, K, 6)
        Covariance of agent and image with the distance.
    """

    rows: NDArray[np.intp]
    ratio: Array
    detection: Array
    gap: Array
    spread: Array
    noise: Array
    gain: Array


def judge(rings: Rings, heard: Heard, table: DetectionTable, signal: SignalModel) -> Worth:
    """Evaluate the measurements that carry a distance and no AoA under every hypothesis."""
    rows = np.flatnonzero(rings.anchor == heard.anchor)
    mean, weight = rings.mean[rows], rings.weight[rows]
    away = mean[..., MOVING:] - mean[..., :2]
    distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-6)
    toward = away / distance[..., None]
    slope = np.concatenate([-toward, np.zeros_like(toward), toward], -1)
    gain = np.einsum("lkij,lkj->lki", rings.covariance[rows], slope)
    spread = (gain * slope).sum(-1)

    usable, deviation, loudness = _level(heard, signal)
    typical = table(signal.amplitude((weight * distance).sum(-1), 0.5))
    gap = np.where(usable, heard.value[:, 0], 0.0) - distance[..., None]
    noise = np.where(usable, deviation**2, 1.0)
    total = spread[..., None] + noise
    density = np.exp(-0.5 * gap**2 / total) / np.sqrt(2 * np.pi * total)
    silent = np.isnan(heard.amplitude)
    ratio = density * np.where(silent, typical[:, None, None], 1.0) * np.where(usable, loudness, 0.0)
    return Worth(rows, ratio, typical, gap, spread, noise, gain)


def _level(heard: Heard, signal: SignalModel) -> tuple[NDArray[np.bool_], Array, Array]:
    """Measurements that rings may explain; their deviation, m; amplitude's density over that of clutter, 1/m."""
    usable = ~np.isnan(heard.value[:, 0]) & np.isnan(heard.value[:, 2])
    distance = np.where(usable, heard.value[:, 0], 1.0)
    loud = ~np.isnan(heard.amplitude)
    strength = np.where(loud, heard.amplitude, signal.amplitude(distance, 0.5))
    said = np.exp(signal.log_rician(strength[:, None], signal.amplitude(distance[:, None], REFLECTION_BINS)))
    std = deviations(heard, np.arange(len(heard)), strength, np.nan_to_num(heard.value[:, 1:]), signal)[:, 0]
    clutter = np.log(signal.false_alarms) + signal.log_clutter(heard.amplitude) + 2 * np.log(2 * np.pi)
    return usable, std, np.where(loud, said.mean(1), 1.0) * np.exp(-clutter)


def claims(rings: Rings, worth: Worth) -> tuple[Array, Array]:
    """Messages of the rings to the association: (beta (L, M), missed (L,))."""
    chance = rings.existence[worth.rows] * P_STAY
    mean = np.einsum("lk,lkm->lm", rings.weight[worth.rows], worth.ratio)
    return chance[:, None] * mean, 1 - chance * worth.detection


def learn(rings: Rings, worth: Worth, nu: Array) -> Rings:
    """Update existence and hypotheses of one anchor's rings, moment-matched over the association.

    Parameters
    ----------
    nu : (L, M)
        Messages from the association.
    """
    old = rings.take(worth.rows)
    said = P_STAY * nu[:, None] * worth.ratio
    factor = said.sum(-1) + P_STAY * (1 - worth.detection)[:, None] + 1 - P_STAY
    mean = (old.weight * factor).sum(-1)
    heard = (old.weight * said.sum(-1)).sum(-1) / mean
    existence = old.existence * mean / (old.existence * mean + 1 - old.existence)
    # the gains of a hypothesis point the same way for all measurements and differ in size alone
    share, size = said / factor[..., None], 1 / (worth.spread[..., None] + worth.noise)
    step = (share * size * worth.gap).sum(-1)
    among = (share * (size * worth.gap) ** 2).sum(-1) - step**2
    narrower = (share * size).sum(-1) - among
    fresh = replace(
        old,
        existence=np.minimum(existence, 1 - 1e-7),
        seen=old.seen + (heard > 0.5),
        weight=_weighed(old.weight, np.log(factor)),
        mean=old.mean + step[..., None] * worth.gain,
        covariance=_symmetric(old.covariance - narrower[..., None, None] * _outer(worth.gain, worth.gain)),
    )
    return rings.put(worth.rows, fresh)


def expected(
    belief: Belief, heard: Heard, signal: SignalModel, births: float, middle: Array, radius_m: float
) -> tuple[Array, Array]:
    """How many new images each measurement tells of, over clutter, and how likely it makes every bearing.

    As for births with angles, surfaces are born uniformly over all lines that cross the region, `births` per
    anchor and step: uniform in angle and offset, so that an image at distance s from its anchor has density
    ``births / (4 pi radius s)`` per square metre.

    Returns
    -------
    (ratio, weight)
        ratio (M,): 0 where there is no distance, or an AoA with it; weight (M, K).
    """
    usable, _, loudness = _level(heard, signal)
    distance = np.where(usable, heard.value[:, 0], 0.0)
    image = belief.mean[:2] + distance[:, None, None] * unit(_bearings())
    line = line_between(heard.place, image)
    span = np.linalg.norm(image - heard.place, axis=-1)
    crosses = np.abs((unit(line[..., 0]) @ middle) - line[..., 1]) < radius_m
    nearer = np.linalg.norm(belief.mean[:2] - heard.place) < distance  # else the wall would stand between them
    density = crosses * nearer[:, None] / np.maximum(span, 0.1)
    common = births / (4 * np.pi * radius_m) * distance * 2 * np.pi * loudness
    ratio = np.where(usable, common * density.mean(-1), 0.0)
    return ratio, density / np.maximum(density.sum(-1, keepdims=True), 1e-300)


def begin(
    rings: Rings, belief: Belief, heard: Heard, signal: SignalModel, chance: Array, weight: Array
) -> Rings:
    """Add a ring for every measurement that is likely enough to be one.

    Parameters
    ----------
    chance : (M,)
        Probability that the measurement tells of a new image.
    weight : (M, K)
        Of the bearings.
    """
    rows = np.flatnonzero(chance > LEAST_EXISTENCE)
    distance, variance = heard.value[rows, 0, None], np.square(_level(heard, signal)[1][rows, None])
    toward = np.broadcast_to(unit(_bearings()), (len(rows), BEARINGS, 2))
    across = np.stack([-toward[..., 1], toward[..., 0]], -1)
    arc = np.square(OVERLAP * 2 * np.pi / BEARINGS * distance)[..., None, None]
    mean = np.zeros((len(rows), BEARINGS, MOVING + 2))
    mean[..., :MOVING] = belief.mean[:MOVING]
    mean[..., MOVING:] = belief.mean[:2] + distance[..., None] * toward
    entry = np.array([0, 1, 2, 3, 0, 1])  # the image shares the error of the agent's position
    covariance = np.broadcast_to(belief.covariance[np.ix_(entry, entry)], (*mean.shape, MOVING + 2)).copy()
    covariance[..., MOVING:, MOVING:] += variance[..., None, None] * _outer(toward, toward) + arc * _outer(across, across)
    age, seen = np.zeros(len(rows), np.int64), np.ones(len(rows), np.int64)
    anchor = np.full(len(rows), heard.anchor, np.intp)
    return rings.joined(Rings(anchor, chance[rows], age, seen, weight[rows], mean, covariance))


def prune(rings: Rings, survival: float) -> Rings:
    """Drop unlikely rings, and the least likely beyond `MOST_RINGS` per anchor."""
    existence = survival * rings.existence
    order = np.argsort(-existence, kind="stable")
    place = np.zeros(len(rings), np.intp)
    for anchor in np.unique(rings.anchor):
        own = order[rings.anchor[order] == anchor]
        place[own] = np.arange(len(own))
    return replace(rings, existence=existence).take((existence > LEAST_EXISTENCE) & (place < MOST_RINGS))


def shrunk(rings: Rings, places: Array) -> NDArray[np.intp]:
    """Rings that have shrunk to one place, the mirrored one gone, and surely exist."""
    if not len(rings):
        return np.zeros(0, np.intp)
    mean, covariance = rings.matched
    thickness, width = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[:, MOVING:, MOVING:]), 0)).T
    span = np.linalg.norm(mean[:, MOVING:] - places[rings.anchor], axis=-1)
    return np.flatnonzero((width < SHRUNK_M) & (width < SHRUNK_SHARE * span) & (thickness < THIN_M) & (rings.existence > SURE))


def join(rings: Rings, row: int, belief: Belief, place: Array) -> Belief:
    """Give the joint belief what one ring knows: agent, image, and how they hang together.

    Parameters
    ----------
    place : (2,) m
        The ring's anchor; the line between it and the image is appended.
    """
    mean, covariance = (part[0] for part in rings.take(np.array([row])).matched)
    agent, image = slice(0, MOVING), slice(MOVING, None)
    # the rest of the state follows the agent, to which alone the ring refers
    lean = np.linalg.solve(belief.covariance[agent, agent], belief.covariance[agent]).T
    changed = covariance[agent, agent] - belief.covariance[agent, agent]
    belief = Belief(
        belief.mean + lean @ (mean[agent] - belief.mean[agent]),
        _symmetric(belief.covariance + lean @ changed @ lean.T),
    )
    line = line_between(place, mean[image])
    by_image = np.linalg.inv(mirror_derivative(line, place))
    by_agent = np.linalg.solve(covariance[agent, agent], covariance[agent, image]).T
    by_state = np.zeros((2, len(belief.mean)))
    by_state[:, agent] = by_image @ by_agent
    value, vector = np.linalg.eigh(covariance[image, image] - by_agent @ covariance[agent, image])
    return give_birth(belief, line, by_state, by_image @ vector, np.maximum(value, 0.0))


def _bearings() -> Array:
    return 2 * np.pi / BEARINGS * np.arange(BEARINGS)


def _weighed(weight: Array, log: Array) -> Array:
    """Weights (R, K) times exp(log), normalised."""
    scaled = weight * np.exp(log - log.max(-1, keepdims=True, initial=-np.inf))
    return np.asarray(scaled / scaled.sum(-1, keepdims=True))


def _outer(left: Array, right: Array) -> Array:
    return left[..., :, None] * right[..., None, :]


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
