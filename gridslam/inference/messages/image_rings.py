"""Messages of a snapshot to tentative images, and how these join the joint belief (M83), (M84)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.messages.distance_mode import Mode, PathPrior
from gridslam.inference.messages.image_births import LEAST_EXISTENCE, MOST_TENTATIVE, OWN_PLACE_M
from gridslam.inference.messages.image_prediction import P_STAY, AnchorPaths, hypothesis_distances
from gridslam.inference.messages.signal_likelihood import Band, Sweep, sweep
from gridslam.inference.state.belief import Belief, give_birth
from gridslam.inference.state.images import DirectState, Images
from gridslam.inference.state.rings import MOVING, Rings, follow, outer, symmetric
from gridslam.world.filter_model import FilterModel

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
NODES = np.linspace(-4.0, 4.0, 41)
"""Where a hypothesis integrates the likelihood, in its deviations."""
NODE_WEIGHTS = np.exp(-0.5 * NODES**2) / np.exp(-0.5 * NODES**2).sum()
JOIN_BEARING_RAD, JOIN_RANGE_M, SURE = 0.15, 0.3, 0.95
"""Deviations below which a ring is a straight arc, and the existence that it must have to join."""


def leave_one_out(band: Band, samples: Complex, prior: PathPrior, mode: Mode, noise: float) -> Sweep:
    """Tables (N, G) of each path as if it were one more on top of all others.

    The others stand at their mode, broadened by their variance: an error of 1 cm would else leave -24 dB of a
    strong path to be explained.
    """
    size = len(mode.distance)
    others = np.broadcast_to(prior.weight, (size, size)) * ~np.eye(size, dtype=bool)
    covariance = noise * np.eye(len(band)) + band.broadened(
        others, np.broadcast_to(mode.distance, (size, size)), np.broadcast_to(mode.variance, (size, size))
    )
    return sweep(band, samples, np.linalg.inv(covariance).astype(np.complex128))


def learn_rings(state: DirectState, paths: AnchorPaths, tables: Sweep) -> DirectState:
    """Update existence and hypotheses of an anchor's rings by their likelihood ratios (M83).

    Parameters
    ----------
    tables : Sweep
        Of `leave_one_out`; the rings' rows follow those of the joint state.
    """
    rows = paths.tentative
    if not len(rows):
        return state
    own = state.tentative.take(rows)
    rings = own.rings
    several = np.arange(paths.joint, paths.joint + len(rows))
    logs = Sweep(tables.spacing_m, tables.matched_power[several], tables.self_power[several]).log_ratio(
        own.intensity[:, None]
    )
    distance, spread, gain = hypothesis_distances(rings)
    level, moved, left = _integrate(logs, tables.spacing_m, distance, np.sqrt(spread))
    # the path may have gone for now
    log_there = np.log(P_STAY) + level
    log_factor = np.logaddexp(log_there, np.log1p(-P_STAY))
    there = np.exp(log_there - log_factor)
    step, narrower = there * moved, spread - there * left - there * (1 - there) * moved**2
    narrower = narrower - (1 - there) * spread
    weight = np.log(np.maximum(rings.weight, 1e-300)) + log_factor
    top = weight.max(-1, keepdims=True)
    evidence = np.exp(weight - top).sum(-1)
    log_odds = np.log(rings.existence / (1 - rings.existence)) + np.log(evidence) + top[:, 0]
    scaled = gain / spread[..., None]
    fresh = replace(
        rings,
        existence=1 / (1 + np.exp(-np.clip(log_odds, -16.0, 16.0))),
        seen=rings.seen + ((rings.weight * there).sum(-1) > 0.5),
        weight=np.exp(weight - top) / evidence[:, None],
        mean=rings.mean + step[..., None] * scaled,
        covariance=symmetric(rings.covariance - narrower[..., None, None] * outer(scaled, scaled)),
    )
    return replace(state, tentative=replace(state.tentative, rings=state.tentative.rings.put(rows, fresh)))


def _integrate(logs: Array, spacing: float, distance: Array, deviation: Array) -> tuple[Array, Array, Array]:
    """Log mean of exp(logs) over each N(distance, deviation^2); the product's shift and variance.

    Parameters
    ----------
    logs : (R, G)
        Periodic tables.
    distance, deviation : (R, K) m
    """
    points = logs.shape[1]
    at = (distance[..., None] + deviation[..., None] * NODES) / spacing
    low = np.floor(at)
    share = at - low
    first = low.astype(np.int64) % points
    row = points * np.arange(len(logs))[:, None, None]
    flat = logs.reshape(-1)
    value = (1 - share) * flat[row + first] + share * flat[row + (first + 1) % points]
    top = value.max(-1, keepdims=True)
    mass = NODE_WEIGHTS * np.exp(value - top)
    whole = mass.sum(-1)
    mean = (mass @ NODES) / whole
    second = (mass @ NODES**2) / whole
    shift = deviation * mean
    return np.log(whole) + top[..., 0], shift, deviation**2 * np.maximum(second - mean**2, 1e-6)


def forbid_own_place(state: DirectState, model: FilterModel) -> DirectState:
    """An image at its anchor is the line of sight itself: such hypotheses and images go."""
    rings = state.tentative.rings
    if len(rings):
        far = _apart(rings.mean[..., MOVING:], model.anchor_positions[rings.anchor][:, None])
        weight = rings.weight * far
        whole = weight.sum(-1)
        some = whole > 1e-12
        weight = weight[some] / whole[some, None]
        state = replace(state, tentative=state.tentative.take(some))
        rings = replace(state.tentative.rings, weight=weight)
        state = replace(state, tentative=replace(state.tentative, rings=rings))
    return state.keep(_apart(state.places, model.anchor_positions[state.images.anchor]))


def _apart(place: Array, anchor: Array) -> NDArray[np.bool_]:
    return np.asarray(np.linalg.norm(place - anchor, axis=-1) > OWN_PLACE_M)


def prune_tentative(state: DirectState) -> DirectState:
    """Drop unlikely images and rings, and the least likely rings of an anchor beyond those that are kept."""
    state = state.keep(state.images.existence > LEAST_EXISTENCE)
    rings = state.tentative.rings
    order = np.argsort(-rings.existence, kind="stable")
    place = np.zeros(len(rings), np.intp)
    for anchor in np.unique(rings.anchor):
        own = order[rings.anchor[order] == anchor]
        place[own] = np.arange(len(own))
    stays = (rings.existence > LEAST_EXISTENCE) & (place < MOST_TENTATIVE)
    return replace(state, tentative=state.tentative.take(stays))


@dataclass(frozen=True, eq=False)
class _Polar:
    """A ring as one Gaussian of [agent (4), bearing, range] about a place."""

    mean: Array
    covariance: Array


def _polar(rings: Rings, row: int, origin: Array) -> _Polar:
    """Match a ring's hypotheses in polar coordinates, where its arc is straight."""
    weight, mean, covariance = rings.weight[row], rings.mean[row], rings.covariance[row]
    away = mean[:, MOVING:] - origin
    span = np.maximum(np.linalg.norm(away, axis=-1), 1e-3)
    toward = away / span[:, None]
    pull = weight @ toward
    middle = np.arctan2(pull[1], pull[0])
    turned = np.arctan2(toward[:, 1], toward[:, 0]) - middle
    bearing = middle + np.remainder(turned + np.pi, 2 * np.pi) - np.pi
    slope = np.zeros((len(weight), MOVING + 2, MOVING + 2))
    slope[:, range(MOVING), range(MOVING)] = 1.0
    slope[:, MOVING, MOVING:] = np.stack([-toward[:, 1], toward[:, 0]], -1) / span[:, None]
    slope[:, MOVING + 1, MOVING:] = toward
    each = np.concatenate([mean[:, :MOVING], bearing[:, None], span[:, None]], -1)
    matched = weight @ each
    off = each - matched
    own = slope @ covariance @ np.swapaxes(slope, 1, 2)
    return _Polar(matched, np.einsum("k,kij->ij", weight, own + outer(off, off)))


