"""Virtual anchors known by distance alone: each starts as a ring of hypotheses about its bearing.

A distance puts the image of an anchor on a circle about the agent, which no single Gaussian can hold, and on a
straight way two places, mirrored at the way, explain all distances equally well. So a tentative image is a
mixture of small Gaussians, one per bearing, beside the joint belief; once the mixture has shrunk to one place,
it joins the belief. (The published method keeps particles instead: Leitinger et al., "A belief propagation
algorithm for multipath-based SLAM", IEEE Trans. Wireless Commun. 18(12), 2019, section VI.)

What is known of an image was learned from uncertain places of the agent. Every hypothesis keeps that
correlation, as the regression of its image on the joint state: image = mean + lean (state - its mean) + rest.
A measurement of the state moves the image by the lean; a measurement of the image leaves the state alone until
the image has joined (a Schmidt-Kalman filter), by which the covariance stays honest though the agent's errors
last over many steps.
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
"""Hypotheses per ring, 5 degrees apart: at 20 m an arc of one departs by 2 cm from its tangent."""
OVERLAP = 0.6
"""Deviation of a hypothesis along the ring at birth, in spacings: their sum is flat within 1 %."""
MOST_RINGS = 16
"""Rings kept per anchor, the likeliest first."""
LEAST_EXISTENCE = 0.01
"""Existence below which a ring is dropped, or not begun."""
SHRUNK_M, SHRUNK_SHARE = 0.3, 0.1
"""A ring joins the belief when its deviation is below both: metres, and a share of its distance to the anchor."""
SURE = 0.95
"""Existence that it must have then."""
JITTER_M = 0.001
"""Random walk of an image per step."""


@dataclass(frozen=True)
class Rings:
    """Tentative images of anchors: R rings of K hypotheses, beside a joint state of N entries.

    Attributes
    ----------
    anchor : (R,) int
    existence : (R,) float64
    age, seen : (R,) int
        Steps since birth, steps with a detection.
    weight : (R, K) float64
        Probability of each hypothesis; rows sum to 1.
    image : (R, K, 2) float64, m
        Mean position of the image.
    lean : (R, K, 2, N) float64
        Regression of the image on the joint state.
    rest : (R, K, 2, 2) float64, m^2
        Covariance of what the regression leaves over.
    """

    anchor: NDArray[np.intp]
    existence: Array
    age: NDArray[np.int64]
    seen: NDArray[np.int64]
    weight: Array
    image: Array
    lean: Array
    rest: Array

    def __len__(self) -> int:
        return len(self.anchor)

    @classmethod
    def empty(cls) -> Rings:
        """No rings, beside an agent alone."""
        none, whole = np.zeros(0), np.zeros(0, np.int64)
        return cls(
            np.zeros(0, np.intp), none, whole, whole, np.zeros((0, BEARINGS)), np.zeros((0, BEARINGS, 2)),
            np.zeros((0, BEARINGS, 2, AGENT)), np.zeros((0, BEARINGS, 2, 2)),
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


def move(rings: Rings, before: Belief, after: Belief, dt: float) -> Rings:
    """Follow the state's prediction over `dt`; the images themselves stand still but for a jitter."""
    forward = np.eye(len(before.mean))
    forward[0, 2] = forward[1, 3] = dt
    both = rings.lean @ before.covariance  # covariance of image and state
    own = both @ np.swapaxes(rings.lean, -1, -2) + rings.rest + JITTER_M**2 * np.eye(2)
    both = both @ forward.T
    lean = _divided(both, after.covariance)
    rest = own - both @ np.swapaxes(lean, -1, -2)
    return replace(rings, age=rings.age + 1, lean=lean, rest=_symmetric(rest))


