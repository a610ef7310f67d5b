"""Twins of the kernels that linearise: Jacobians spelled out, and a general update."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief, update
from gridslam.inference.beliefs.layout import AGENT, HEADING, POSE, StateLayout
from gridslam.world.geometry import trace, wrap

Whole = NDArray[np.int32]
RISE = 5
UNLIKELY, UNMOVED = 1e-3, 1e-6


def late(mean: Array, head: int, anchors: Whole | int, places: Array) -> Array:
    """By how much clocks lengthen the distances of anchors, m."""
    differences, known = mean[AGENT:head], np.zeros(np.shape(anchors))
    return np.where(places[anchors, RISE] >= 0, 0.0, differences[anchors]) if clocked(head, places) else known


def clocked(head: int, places: Array) -> bool:
    """Whether what stands between pose and lines are clocks."""
    return head > AGENT and bool((places[:, RISE] == -1).all())


def tall(mean: Array, head: int, anchors: Whole | int, places: Array) -> Array:
    """How high anchors stand above the agent, m: as told, and a rise on top where there is one."""
    rise = places[anchors, RISE].astype(np.intp)
    own = np.append(mean[AGENT:head], 0.0)
    return np.where((rise >= 0) & (head > AGENT), places[anchors, 4] + own[rise], places[anchors, 3])


def predict(
    mean: Array, covariance: Array, head: int, path: Whole, places: Array
) -> tuple[Array, Array, Array]:
    """Twin of `gaussian.predict`: values (L, 3), Jacobians (L, 3, N) and covariances (L, 3, 3)."""
    layout = StateLayout.of_view(len(mean), head - AGENT)
    count, lines = len(path), np.concatenate([mean[layout.lines].reshape(-1, 2), np.zeros((1, 2))])
    bounces, last, first, source = path.T.astype(np.intp)
    place = places[source]
    drawn = trace(
        np.tile(mean[:2], (count, 1)),
        place[:, :2],
        lines[last],
        lines[first],
        bounces,
        tall(mean, head, source, places),
    )
    far, bearing = drawn.distance + late(mean, head, source, places), drawn.arrival - mean[HEADING]
    value = np.stack([far, wrap(drawn.departure - place[:, 2]), wrap(bearing)], -1)
    slope = np.zeros((count, 3, len(mean)))
    slope[:, :, POSE] = drawn.jacobian[:, :, :3]
    if clocked(head, places):
        slope[np.arange(count), 0, AGENT + source] = 1.0
    elif layout.clocks:
        rise = place[:, RISE].astype(np.intp)
        by = tall(mean, head, source, places) / drawn.distance
        slope[np.arange(count), 0, AGENT + rise] = np.where(rise >= 0, by, 0.0)
    for row in range(count):
        if bounces[row] > 0:
            slope[row][:, layout.line(last[row])] += drawn.jacobian[row, :, 3:5]
        if bounces[row] == 2:
            slope[row][:, layout.line(first[row])] += drawn.jacobian[row, :, 5:7]
    return value, slope, slope @ covariance @ slope.transpose(0, 2, 1)


def of_length(slope: Array, covariance: Array, head: int, places: Array) -> tuple[Array, Array]:
    """Variance of lengths, and their covariance with distances of slope (L, N)."""
    own = slope.copy()
    if clocked(head, places):
        own[:, AGENT:head] = 0.0
    pushed = own @ covariance
    return (pushed * own).sum(1), (pushed * slope).sum(1)


def bend(mean: Array, covariance: Array, place: Array, height: float) -> tuple[Array, Array]:
    """Twin of `gaussian.bend_of`: by the second derivatives of length and angles by x and y, (2, 2) each."""
    away = mean[:2] - place[:2]
    level = np.linalg.norm(away)
    if level == 0:
        return np.zeros(3), np.zeros((3, 3))
    length, (x, y), width = np.hypot(level, height), away / level, np.sqrt(covariance[:2, :2].trace())
    by_length = (np.eye(2) - np.outer(away, away) / length**2) / max(length, width)
    by_angle = np.array([[2 * x * y, y * y - x * x], [y * y - x * x, -2 * x * y]]) / max(level, width) ** 2
    each = [hessian @ covariance[:2, :2] for hessian in (by_length, by_angle, by_angle)]
    return (
        0.5 * np.array([np.trace(one) for one in each]),
        0.5 * np.array([[np.trace(one @ other) for other in each] for one in each]),
    )


def bend_of_bounce(
    mean: Array, covariance: Array, line: NDArray[np.intp], place: Array, height: float
) -> tuple[Array, Array]:
    """Twin of `gaussian.bend_of_bounce`: second derivatives by x, y and the line, (4, 4) each."""
    angle, offset = mean[line]
    n, t = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    gap, along = offset - n @ place[:2], t @ place[:2]
    away = place[:2] + 2 * gap * n - mean[:2]  # from the agent to the anchor's image
    first = np.column_stack([-np.eye(2), 2 * gap * t - 2 * along * n, 2 * n])
    twice = np.zeros((2, 4, 4))
    twice[:, 2, 2] = 2 * (n @ place[:2] - gap) * n - 4 * along * t
    twice[:, 2, 3] = twice[:, 3, 2] = 2 * t
    rows = [0, 1, *line]
    block = covariance[np.ix_(rows, rows)]
    level, width = np.linalg.norm(away), np.sqrt((first @ block @ first.T).trace())
    if level == 0:
        return np.zeros(3), np.zeros((3, 3))
    length, (x, y) = np.hypot(level, height), away / level
    by_length = (np.eye(2) - np.outer(away, away) / length**2) / max(length, width)
    by_angle = np.array([[2 * x * y, y * y - x * x], [y * y - x * x, -2 * x * y]]) / max(level, width) ** 2
    pull, turn = away / length, np.array([-y, x]) / max(level, width)
    hessian = [first.T @ by_length @ first + np.tensordot(pull, twice, 1)]
    arriving = first.T @ by_angle @ first + np.tensordot(turn, twice, 1)
    each = [one @ block for one in (*hessian, -arriving, arriving)]
    return (
        0.5 * np.array([np.trace(one) for one in each]),
        0.5 * np.array([[np.trace(one @ other) for other in each] for one in each]),
    )


def correct(
    mean: Array, covariance: Array, head: int, path: Whole, start: Whole, index: Whole, pair: Array,
    odds: Array, beta: Array, nu: Array, places: Array,
) -> tuple[Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """Twin of `corrections.correct`.

    Parameters
    ----------
    mean, covariance, head : (N,), (N, N), int
        Of the belief; its entry where the lines begin.
    path : (L, 4)
        Bounces, surfaces hit last and first, anchor.
    start, index, pair : (L + 1,), (K or more, 2), (K or more, 8)
        As `blocks.Pairs` has them.
    odds : (12, L)
        Rows as in `primitives.tables`.
    beta, nu : (L, M)
        Messages from paths and from measurements.
    places : (J, 6)
        As `blocks.Anchors` has them.

    Returns
    -------
    (mean, covariance, share, responsible, total, taken)
        (N,), (N, N); probabilities of the associations by pair (K,) and by path and measurement (L, M);
        normalisers (L,); what was taken of each measurement (M,).
    """
    count = int(start[-1])
    share, responsible = np.zeros(count), np.zeros(nu.shape)
    detected, taken = (beta * nu).sum(1), np.zeros(nu.shape[1])
    total = detected + odds[7]
    sure = detected / total
    order = np.argsort(-sure, kind="stable")
    for row in order[sure[order] >= UNLIKELY]:
        value, slope, core = (part[0] for part in predict(mean, covariance, head, path[row][None], places))
        bent = np.zeros((3, 3))
        source = int(path[row, 3])
        height = float(tall(mean, head, source, places))
        if path[row, 0] == 0:
            more, bent = bend(mean, covariance, places[source], height)
            value, core = value + more, core + bent
        if path[row, 0] == 1:
            line = StateLayout.of_view(len(mean), head - AGENT).line(path[row, 1])
            more, bent = bend_of_bounce(mean, covariance, line, places[source], height)
            value, core = value + more, core + bent
        chosen = slice(start[row], start[row + 1])
        variance, density = pair[chosen, 3:6], pair[chosen, 6]
        message = nu[row, index[chosen, 1]]
        gap = pair[chosen, :3] - value
        gap[:, 1:] = wrap(gap[:, 1:])
        gap[variance >= 1e11] = 0.0
        weight = np.array(
            [
                odds[6, row] * m * d * np.exp(-0.5 * g @ np.linalg.solve(core + np.diag(v), g))
                / np.sqrt(np.linalg.det(2 * np.pi * (core + np.diag(v))))
                for g, v, d, m in zip(gap, variance, density, message, strict=True)
            ]
        )  # fmt: skip
        total[row] = weight.sum() + odds[7, row]
        own = index[chosen, 1]
        share[chosen] = np.minimum(weight / total[row], np.maximum(1 - taken[own], 0.0))
        taken[own] += share[chosen]
        moved = share[chosen] > UNMOVED
        after = update(
            Belief(mean, covariance), slope, gap[moved], variance[moved], share[chosen][moved], bent
        )
        mean, covariance = after.mean, after.covariance
    responsible[index[:count, 0], index[:count, 1]] = share
    return mean, covariance, share, responsible, total, taken
