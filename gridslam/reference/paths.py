"""Twins of the kernels that evaluate and draw paths: images and arc tangents, double precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.layout import AGENT, HEADING, POSE
from gridslam.world.geometry import trace, wrap

Whole = NDArray[np.int32]
RISE = 5
"""Column of anchors: which rise is theirs; below 0 none, and -1 where clocks may be unknown."""


def lines_of(state: Array, head: int = AGENT) -> Array:
    """Lines (angle, offset) of states ``[3 + 3 S + J, P]``, (S, P, 2)."""
    lines = state[3 : len(state) - (head - AGENT)]
    return np.stack([np.arctan2(lines[1::3], lines[::3]), lines[2::3]], -1).astype(np.float64)


def densities(
    state: Array, head: int, path: Whole, places: Array, start: Whole, pair: Array, block: int
) -> tuple[Array, Array]:
    """Twin of `paths.densities`: sums of densities and counts of valid particles, by blocks.

    Parameters
    ----------
    state : (3 + 3 S (+ J), P)
        Particles, as `draw` makes them.
    head : int
        Entry of the belief where the lines begin.
    path : (L, 4)
        Bounces, surfaces hit last and first, anchor.
    places : (J, 6)
        As `blocks.Anchors` has them.
    start : (L + 1,)
        Where the pairs of each path begin.
    pair : (K, 9 or more)
        Measured value (3), and inverse covariance: its diagonal (3), then entries 01, 02 and 12.
    block : int
        Particles in a block, of which P is a multiple.

    Returns
    -------
    (weight, valid)
        (K, P / block), (L, P / block)
    """
    particles = state.shape[1]
    blocks = particles // block
    weight, valid = np.zeros((start[-1], blocks)), np.zeros((len(path), blocks))
    clocks, lines = head - AGENT, lines_of(state, head)
    surfaces = lines if len(lines) else np.zeros((1, particles, 2))
    position = np.asarray(state[:2].T, np.float64)
    for row, (bounces, last, first, number) in enumerate(path):
        place, rise = places[number], int(places[number, RISE])
        own, height = len(state) - clocks + (number if rise < 0 else rise), place[3]
        if clocks and rise >= 0:
            height = place[4] + np.asarray(state[own], np.float64)
        drawn = trace(
            position, np.broadcast_to(place[:2], (particles, 2)), surfaces[max(last, 0)],
            surfaces[max(first, 0)], np.full(particles, bounces), height,
        )  # fmt: skip
        possible = drawn.valid.astype(np.float64)
        valid[row] = possible.reshape(blocks, block).sum(1)
        late = state[own] if clocks and rise == -1 else 0.0
        seen = np.stack([drawn.distance + late, drawn.departure - place[2], drawn.arrival - state[2]], -1)
        for n in range(start[row], start[row + 1]):
            gap = pair[n, :3] - seen
            gap[:, 1:] = wrap(gap[:, 1:])
            i00, i11, i22, i01, i02, i12 = pair[n, 3:9]
            inverse = np.array([[i00, i01, i02], [i01, i11, i12], [i02, i12, i22]], np.float64)
            density = possible * np.exp(-0.5 * np.einsum("pi,ij,pj->p", gap, inverse, gap))
            weight[n] = density.reshape(blocks, block).sum(1)
    return weight, valid


def draw(root: Array, base: Array, points: Array, head: int = AGENT) -> Array:
    """Twin of `particles.draw_block`: states (3 + 3 S + J, P) of ``base + root points``."""
    states = base[:, :1].astype(np.float64) + root.astype(np.float64) @ points[: len(root)]
    surfaces = (len(states) - head) // 2
    lines = states[head:].reshape(surfaces, 2, states.shape[1])
    bent = np.stack([np.cos(lines[:, 0]), np.sin(lines[:, 0]), lines[:, 1]], 1)
    flat = bent.reshape(3 * surfaces, states.shape[1])
    return np.concatenate([states[POSE], flat, states[AGENT:head]])


def prepare(
    mean: Array, covariance: Array, head: int, share: float, points: Array
) -> tuple[Array, Array, Array, Array]:
    """Twin of `particles.ready`: root of the covariance, share of it, base, and samples' states."""
    whole: Array = np.linalg.cholesky(covariance).astype(np.float64)
    base: Array = np.stack([mean, np.cos(mean), np.sin(mean)], -1)
    return whole, share * whole, base, draw(whole, base, points, head)


def polylines(state: Array, path: Whole, places: Array) -> tuple[Array, Array]:
    """Twin of `paths.polylines`: corners (L, R, 4, 2) of possible paths, and which are, (L, R)."""
    agent, states = state[:2], state.shape[1]
    corners, valid = np.zeros((len(path), states, 4, 2)), np.zeros((len(path), states))
    surfaces = np.concatenate([lines_of(state), np.zeros((1, states, 2))])  # the last is no surface
    for row, (bounces, last, first, source) in enumerate(path):
        anchor = np.broadcast_to(places[source, :2], (states, 2))
        drawn = trace(agent.T, anchor, surfaces[last], surfaces[first], np.full(states, bounces))
        corners[row], corners[row, :, 0] = agent.T[:, None], anchor
        if bounces == 1:
            corners[row, :, 1] = drawn.last_point
        if bounces == 2:
            corners[row, :, 1], corners[row, :, 2] = drawn.first_point, drawn.last_point
        corners[row] = np.where(drawn.valid[:, None, None], corners[row], anchor[:, None])
        valid[row] = drawn.valid
    return corners, valid


def trace_paths(head: int, mean: Array, root: Array, spot: Array, path: Whole) -> tuple[Array, Array]:
    """Twin of `state_paths.trace_paths`: values (L, 3), and derivatives (L, 3, N) through a root."""
    count, rows = len(path), np.arange(len(path))
    lines = mean[head:].reshape(-1, 2)
    lines = lines if len(lines) else np.zeros((1, 2))
    bounces, last, first = path[:, 0].astype(np.intp), np.maximum(path[:, 1], 0), np.maximum(path[:, 2], 0)
    agent, anchor = np.broadcast_to(mean[:2], (count, 2)), np.broadcast_to(spot[:2], (count, 2))
    drawn = trace(agent, anchor, lines[last], lines[first], bounces, spot[4])
    departure, arrival = wrap(drawn.departure - spot[2]), wrap(drawn.arrival - mean[HEADING])
    value = np.column_stack([drawn.distance + spot[3], departure, arrival])
    slope = np.zeros((count, 3, len(mean)))
    slope[:, :, :2], slope[:, :, HEADING] = drawn.jacobian[:, :, :2], drawn.jacobian[:, :, 2]
    for column, surface, hit in ((3, last, bounces > 0), (5, first, bounces > 1)):
        for side in range(2):
            own = rows[hit]
            slope[own, :, head + 2 * surface[hit] + side] += drawn.jacobian[own, :, column + side]
    return value, slope @ root
