"""Messages between rings (tentative virtual anchors) and measurements of distance alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.amplitudes import DetectionTable, detection_table
from gridslam.inference.messages.association import Association
from gridslam.inference.messages.exact_association import associate_exactly
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.deviations import deviations
from gridslam.inference.state.rays import P_STAY
from gridslam.inference.state.rings import (
    LEAST_EXISTENCE,
    MOVING,
    Rings,
    directions,
    follow,
    join,
    move,
    outer,
    prune,
    rings_about,
    shrunk,
    symmetric,
    weighed,
)
from gridslam.inference.state.state import State
from gridslam.kernels.primitives.tables import AOA, AOD
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import level_of, line_between, slant, unit
from gridslam.world.radio import REFLECTION_BINS, RadioModel

APART = 2.0
"""Deviations by which a distance must exceed that of the anchor itself before it may begin a ring."""


@dataclass(frozen=True)
class Tentative:
    """What an association leaves to rings, and to measurements that may begin some.

    Attributes
    ----------
    nu : (R, M)
        Messages to the rings of the anchor.
    chance : (M,)
        Probability that a measurement comes from a new image.
    bearings : (M, K)
        Likelihood of every bearing, if so.
    """

    nu: Array
    chance: Array
    bearings: Array


def move_rings(state: State, time_s: float, model: FilterModel) -> State:
    """Motion of the agent of every hypothesis."""
    if state.time_s is None:
        return state
    elapsed = time_s - state.time_s
    return replace(state, rings=move(require(state), elapsed, model.settings.acceleration_mps2))


def of_arrivals(scan: AnchorScan) -> AnchorScan:
    """The scan without departures of what has no arrival, of which a ring begins instead of a surface."""
    deaf = scan.measured[:, AOD] & ~scan.measured[:, AOA]
    return scan.without_departures(deaf) if deaf.any() else scan


def associate_with_rings(
    state: State, scan: AnchorScan, ratios: LikelihoodRatios, radio: RadioModel, model: FilterModel
) -> tuple[Association, Tentative]:
    """Data association of virtual anchors and rings alike."""
    rings = require(state)
    worth = judge(rings, scan, detection_table(model.radio), radio)
    tentative, silent = claims(rings, worth)
    born, bearings = expected(state.belief, scan, radio, model.settings.births, model.middle, model.radius_m)
    nu, claimed = associate_exactly(
        np.concatenate([ratios.beta, tentative]), np.concatenate([ratios.missed, silent]), ratios.new + born
    )
    paths, new = len(ratios.beta), ratios.new + born
    given = Association(nu[:paths], claimed, new, tentative, silent, nu[paths:])
    return given, Tentative(nu[paths:], born / (new + claimed), bearings)


def update_rings(
    before: State,
    state: State,
    scan: AnchorScan,
    tentative: Tentative,
    radio: RadioModel,
    model: FilterModel,
) -> State:
    """Rings follow the belief's update by an anchor's measurements, are updated themselves, and begin; (M45).

    Parameters
    ----------
    before : State
        Before the belief's update; `state` is after it.
    scan : AnchorScan
        M measurements of the anchor.
    tentative : Tentative
        What `associate_with_rings` left of them.
    radio : RadioModel
        As the anchor's radio seemed to be then.
    """
    state = follow_belief(before, state)
    rings = require(state)
    worth = judge(rings, scan, detection_table(model.radio), radio)
    rings = learn(rings, worth, tentative.nu)
    fresh = begin(rings, state.belief, scan, radio, tentative.chance, tentative.bearings)
    return replace(state, rings=fresh)


def follow_belief(before: State, state: State) -> State:
    """The rings follow the belief's changes."""
    return replace(state, rings=follow(require(state), before.belief, state.belief))


def join_shrunk_rings(state: State, radio: RadioModel, model: FilterModel) -> State:
    """Rings that have shrunk to a place become virtual anchors."""
    for row in shrunk(require(state), model.places, radio)[::-1].tolist():
        rings = require(state)
        ring = rings.take(np.array([row]))
        anchor = int(ring.anchor[0])
        belief = join(rings, row, state.belief, model.anchor_positions[anchor])
        surfaces = state.surfaces.add(
            state.next_identity,
            float(ring.existence[0]),
            np.full(len(REFLECTION_BINS), 1 / len(REFLECTION_BINS)),
            float(belief.mean[:2] @ unit(belief.lines[-1, 0] + 0.5 * np.pi)),
            (anchor, -1, -1),
            anchor,
            int(ring.age[0]),
            int(ring.seen[0]),
        )
        rings = follow(rings, state.belief, belief).take(np.arange(len(rings)) != row)
        state = replace(
            state, belief=belief, surfaces=surfaces, rings=rings, next_identity=state.next_identity + 1
        )
    return state


def prune_rings(state: State, model: FilterModel) -> State:
    """Drop unlikely rings."""
    return replace(state, rings=prune(require(state), model.settings.survival))


def require(state: State) -> Rings:
    """Rings of a system that keeps some.

    Raises
    ------
    ValueError
        This system keeps none.
    """
    if state.rings is None:
        raise ValueError("this state has no rings")
    return state.rings


