"""Plain counterpart of the kernel that fits walls and points to what is heard of surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.kernels import UNMEASURED
from gridslam.world.geometry import unit, wrap

WALL, POINT, ODDS = slice(0, 5), slice(5, 10), 10
BELIEVED, SHIFTED_M, NEAR_M, FADING = 4.0, 1.0, 0.05, 1.02
MOST_TOLD, MOST_SURPRISED, DECIDED = 3.0, 3.0, 30.0


def fit_forms(pose: Array, known: Array, heard: Array, place: Array, line: Array, form: Array) -> Array:
    """Twin of `scatterers.fit_forms`: the forms after a measurement of each, (D, 11)."""
    value, variance = heard[:, :3], heard[:, 3:]
    fresh = ~form[:, [2, 4, 7, 9]].any(1)
    forms = form.copy()
    if fresh.any():
        forms[fresh] = first_forms(value[fresh], variance[fresh], place[fresh], pose, line[fresh])
    half = len(forms)
    mean = np.concatenate([forms[:, 0:2], forms[:, 5:7]])
    spread = np.concatenate([forms[:, 2:5], forms[:, 7:10]])[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    parts = zip(off_wall(mean[:half], place, pose), off_point(mean[half:], place, pose), strict=True)
    predicted, slope, bend = (np.concatenate(both) for both in parts)
    lateral = np.einsum("dki,dij,dkj->d", bend, spread, bend)
    noise = np.tile(variance, (2, 1))
    vague = 0.5 * (known[0, 0] + known[1, 1])
    noise[:, 0] += vague + 0.5 * lateral**2
    noise[:, 1:] += vague / np.maximum(predicted[:, :1], NEAR_M) ** 2
    noise[:, 2] += known[2, 2]
    told = np.concatenate([variance, variance]) < UNMEASURED
    gap = np.tile(value, (2, 1)) - predicted
    gap[:, 1:] = wrap(gap[:, 1:])
    shift, log = np.zeros_like(mean), np.zeros(2 * half)
    for q in range(3):  # one quantity after the other, whose errors are apart
        along = np.einsum("dij,dj->di", spread, slope[:, q])
        whole = (slope[:, q] * along).sum(1) + noise[:, q]
        missed = gap[:, q] - (slope[:, q] * shift).sum(1)
        log -= told[:, q] * (0.5 * missed**2 / whole + 0.5 * np.log(whole))
        most = MOST_SURPRISED * np.sqrt(whole)
        gain = (told[:, q] / whole)[:, None] * along
        shift += gain * np.clip(missed, -most, most)[:, None]
        spread = spread - gain[:, :, None] * along[:, None]
    mean, spread = mean + shift, FADING * spread.reshape(-1, 4)[:, [0, 1, 3]]
    forms[:, WALL] = np.concatenate([mean[:half], spread[:half]], 1)
    forms[:, POINT] = np.concatenate([mean[half:], spread[half:]], 1)
    said = np.clip(log[:half] - log[half:], -MOST_TOLD, MOST_TOLD)
    forms[:, ODDS] = np.maximum(forms[:, ODDS] + np.where(fresh, 0.0, said), -DECIDED)
    return forms


def first_forms(value: Array, variance: Array, places: Array, pose: Array, lines: Array) -> Array:
    """Forms (D, 11) known about where they are: a wall as it is believed, and a point on the way."""
    forms, place = np.zeros((len(value), ODDS + 1)), pose[:2]
    forms[:, WALL] = lines * [1, 1, BELIEVED, BELIEVED, BELIEVED]
    arrives = variance[:, 2] < UNMEASURED
    near = np.where(arrives[:, None], place, places[:, :2])
    far = np.where(arrives[:, None], places[:, :2], place)
    away = unit(np.where(arrives, value[:, 2] + pose[2], value[:, 1] + places[:, 2]))
    apart, length = far - near, value[:, 0]
    rest = np.maximum(length - (away * apart).sum(1), NEAR_M)
    reach = np.maximum(0.5 * (length**2 - (apart**2).sum(1)) / rest, NEAR_M)  # both ways together are as long
    forms[:, 5:7] = near + np.minimum(reach, length)[:, None] * away
    forms[:, [7, 9]] = SHIFTED_M**2
    return forms


def off_wall(line: Array, places: Array, pose: Array) -> tuple[Array, Array, Array]:
    """What is heard off walls (D, 2), its slopes by them, and their directions in which a length bends."""
    normal, along = unit(line[:, 0]), unit(line[:, 0] + 0.5 * np.pi)
    (back, by_back), (out, by_out) = (
        _mirrored(end, line[:, 1], normal, along) for end in (places[:, :2], pose[None, :2])
    )
    coming, going = back - pose[:2], out - places[:, :2]
    length, turned_in, turned_out = _polar(coming, by_back, going, by_out)
    across = np.stack([-coming[:, 1], coming[:, 0]], 1) / length[:, None] ** 1.5
    bend = np.einsum("di,dik->dk", across, by_back)[:, None]
    value = np.stack([length, _angle(going) - places[:, 2], _angle(coming) - pose[2]], 1)
    by_length = np.einsum("di,dik->dk", coming / length[:, None], by_back)
    return value, np.stack([by_length, turned_out, turned_in], 1), np.repeat(bend, 2, 1) * [[[1.0], [0.0]]]


def off_point(point: Array, places: Array, pose: Array) -> tuple[Array, Array, Array]:
    """What is heard off points (D, 2), its slopes by them, and their directions in which a length bends."""
    going, coming = point - places[:, :2], point - pose[:2]
    ways = [np.maximum(np.hypot(*way.T), NEAR_M)[:, None] for way in (going, coming)]
    ahead = [way / length for way, length in zip((going, coming), ways, strict=True)]
    across = [np.stack([-one[:, 1], one[:, 0]], 1) for one in ahead]
    value = np.stack([
        (ways[0] + ways[1])[:, 0], _angle(going) - places[:, 2], _angle(coming) - pose[2]
    ], 1)  # fmt: skip
    slope = np.stack([ahead[0] + ahead[1], across[0] / ways[0], across[1] / ways[1]], 1)
    return value, slope, np.stack([one / np.sqrt(way) for one, way in zip(across, ways, strict=True)], 1)


def _mirrored(point: Array, offset: Array, normal: Array, along: Array) -> tuple[Array, Array]:
    """Points (D, 2) behind lines, and their slopes (D, 2, 2) by angle and offset."""
    gap = (offset - (point * normal).sum(1))[:, None]
    by_angle = 2 * gap * along - 2 * (point * along).sum(1)[:, None] * normal
    return point + 2 * gap * normal, np.stack([by_angle, 2 * normal], 2)


def _polar(coming: Array, by_back: Array, going: Array, by_out: Array) -> tuple[Array, Array, Array]:
    """Lengths (D,), and slopes of the directions (D, 2) of arrival and departure."""
    length = np.maximum(np.hypot(*coming.T), NEAR_M)
    turned = [
        np.einsum("di,dik->dk", np.stack([-way[:, 1], way[:, 0]], 1) / length[:, None] ** 2, by)
        for way, by in ((coming, by_back), (going, by_out))
    ]
    return length, turned[0], turned[1]


def _angle(way: Array) -> NDArray[np.float64]:
    """Directions of vectors (D, 2), rad."""
    return np.arctan2(way[:, 1], way[:, 0])