def follow(
    rings: Rings, before: Belief, known: NDArray[np.int64], after: Belief, now: NDArray[np.int64]
) -> Rings:
    """Follow a belief that was updated by others, lost surfaces, or got new ones.

    Parameters
    ----------
    known, now : (S,) int
        Identities of the surfaces in `before` and in `after`, in the order of their lines.
    """
    stays = np.concatenate([np.ones(AGENT, bool), np.repeat(np.isin(known, now), 2)])
    lean = rings.lean
    if not stays.all():
        both = lean @ before.covariance
        kept = _divided(both[..., stays], before.covariance[np.ix_(stays, stays)])
        lost = both @ np.swapaxes(lean, -1, -2) - both[..., stays] @ np.swapaxes(kept, -1, -2)
        rings, lean = replace(rings, rest=_symmetric(rings.rest + lost)), kept
    size = lean.shape[-1]
    lean = np.concatenate([lean, np.zeros((*lean.shape[:-1], len(after.mean) - size))], -1)
    change = after.mean[:size] - before.mean[stays]
    change[4] = 0.0  # distances say nothing of the heading, which may have wrapped
    return replace(rings, lean=lean, image=rings.image + lean[..., :size] @ change)


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
    gap, spread : (L, K, M) m and (L, K) m^2
        Measured minus predicted distance, and the variance of the predicted one.
    noise : (M,) m^2
    slope : (L, K, N)
        Derivative of the distance by the joint state, through agent and lean.
    gain : (L, K, 2)
        Covariance of image and distance.
    toward : (L, K, 2)
        Unit vector from the agent to the image.
    """

    rows: NDArray[np.intp]
    ratio: Array
    detection: Array
    gap: Array
    spread: Array
    noise: Array
    slope: Array
    gain: Array
    toward: Array


def judge(rings: Rings, belief: Belief, heard: Heard, table: DetectionTable, signal: SignalModel) -> Worth:
    """Evaluate the measurements that carry a distance and no AoA under every hypothesis."""
    rows = np.flatnonzero(rings.anchor == heard.anchor)
    lean, rest = rings.lean[rows], rings.rest[rows]
    away = rings.image[rows] - belief.mean[:2]
    distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-6)
    toward = away / distance[..., None]
    slope = np.einsum("lki,lkin->lkn", toward, lean)
    slope[..., :2] -= toward
    through = slope @ belief.covariance
    own = np.einsum("lkij,lkj->lki", rest, toward)
    spread = (through * slope).sum(-1) + (own * toward).sum(-1)
    gain = np.einsum("lkin,lkn->lki", lean, through) + own

    usable, deviation, loudness = _level(heard, signal)
    typical = table(signal.amplitude((rings.weight[rows] * distance).sum(-1), 0.5))
    gap = np.where(usable, heard.value[:, 0], 0.0) - distance[..., None]
    noise = np.where(usable, deviation**2, 1.0)
    total = spread[..., None] + noise
    density = np.exp(-0.5 * gap**2 / total) / np.sqrt(2 * np.pi * total)
    silent = np.isnan(heard.amplitude)
    ratio = density * np.where(silent, typical[:, None, None], 1.0) * np.where(usable, loudness, 0.0)
    return Worth(rows, ratio, typical, gap, spread, noise, slope, gain, toward)


def _level(heard: Heard, signal: SignalModel) -> tuple[NDArray[np.bool_], Array, Array]:
    """Which measurements rings may explain; their deviation (m); amplitude's density over that of clutter (1/m)."""
    usable = ~np.isnan(heard.value[:, 0]) & np.isnan(heard.value[:, 2])
    distance = np.where(usable, heard.value[:, 0], 1.0)
    loud = ~np.isnan(heard.amplitude)
    level = signal.amplitude(distance[:, None], REFLECTION_BINS)
    strength = np.where(loud, heard.amplitude, signal.amplitude(distance, 0.5))
    said = np.exp(signal.log_rician(strength[:, None], level)).mean(1)
    std = deviations(heard, np.arange(len(heard)), strength, np.nan_to_num(heard.value[:, 1:]), signal)[:, 0]
    clutter = np.log(signal.false_alarms) + signal.log_clutter(heard.amplitude) + 2 * np.log(2 * np.pi)
    return usable, std, np.where(loud, said, 1.0) * np.exp(-clutter)


def claims(rings: Rings, worth: Worth) -> tuple[Array, Array]:
    """Messages of the rings to the association: (beta (L, M), missed (L,))."""
    chance = rings.existence[worth.rows] * P_STAY
    mean = np.einsum("lk,lkm->lm", rings.weight[worth.rows], worth.ratio)
    return chance[:, None] * mean, 1 - chance * worth.detection


def learn(rings: Rings, worth: Worth, nu: Array) -> Rings:
    """Update existence, bearings and images of one anchor's rings, moment-matched over the association.

    Parameters
    ----------
    nu : (L, M)
        Messages from the association.
    """
    old = rings.take(worth.rows)
    said = nu[:, None] * worth.ratio
    silent = (1 - worth.detection)[:, None]
    factor = said.sum(-1) + silent
    mean = (old.weight * factor).sum(-1)
    ahead = P_STAY * mean + 1 - P_STAY
    existence = old.existence * ahead / (old.existence * ahead + 1 - old.existence)
    heard = (old.weight * said.sum(-1)).sum(-1) / mean
    weight = old.weight * (P_STAY * factor + 1 - P_STAY) / ahead[:, None]

    # all gains of a hypothesis point the same way: only their sizes differ between the measurements
    share = P_STAY * said / (P_STAY * factor + 1 - P_STAY)[..., None]
    size = 1 / (worth.spread[..., None] + worth.noise)
    first, second = (share * size).sum(-1), (share * size**2).sum(-1)
    step = (share * size * worth.gap).sum(-1)
    among = (share * (size * worth.gap) ** 2).sum(-1) - step**2
    loud = (share * size**2 * worth.noise).sum(-1)
    own = np.einsum("lkij,lkj->lki", old.rest, worth.toward)
    inner = (own * worth.toward).sum(-1)
    square = worth.gain[..., :, None] * worth.gain[..., None, :]
    cross = worth.gain[..., :, None] * own[..., None, :]
    grown = second * inner + loud + among + (second - first**2) * (worth.spread - inner)
    rest = old.rest - first[..., None, None] * (cross + np.swapaxes(cross, -1, -2))
    fresh = replace(
        old,
        existence=np.minimum(existence, 1 - 1e-7),
        seen=old.seen + (heard > 0.5),
        weight=weight / weight.sum(-1, keepdims=True),
        image=old.image + step[..., None] * worth.gain,
        lean=old.lean - first[..., None, None] * worth.gain[..., None] * worth.slope[..., None, :],
        rest=_symmetric(rest + grown[..., None, None] * square),
    )
    return rings.put(worth.rows, fresh)


