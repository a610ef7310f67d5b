"""Messages of a snapshot to tentative images, and how these join the joint belief (M83), (M84)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array, put, replace
from gridslam.inference.beliefs.belief import give_birth
from gridslam.inference.messages.samples.distance_mode import BEHIND_M
from gridslam.inference.messages.samples.image_births import (
    LEAST_EXISTENCE,
    MOST_TENTATIVE,
    OWN_PLACE_M,
    FoundDistances,
)
from gridslam.inference.messages.samples.image_prediction import P_STAY, AnchorPaths
from gridslam.inference.messages.samples.signal_likelihood import pairs
from gridslam.inference.state.rings import (
    MOVING,
    SURE,
    Rings,
    agent_taken_in,
    follow,
    outer,
    ranks,
    symmetric,
)
from gridslam.inference.state.samples.images import DirectState, Images
from gridslam.world.filter_model import FilterModel

NODES = np.linspace(-4.0, 4.0, 41)
"""Where a hypothesis integrates the likelihood, in its deviations."""
NODE_WEIGHTS = np.exp(-0.5 * NODES**2) / np.exp(-0.5 * NODES**2).sum()
NORMAL = 1 / np.sqrt(2 * np.pi)
JOIN_BEARING_RAD, JOIN_RANGE_M = 0.15, 0.3
"""Deviations below which a ring is a straight arc, and joins if it is `SURE`."""
LEAST_WEIGHT = 1e-7
"""A hypothesis less likely than this within its ring is given up."""


def nodes() -> Array:
    """Where a hypothesis looks, and shares there, (I, 3); the kernel writes into the last column."""
    return np.column_stack([NODES, NODE_WEIGHTS, NODES])


def learn_rings(state: DirectState, paths: AnchorPaths, found: FoundDistances) -> DirectState:
    """Update existence and hypotheses of an anchor's rings by their likelihood ratios (M83).

    Every ring is judged as one more path on top of all others, which stand at their mode.
    """
    rows = paths.tentative
    if not len(rows):
        return state
    every, mode, table = state.tentative.rings, found.mode, found.table
    weight, existence = every.weight[rows], every.existence[rows]
    several = np.arange(paths.joint, paths.joint + len(rows))  # after those of the joint state
    points = len(table.self_power)
    limits = np.array([
        table.spacing_m, mode.distance[0], np.sqrt(BEHIND_M**2 + mode.variance[0]), P_STAY, NORMAL,
        2 * np.pi / points,
    ])  # fmt: skip
    mean, covariance = every.mean[rows], every.covariance[rows]
    log, there = np.full(weight.shape, -np.inf), np.zeros(weight.shape)
    runtime.start()
    from gridslam.kernels.messages.rings import weigh_rings

    weigh_rings(
        weight, state.tentative.intensity[rows], pairs(table.matched), table.self_power,
        pairs(found.inverse.taken_by(several)), limits, np.empty(points), nodes(), mean, covariance,
        log, there,
    )  # fmt: skip
    top = log.max(-1, keepdims=True)
    learned = weight * np.exp(log - top)
    evidence = learned.sum(-1)
    log_odds = np.log(existence / (1 - existence)) + np.log(evidence) + top[:, 0]
    learned = np.where(learned > LEAST_WEIGHT * evidence[:, None], learned, 0.0)
    rings = replace(
        every,
        existence=put(every.existence, rows, 1 / (1 + np.exp(-np.clip(log_odds, -16.0, 16.0)))),
        seen=put(every.seen, rows, every.seen[rows] + ((weight * there).sum(-1) > 0.5)),
        weight=put(every.weight, rows, learned / learned.sum(-1, keepdims=True)),
        mean=put(every.mean, rows, mean),
        covariance=put(every.covariance, rows, covariance),
    )
    return replace(state, tentative=replace(state.tentative, rings=rings))


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
    gap = place - anchor
    return np.asarray((gap * gap).sum(-1) > OWN_PLACE_M**2)


def prune(state: DirectState) -> DirectState:
    """Drop unlikely images and rings, and the least likely rings of an anchor beyond those that are kept."""
    state = state.keep(state.images.existence > LEAST_EXISTENCE)
    rings = state.tentative.rings
    stays = (rings.existence > LEAST_EXISTENCE) & (ranks(rings) < MOST_TENTATIVE)
    return state if stays.all() else replace(state, tentative=state.tentative.take(stays))


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


def join_straight_rings(state: DirectState) -> DirectState:
    """Rings that have shrunk to a short arc become settled images, correlated with the agent (M84)."""
    for row in _narrow(state.tentative.rings, state.belief.mean[:2])[::-1].tolist():
        origin = state.belief.mean[:2].copy()
        polar = _polar(state.tentative.rings, row, origin)
        deviation = np.sqrt(np.diag(polar.covariance)[MOVING:])
        if deviation[0] < JOIN_BEARING_RAD and deviation[1] < JOIN_RANGE_M:
            state = _joined(state, row, origin, polar)
    return state


def _narrow(rings: Rings, origin: Array) -> NDArray[np.intp]:
    """Sure rings whose hypotheses' bearings alone don't spread too far already."""
    away = rings.mean[..., MOVING:] - origin
    toward = away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-3)
    pull = np.linalg.norm(np.einsum("rk,rki->ri", rings.weight, toward), axis=-1)
    # 1 - |mean unit vector| is half the bearings' variance where that is small, and less where it isn't
    return np.flatnonzero((rings.existence > SURE) & (2 * (1 - pull) < JOIN_BEARING_RAD**2))


def _joined(state: DirectState, row: int, origin: Array, polar: _Polar) -> DirectState:
    """Give the joint belief what one ring knows: agent, image, and how they hang together."""
    before, tentative = state.belief, state.tentative
    belief, by_agent, spread = agent_taken_in(before, polar.mean, polar.covariance)
    by_state = np.zeros((2, len(belief.mean)))
    by_state[:, :MOVING] = by_agent
    value, vector = np.linalg.eigh(symmetric(spread))
    belief = give_birth(belief, polar.mean[MOVING:], by_state, vector, np.maximum(value, 1e-12))
    rings = tentative.rings
    fresh = Images(
        np.array([state.next_identity]), rings.anchor[[row]].astype(np.int64), origin[None],
        rings.existence[[row]], np.array([SURE]), tentative.intensity[[row]], tentative.heard[[row]],
        rings.age[[row]], np.full((1, 2), np.nan), np.zeros(1, np.int64),
    )  # fmt: skip
    rest = tentative.take(np.arange(len(tentative)) != row)
    rest = replace(rest, rings=follow(rest.rings, before, belief))
    return replace(
        state, belief=belief, images=state.images.joined(fresh), tentative=rest,
        next_identity=state.next_identity + 1,
    )  # fmt: skip