@dataclass(frozen=True)
class Worth:
    """Likelihoods of an anchor's measurements under its rings.

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


def judge(rings: Rings, scan: AnchorScan, table: DetectionTable, radio: RadioModel) -> Worth:
    """Evaluate the measurements that carry a distance and no AoA under every hypothesis."""
    rows = np.flatnonzero(rings.anchor == scan.anchor)
    mean, weight = rings.mean[rows], rings.weight[rows]
    away = mean[..., MOVING:] - mean[..., :2]
    level = np.maximum(np.linalg.norm(away, axis=-1), 1e-6)
    distance = slant(level, scan.height)
    toward = away / level[..., None] * (level / distance)[..., None]
    slope = np.concatenate([-toward, np.zeros_like(toward), toward], -1)
    gain = np.einsum("lkij,lkj->lki", rings.covariance[rows], slope)
    spread = (gain * slope).sum(-1)

    usable, deviation, loudness = _level(scan, radio)
    typical = table(radio.amplitude((weight * distance).sum(-1), 0.5))
    gap = np.where(usable, scan.value[:, 0], 0.0) - distance[..., None]
    noise = np.where(usable, deviation**2, 1.0)
    total = spread[..., None] + noise
    density = np.exp(-0.5 * gap**2 / total) / np.sqrt(2 * np.pi * total)
    silent = np.isnan(scan.amplitude)
    ratio = density * np.where(silent, typical[:, None, None], 1.0) * np.where(usable, loudness, 0.0)
    return Worth(rows, ratio, typical, gap, spread, noise, gain)


def _level(scan: AnchorScan, radio: RadioModel) -> tuple[NDArray[np.bool_], Array, Array]:
    """Which measurements rings may explain; their deviations (m); clutter's share of their ratios (1/m)."""
    usable = ~np.isnan(scan.value[:, 0]) & np.isnan(scan.value[:, 2])
    distance = np.where(usable, scan.value[:, 0], 1.0)
    loud = ~np.isnan(scan.amplitude)
    strength = np.where(loud, scan.amplitude, radio.amplitude(distance, 0.5))
    density = np.exp(radio.log_rician(strength[:, None], radio.amplitude(distance[:, None], REFLECTION_BINS)))
    std = deviations(scan, np.arange(len(scan)), strength, np.nan_to_num(scan.value[:, 1:]), radio)[:, 0]
    clutter = np.log(radio.false_alarms) + radio.log_clutter(scan.amplitude) + 2 * np.log(2 * np.pi)
    return usable, std, np.where(loud, density.mean(1), 1.0) * np.exp(-clutter)


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
    joint = P_STAY * nu[:, None] * worth.ratio
    factor = joint.sum(-1) + P_STAY * (1 - worth.detection)[:, None] + 1 - P_STAY
    mean = (old.weight * factor).sum(-1)
    measured = (old.weight * joint.sum(-1)).sum(-1) / mean
    existence = old.existence * mean / (old.existence * mean + 1 - old.existence)
    # the gains of a hypothesis point the same way for all measurements and differ in size alone
    share, size = joint / factor[..., None], 1 / (worth.spread[..., None] + worth.noise)
    step = (share * size * worth.gap).sum(-1)
    among = (share * (size * worth.gap) ** 2).sum(-1) - step**2
    narrower = (share * size).sum(-1) - among
    fresh = replace(
        old,
        existence=np.minimum(existence, 1 - 1e-7),
        seen=old.seen + (measured > 0.5),
        weight=weighed(old.weight, np.log(factor)),
        mean=old.mean + step[..., None] * worth.gain,
        covariance=symmetric(old.covariance - narrower[..., None, None] * outer(worth.gain, worth.gain)),
    )
    return rings.put(worth.rows, fresh)


def expected(
    belief: Belief, scan: AnchorScan, radio: RadioModel, births: float, middle: Array, radius_m: float
) -> tuple[Array, Array]:
    """Expected number of new images per measurement, over clutter, and likelihood of every bearing.

    As for births with angles, surfaces are born uniformly over all lines that cross the circle about the
    region, `births` per anchor and step: uniform in angle and offset, so that an image at distance s from
    its anchor has density ``births / (4 pi radius s)`` per square metre.

    Returns
    -------
    (ratio, weight)
        ratio (M,): 0 where there is no distance, or an AoA with it; weight (M, K).
    """
    usable, deviation, loudness = _level(scan, radio)
    distance = np.where(usable, scan.value[:, 0], 0.0)
    image = belief.mean[:2] + level_of(distance, scan.height)[:, None, None] * directions()
    line = line_between(scan.position, image)
    span = np.linalg.norm(image - scan.position, axis=-1)
    crosses = np.abs((unit(line[..., 0]) @ middle) - line[..., 1]) < radius_m
    # no image is nearer than its anchor, and one that is hardly farther looks the same
    doubt = np.where(usable, deviation, 0.0) ** 2 + np.trace(belief.covariance[:2, :2])
    itself = slant(np.hypot(*(belief.mean[:2] - scan.position)), scan.height)
    nearer = itself + APART * np.sqrt(doubt) < distance
    density = crosses * nearer[:, None] / np.maximum(span, 0.1)
    common = births / (4 * np.pi * radius_m) * distance * 2 * np.pi * loudness
    ratio = np.where(usable, common * density.mean(-1), 0.0)
    return ratio, density / np.maximum(density.sum(-1, keepdims=True), 1e-300)


def begin(
    rings: Rings, belief: Belief, scan: AnchorScan, radio: RadioModel, chance: Array, weight: Array
) -> Rings:
    """Add a ring for every measurement that is likely enough to be one.

    Parameters
    ----------
    chance : (M,)
        Probability that the measurement comes from a new image.
    weight : (M, K)
        Of the bearings.
    """
    rows = np.flatnonzero(chance > LEAST_EXISTENCE)
    length = scan.value[rows, 0]
    distance = np.maximum(level_of(length, scan.height), 1e-6)
    deviation = _level(scan, radio)[1][rows] * length / distance
    fresh = rings_about(belief, scan.anchor, distance, np.square(deviation), chance[rows], weight[rows])
    return rings.joined(fresh)