def expected(belief: Belief, heard: Heard, signal: SignalModel, births: float, middle: Array, radius_m: float) -> tuple[Array, Array]:
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


def begin(rings: Rings, belief: Belief, heard: Heard, signal: SignalModel, chance: Array, weight: Array) -> Rings:
    """Add a ring for every measurement that is one with probability `chance` (M,), bearings by `weight` (M, K)."""
    rows = np.flatnonzero(chance > LEAST_EXISTENCE)
    distance, variance = heard.value[rows, 0, None], np.square(_level(heard, signal)[1][rows, None])
    toward = np.broadcast_to(unit(_bearings()), (len(rows), BEARINGS, 2))
    across = np.stack([-toward[..., 1], toward[..., 0]], -1)
    arc = np.square(OVERLAP * 2 * np.pi / BEARINGS * distance)
    lean = np.zeros((len(rows), BEARINGS, 2, len(belief.mean)))
    lean[..., 0, 0] = lean[..., 1, 1] = 1.0
    outer = [v[..., None, None] * u[..., :, None] * u[..., None, :] for v, u in ((variance, toward), (arc, across))]
    return rings.joined(
        Rings(
            np.full(len(rows), heard.anchor, np.intp),
            chance[rows],
            np.zeros(len(rows), np.int64),
            np.ones(len(rows), np.int64),
            weight[rows],
            belief.mean[:2] + distance[..., None] * toward,
            lean,
            outer[0] + outer[1],
        )
    )


def prune(rings: Rings, survival: float) -> Rings:
    """Drop unlikely rings, and the least likely beyond `MOST_RINGS` per anchor."""
    existence = survival * rings.existence
    order = np.argsort(-existence, kind="stable")
    place = np.zeros(len(rings), np.intp)
    for anchor in np.unique(rings.anchor):
        own = order[rings.anchor[order] == anchor]
        place[own] = np.arange(len(own))
    return replace(rings, existence=existence).take((existence > LEAST_EXISTENCE) & (place < MOST_RINGS))


def shrunk(rings: Rings, belief: Belief, places: Array) -> NDArray[np.intp]:
    """Rings that have shrunk to one place, the mirrored way included, and surely exist."""
    image, _, lean, rest = _matched(rings)
    total = lean @ belief.covariance @ np.swapaxes(lean, -1, -2) + rest
    width = np.sqrt(np.linalg.eigvalsh(total)[:, -1]) if len(rings) else np.zeros(0)
    span = np.linalg.norm(image - places[rings.anchor], axis=-1)
    return np.flatnonzero((width < SHRUNK_M) & (width < SHRUNK_SHARE * span) & (rings.existence > SURE))


def join(rings: Rings, row: int, belief: Belief, place: Array) -> Belief:
    """Append the line between anchor `place` and the image of one ring, as correlated as the ring is."""
    image, _, lean, rest = (part[0] for part in _matched(rings.take(np.array([row]))))
    line = line_between(place, image)
    by_image = np.linalg.inv(mirror_derivative(line, place))
    value, vector = np.linalg.eigh(rest)
    return give_birth(belief, line, by_image @ lean, by_image @ vector, np.maximum(value, 0.0))


def _matched(rings: Rings) -> tuple[Array, Array, Array, Array]:
    """Mean, weight, lean and rest of every ring as one Gaussian."""
    weight = rings.weight
    image = np.einsum("rk,rki->ri", weight, rings.image)
    lean = np.einsum("rk,rkin->rin", weight, rings.lean)
    off = rings.image - image[:, None]
    rest = np.einsum("rk,rkij->rij", weight, rings.rest + off[..., :, None] * off[..., None, :])
    return image, weight.sum(-1), lean, rest


def _bearings() -> Array:
    return 2 * np.pi / BEARINGS * np.arange(BEARINGS)


def _divided(both: Array, covariance: Array) -> Array:
    """`both` (..., N) times the inverse of a covariance (N, N)."""
    return np.swapaxes(np.linalg.solve(covariance, both.reshape(-1, len(covariance)).T), 0, 1).reshape(both.shape)


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + np.swapaxes(matrix, -1, -2))
