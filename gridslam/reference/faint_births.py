"""Twin of the kernel that holds new lines against what was left over: one measurement after the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.layout import OF_POSE, POSE
from gridslam.kernels import FAINTEST
from gridslam.kernels.primitives.blocks import Anchors, Belief, Borne, Left
from gridslam.reference.messages import clutter, deviations, log_rician
from gridslam.world.geometry import lean, trace, unit, wrap
from gridslam.world.radio import REFLECTION_BINS as BINS

NEAR, HEARD_BY_ANOTHER, LEAST_DOUBT, MOST_LOG, MOST = 0.6, 0.5, 1e-9, 25.0, 50.0


def bear_out(
    anchor: int, step: float, chance: Array, belief: Belief, anchors: Anchors, scan: Array, left: Left,
    born: Borne,
) -> tuple[Array, NDArray[np.int64]]:  # fmt: skip
    """Twin of `faint_births.bear_out`: gain (B, BINS), and how often each line was heard (B,)."""
    (places, radio), (pose, spread, begin, rows) = anchors, left
    agent, doubt = belief.mean[POSE], belief.covariance[OF_POSE]
    gain, seen = np.zeros((len(born.line), len(BINS))), np.zeros(len(born.line))
    for b, m in enumerate(born.measurement):
        own, unsure = corrected(born.line[b], agent, doubt, places[anchor], radio[anchor], scan[m])
        worlds = np.zeros((2, len(pose), len(BINS)))
        for j, place in enumerate(places):
            now = np.empty((2, len(pose), len(BINS)))
            for back, here in enumerate(pose):
                value, slope, possible = traced(own, place, here)
                level = radio[j, 7] / value[0] * BINS
                detected = np.interp(level, step * np.arange(len(chance)), chance)
                now[:, back] = np.maximum(1 - possible * detected, LEAST_DOUBT)
                for row in rows[begin[back] : begin[back + 1]] if possible else ():
                    gap = missed_by(row[1:4], value)
                    if row[0] == j and (np.abs(gap) < NEAR).all():
                        now[1, back] += ratio_of(gap, row, slope, spread[back], unsure, radio[j], level)
            seen[b] += (1 - now[0] / now[1]).max(1).sum()
            each = np.log(now).cumsum(1)
            worlds += each if j == anchor else np.log(1 - HEARD_BY_ANOTHER + HEARD_BY_ANOTHER * np.exp(each))
        silent, borne = np.exp(np.minimum(worlds, MOST)).mean(1)
        gain[b] = borne - silent
    return gain, np.rint(seen).astype(np.int64)


def ratio_of(
    gap: Array, row: Array, slope: Array, pose: Array, line: Array, radio: Array, level: Array
) -> Array:
    """Ratios to clutter (BINS,) of a measurement by how much it misses a path of pose and line, (M251)."""
    noise = (
        slope[:, :3] @ pose @ slope[:, :3].T + slope[:, 3:] @ line @ slope[:, 3:].T + np.diag(row[4:7] ** 2)
    )
    log = -0.5 * (gap @ np.linalg.solve(noise, gap) + np.linalg.slogdet(2 * np.pi * noise)[1])
    log = log - np.log(clutter(row[7], radio)) + log_rician(row[7], level, radio[8])
    return np.asarray(np.exp(np.minimum(log, MOST_LOG)))


def corrected(
    line: Array, agent: Array, covariance: Array, place: Array, radio: Array, row: Array
) -> tuple[Array, Array]:
    """A line (2,) and its covariance (2, 2) by the measurement that bears it."""
    value, slope, _ = traced(line, place, agent)
    std = deviations(np.maximum(row[6:7], FAINTEST), row[None, 1:3], radio, lean(row[:1], place[3]))[0]
    std = np.where(row[3:6] > 0, row[3:6], np.minimum(std, 1e9))
    inverse = np.linalg.inv(slope[:, :3] @ covariance @ slope[:, :3].T + np.diag(std**2))
    doubt = np.linalg.inv(slope[:, 3:].T @ inverse @ slope[:, 3:] + 1e-9 * np.eye(2))
    moved = line + doubt @ slope[:, 3:].T @ inverse @ missed_by(row[:3], value)
    return moved, np.asarray(doubt, np.float64)


def missed_by(measured: Array, value: Array) -> Array:
    """By how much a measurement (3,) misses what is predicted."""
    gap = measured - value
    return np.array([gap[0], *wrap(gap[1:])])


def traced(line: Array, place: Array, pose: Array) -> tuple[Array, Array, bool]:
    """Value (3,) of a single bounce, slopes by pose and line (3, 5), and whether it is possible."""
    path = trace(pose[None, :2], place[None, :2], line[None], line[None], np.array([1]), place[3])
    value = np.array([path.distance[0], path.departure[0] - place[2], path.arrival[0] - pose[2]])
    here, there = (float(unit(line[0]) @ point[:2] - line[1]) for point in (pose, place))
    return value, path.jacobian[0, :, :5], here * there > 0
