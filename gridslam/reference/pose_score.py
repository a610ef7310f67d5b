"""Twin of the kernel that scores poses by one scan: all pairs, by arc tangents, from the same tables."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.kernels.primitives import clues as column
from gridslam.kernels.primitives.blocks import Clues
from gridslam.reference.messages import log_rician
from gridslam.world.geometry import slant, unit, wrap

MOST = 60.0


def score_poses(in_sight: float, nearest: float, step: float, poses: Array, clues: Clues) -> Array:
    """Log-likelihood of the scan at poses (N, 3), over that of clutter, (N,)."""
    total = np.zeros(len(poses))
    for listener, (first, last, begin, end) in zip(clues.listener, clues.own.tolist(), strict=True):
        measured, known = clues.measured[first:last], clues.known[begin:end]
        away = poses[:, :2] - listener[:2]
        length = slant(np.hypot(away[:, 0], away[:, 1]), listener[column.HEIGHT])
        leaving, heading = np.arctan2(away[:, 1], away[:, 0]), poses[:, 2]
        strength = listener[column.AT_1M] / np.maximum(length, 1e-3)
        total -= in_sight * _detected(clues, step, strength)
        sight = length, leaving, leaving + np.pi - heading
        ratio = _ratio(
            measured, column.STRAIGHT, sight, _measured_at(clues, step, measured, strength, listener)
        )
        ratio += _born(measured, away, heading, nearest) * (length[:, None] < measured[:, column.DISTANCE])
        for row in known:
            normal, image = row[column.NORMAL : column.OFFSET], row[: column.NORMAL]
            side = (poses[:, :2] @ normal - row[column.OFFSET]) * row[column.SIDE]
            there = row[column.CHANCE] * (side > 0)
            toward = image - poses[:, :2]
            distance = slant(np.hypot(toward[:, 0], toward[:, 1]), listener[column.HEIGHT])
            back = np.arctan2(toward[:, 1], toward[:, 0])
            level = listener[column.AT_1M] * row[column.COEFFICIENT] / np.maximum(distance, 1e-3)
            total -= there * _detected(clues, step, level)
            bounce, loud = (
                (distance, row[column.TURN] - back, back - heading),
                _measured_at(clues, step, measured, level, listener),
            )
            ratio += there[:, None] * _ratio(measured, column.OVER, bounce, loud)
        total += np.log1p(ratio).sum(1)
    return total


def _detected(clues: Clues, step: float, amplitude: Array) -> Array:
    return np.interp(amplitude, step * np.arange(len(clues.chance)), clues.chance)


def _measured_at(clues: Clues, step: float, scan: Array, amplitude: Array, listener: Array) -> Array:
    """Log of p_d times the density of every measured amplitude, at expected ones (N,): (N, M)."""
    measured, expected = scan[:, column.AMPLITUDE], np.maximum(amplitude[:, None], 1e-6)
    rice = log_rician(np.maximum(measured, 1e-9), expected, listener[column.SAMPLES])
    silent = np.log(np.maximum(_detected(clues, step, amplitude), 1e-12))
    return np.where(measured < 0, silent[:, None], rice)


def _ratio(scan: Array, first: int, predicted: tuple[Array, ...], loud: Array) -> Array:
    """Ratio to clutter of paths by what is predicted of each (N,), (N, M)."""
    log = scan[:, first + 3] + loud
    for axis, value in enumerate(predicted):
        gap = scan[:, axis] - value[:, None]
        log = log - 0.5 * scan[:, first + axis] * (gap if axis == 0 else wrap(gap)) ** 2
    return np.exp(np.minimum(log, MOST))


def _born(scan: Array, away: Array, heading: Array, nearest: float) -> Array:
    """Ratio to clutter of new single bounces, (N, M), from an anchor to agents `away` (N, 2) from it."""
    level = np.hypot(*scan[:, column.TOWARD : column.TURNED].T)
    arrives = scan[:, column.STRAIGHT + 2] > 0
    world = heading[:, None] + scan[:, column.AOA]
    toward = np.where(arrives[:, None], unit(world), -unit(scan[:, column.AOD]))
    image = away[:, None] + level[:, None] * toward
    leaving = 2 * np.arctan2(image[..., 1], image[..., 0]) - world
    miss = wrap(scan[:, column.AOD] - leaving)
    fits = scan[:, column.FIT] * np.exp(-0.5 * scan[:, column.SURE] * miss**2) + scan[:, column.ANY]
    gap = np.maximum(np.hypot(image[..., 0], image[..., 1]), nearest)
    return np.minimum(scan[:, column.BORN] * fits / gap, np.exp(MOST))
