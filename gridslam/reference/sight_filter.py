"""Twin of the filter that follows an agent by lines of sight: all particles of a step at once, in NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.kernels.primitives import sights as column
from gridslam.kernels.primitives.sights import Sights
from gridslam.world.geometry import slant, wrap

POSITION, GOING = slice(column.PLACE, column.HEADING), slice(column.GOING, column.SIZE)


def follow_sights(sights: Sights, particle: Array) -> tuple[Array, Array, Array]:
    """Twin of `sight_filter.follow_sights`.

    Parameters
    ----------
    particle : (P, 10)
        Those that it begins with.

    Returns
    -------
    place, likeliest : (S, 3), (Q, 3)
        As the kernel's.
    particle : (P', 10)
        Those after the last step.
    """
    place, likeliest = list[list[float]](), list[list[float]]()
    for now, after in zip(sights.step[:-1], sights.step[1:], strict=True):
        drawn = sights.draw[now[column.DRAWS] :]
        particle = _moved(sights.choice, particle[: now[column.COUNT]], now[column.AFTER], drawn)
        scans = {q: _weighed(sights, particle, q) for q in range(now[column.SCANS], after[column.SCANS])}
        score = np.sum([np.log(total) for _, total, _ in scans.values()], axis=0)
        weight = np.exp(score - score.max())
        evidence = score.max() + np.log(weight.mean())
        weight /= weight.sum()
        place.append([evidence, *(weight @ particle[:, POSITION])])
        for q, (ratio, total, expected) in scans.items():
            own = ratio @ (expected * weight / total) / len(ratio)
            length = weight @ _length(sights.anchor[sights.scan[q, column.ANCHOR]], particle)
            likeliest.append([sights.scan[q, column.ROWS] + own.argmax(), own.sum(), length])
        particle = _redrawn(sights.choice, particle, weight, after[column.COUNT], drawn[3 * len(particle) :])
    return np.array(place), np.array(likeliest), particle


def _moved(choice: Array, particle: Array, steps: int, drawn: Array) -> Array:
    count, lasting, after = len(particle), choice[column.LASTING], particle.copy()
    fresh = drawn[: 2 * count].reshape(count, 2)
    after[:, GOING] = lasting * particle[:, GOING] + np.sqrt(1 - lasting**2) * fresh
    after[:, POSITION] += np.sqrt(steps) * particle[:, [column.PACE]] * after[:, GOING]
    sharp = np.arange(count) % int(choice[column.SHARE]) == 0
    turn = np.where(sharp, choice[column.WIDEST], choice[column.TURN])
    after[:, column.HEADING] += np.sqrt(steps) * turn * drawn[2 * count : 3 * count]
    return after


def _length(anchor: Array, particle: Array) -> Array:
    """Distances (P,) that particles expect of an anchor."""
    size = particle[:, column.SIZE]
    level = np.hypot(*(particle[:, POSITION] - anchor[: column.FACING]).T)
    return slant(level, anchor[column.HEIGHT] + anchor[column.TILT] * size) + anchor[column.ADDED] * size


def _weighed(sights: Sights, particle: Array, q: int) -> tuple[Array, Array, Array]:
    """Ratios of a scan's rows (M, P); the scan's likelihood over that of any paths, and what is expected."""
    anchor, choice = sights.anchor[sights.scan[q, column.ANCHOR]], sights.choice
    rows = sights.row[sights.scan[q, column.ROWS] : sights.scan[q + 1, column.ROWS], :, None]
    stand, seen_from = anchor[: column.FACING], particle[:, POSITION]
    if not choice[column.THOROUGH]:
        seen_from = seen_from.mean(0, keepdims=True)
    seen = ~np.any([_between(stand, seen_from, wall) for wall in sights.wall.reshape(-1, 2, 2)], axis=0)
    away = particle[:, POSITION] - stand
    direction = np.arctan2(away[:, 1], away[:, 0])
    behind = direction + np.pi - (0 if choice[column.WORLD] else particle[:, column.HEADING])
    gap = np.stack([
        rows[:, 0] - _length(anchor, particle),
        wrap(rows[:, 1] - direction + anchor[column.FACING]),
        wrap(rows[:, 2] - behind),
    ], 1)  # fmt: skip
    square = ((gap * rows[:, column.SURE : column.PEAK]) ** 2).sum(1)
    ratio = rows[:, column.PEAK] * np.exp(-0.5 * square)
    expected = np.where(seen, choice[column.IN_SIGHT], choice[column.BEHIND])
    return ratio, 1 - expected + expected * ratio.mean(0), expected


def _between(stand: Array, points: Array, wall: Array) -> NDArray[np.bool_]:
    """Whether a wall (2, 2) stands between an anchor (2,) and points (K, 2)."""
    beside = _side(wall[0], wall[1], stand) * _side(wall[0], wall[1], points) < 0
    return beside & (_side(stand, points, wall[0]) * _side(stand, points, wall[1]) <= 0)


def _side(start: Array, end: Array, point: Array) -> Array:
    """Twice the area of triangles, positive where a point is on the left of the way."""
    way, away = end - start, point - start
    return np.asarray(way[..., 0] * away[..., 1] - way[..., 1] * away[..., 0])


def _redrawn(choice: Array, particle: Array, weight: Array, left: int, drawn: Array) -> Array:
    places = (drawn[0] + np.arange(left)) / left
    chosen = np.minimum(np.searchsorted(np.cumsum(weight), places), len(weight) - 1)
    after, shrinkage = particle[chosen], choice[column.SHRINKAGE]
    if shrinkage > 0:
        size = after[:, column.SIZE]
        noise = np.sqrt(1 - shrinkage**2) * size.std() * drawn[1 : 1 + left]
        after[:, column.SIZE] = size.mean() + shrinkage * (size - size.mean()) + noise
    return after
