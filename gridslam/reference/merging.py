"""Twins of the kernels that find duplicates and ghosts among surfaces: all of them at once, as arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.layout import AGENT, StateLayout
from gridslam.world.geometry import mirror, mirror_derivative, unit, wrap

Whole = NDArray[np.int64]
SURE, REPLACES, SHARP_M = 0.9, 10, 0.1
"""Existence, detections and deviation of the offset from which on a surface may take another's place."""
OFTENER = 2
"""How many times as often as the ghost each of the two was seen: a ghost goes silent when they are found."""
SEEN_ELSEWHERE = 0.3
"""Existence of another anchor's ray at which a surface isn't a ghost."""
NEAR_M, SLACK_M, GATE = 0.5, 0.02, 9.0
"""Gap of the virtual anchors that is looked at; what is always allowed; squared in deviations."""
AROUND_M, THROUGH_M, CROSSING = 1.0, 0.15, 0.2
"""Silent surface through a corner: gap of virtual anchors, distance from it, sine of the corner's angle."""


def find_duplicates(
    mean: Array, covariance: Array, head: int, foot: Array, owner: Whole, apart: NDArray[np.uint8]
) -> tuple[int, int, Array, Array] | None:
    """Twin of `merging.duplicate`: older, younger, derivative (2, N) and residual; None for none."""
    line, lines = StateLayout.of_view(len(mean), head - AGENT).line, mean[head:].reshape(-1, 2)
    turns = wrap(lines[None, :, 0] - lines[:, None, 0])
    flips = np.where(np.abs(turns) > np.pi / 2, -1.0, 1.0)  # the same line written with the opposite normal
    turns = wrap(turns + np.where(flips < 0, np.pi, 0.0))
    normals = unit(lines[:, 0])
    tangents = np.stack([-normals[:, 1], normals[:, 0]], -1)
    places = lines[:, 1:] * normals + foot[:, None] * tangents
    gaps = flips * (places @ normals.T - lines[:, 1])
    near = (np.abs(turns) <= 0.5) & (np.abs(gaps) <= 0.5) & (owner[:, None] == owner) & (apart.T == 0)
    for younger in range(len(lines) - 1, 0, -1):
        normal, tangent, place = normals[younger], tangents[younger], places[younger]
        for older in np.flatnonzero(near[younger, :younger]).tolist():
            turn, flip, gap = turns[younger, older], flips[younger, older], gaps[younger, older]
            other = normals[older]
            # derivative of (gap at the place, turn); the place itself moves with the younger line
            jacobian = np.zeros((2, len(mean)))
            o, y = line(older), line(younger)
            side = np.array([-other[1], other[0]])
            jacobian[0, o] = flip * np.array([place @ side, -1.0])
            by_turn = lines[younger, 1] * tangent - foot[younger] * normal
            jacobian[0, y] = [flip * (other @ by_turn), flip * (normal @ other)]
            jacobian[1, o[0]], jacobian[1, y[0]] = 1.0, -1.0
            residual = -np.array([gap, turn])
            spread = jacobian @ covariance @ jacobian.T + np.diag([1e-4, 2.5e-5])
            if residual @ np.linalg.solve(spread, residual) < 9.0:
                return older, younger, jacobian, residual
    return None


def find_ghosts(
    mean: Array, covariance: Array, head: int, surface: Array, seen: Whole, age: Array, single: Array,
    places: Array, least: float,
) -> NDArray[np.bool_]:  # fmt: skip
    """Twin of `merging.find_ghosts`: which surfaces are ghosts, (S,)."""
    variance = covariance[head + 1 :: 2, head + 1 :: 2].diagonal()
    sure = np.flatnonzero((surface > SURE) & (seen >= REPLACES) & (variance < SHARP_M**2))
    last, first = (a.ravel() for a in np.meshgrid(sure, sure, indexing="ij"))
    last, first = last[last != first], first[last != first]
    if not len(last):
        return np.zeros(len(surface), dtype=bool)
    lines, good = mean[head:].reshape(-1, 2), np.ones(len(surface), dtype=bool)
    surer = np.minimum(surface[last], surface[first]) > surface[:, None]
    silent, own = single[: len(places)].max(0) < SEEN_ELSEWHERE, OFTENER * seen[:, None]
    younger = age[:, None] > np.minimum(age[last], age[first])
    for one in (last, first):
        younger &= seen[one] * age[:, None] > own * age[one]
    surer &= (np.minimum(seen[last], seen[first]) > least * seen[:, None]) | (younger & silent[:, None])
    if not surer.any():
        return ~good
    through = _through_corners(lines, last, first)
    at = places[:, None]
    gap = mirror(lines, at)[:, :, None] - mirror(lines[last], mirror(lines[first], at))[:, None]
    far = np.hypot(gap[..., 0], gap[..., 1])  # (J, S, H)
    # heard loosely, it lies between what AoA and AoD of the double bounce would have it
    good &= ~(surer & (far < AROUND_M) & through & silent[:, None]).any((0, 2))
    for anchor, ghost, pair in np.argwhere(surer & (far < NEAR_M)).tolist():
        if np.delete(single[:, ghost], anchor).max(initial=0.0) >= SEEN_ELSEWHERE:
            continue
        spread = _spread(mean, covariance, head, places[anchor], ghost, int(last[pair]), int(first[pair]))
        sharp = np.trace(spread) < NEAR_M**2
        here = gap[anchor, ghost, pair]
        if sharp and here @ np.linalg.solve(spread + SLACK_M**2 * np.eye(2), here) < GATE:
            good[ghost] = False
    return ~good


def _through_corners(lines: Array, last: NDArray[np.intp], first: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether lines (S,) pass through the corners of pairs (H,) of other lines, (S, H)."""
    normals = unit(lines[:, 0])
    one, other = normals[last], normals[first]
    sine = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    safe = np.where(np.abs(sine) > CROSSING, sine, np.inf)
    a, b = lines[last, 1], lines[first, 1]
    corner = np.stack([a * other[:, 1] - b * one[:, 1], b * one[:, 0] - a * other[:, 0]], -1) / safe[:, None]
    return np.asarray((np.abs(normals @ corner.T - lines[:, 1:]) < THROUGH_M) & (np.abs(sine) > CROSSING))


def _spread(
    mean: Array, covariance: Array, head: int, place: Array, single: int, last: int, first: int
) -> Array:
    """Covariance of the gap between the virtual anchors of a single and a double bounce, (2, 2)."""
    line = StateLayout.of_view(len(mean), head - AGENT).line
    lines, jacobian = mean[head:].reshape(-1, 2), np.zeros((2, len(mean)))
    normal, image = unit(lines[last, 0]), mirror(lines[first], place)
    turned = np.eye(2) - 2 * np.outer(normal, normal)
    jacobian[:, line(single)] += mirror_derivative(lines[single], place)
    jacobian[:, line(last)] -= mirror_derivative(lines[last], image)
    jacobian[:, line(first)] -= turned @ mirror_derivative(lines[first], place)
    return jacobian @ covariance @ jacobian.T