def join_straight_rings(state: DirectState, model: FilterModel) -> DirectState:
    """Rings that have shrunk to a short arc become settled images, correlated with the agent (M84)."""
    for row in np.flatnonzero(state.tentative.rings.existence > SURE)[::-1].tolist():
        origin = state.belief.mean[:2].copy()
        polar = _polar(state.tentative.rings, row, origin)
        deviation = np.sqrt(np.diag(polar.covariance)[MOVING:])
        if deviation[0] < JOIN_BEARING_RAD and deviation[1] < JOIN_RANGE_M:
            state = _joined(state, row, origin, polar)
    return state


def _joined(state: DirectState, row: int, origin: Array, polar: _Polar) -> DirectState:
    """Give the joint belief what one ring knows: agent, image, and how they hang together."""
    before, tentative = state.belief, state.tentative
    agent, image = slice(0, MOVING), slice(MOVING, None)
    own = before.covariance[agent, agent]
    lean = np.linalg.solve(own, before.covariance[agent]).T  # the rest follows the agent
    belief = Belief(
        before.mean + lean @ (polar.mean[agent] - before.mean[agent]),
        symmetric(before.covariance + lean @ (polar.covariance[agent, agent] - own) @ lean.T),
    )
    by_agent = np.linalg.solve(polar.covariance[agent, agent], polar.covariance[agent, image]).T
    by_state = np.zeros((2, len(belief.mean)))
    by_state[:, agent] = by_agent
    value, vector = np.linalg.eigh(
        symmetric(polar.covariance[image, image] - by_agent @ polar.covariance[agent, image])
    )
    belief = give_birth(belief, polar.mean[image], by_state, vector, np.maximum(value, 1e-12))
    rings = tentative.rings
    fresh = Images(
        np.array([state.next_identity]), rings.anchor[[row]].astype(np.int64), origin[None],
        rings.existence[[row]], np.array([SURE]), tentative.intensity[[row]], tentative.heard[[row]],
        rings.age[[row]], np.full((1, 2), np.nan),
    )  # fmt: skip
    rest = tentative.take(np.arange(len(tentative)) != row)
    rest = replace(rest, rings=follow(rest.rings, before, belief))
    return replace(
        state, belief=belief, images=state.images.joined(fresh), tentative=rest,
        next_identity=state.next_identity + 1,
    )  # fmt: skip
