"""Surfaces as features and back: a map of grid SLAM for hybrid SLAM, and the other way round.

An anchor's image in a surface is a feature without extra length, as are images of images; a feature that is a
mirror image is a surface half-way to its anchor; docs/model.md, (M232), (M233).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gridslam.arrays import Array
from gridslam.estimate_tables import MIRROR, FeatureEstimate, SurfaceEstimate
from gridslam.inference.management.features.feature_tables import with_power
from gridslam.maps.feature_rows import ALIKE, ALIKE_M, OF_LINE, entries, together
from gridslam.world.geometry import mirror, mirror_derivative, sfv_covariance, unit
from gridslam.world.signal_model import SignalModel

LEAST_EXISTENCE = 0.5
NONE_M = 1e-3
"""Deviation of an extra length that isn't there."""
MOST = 30
"""Images of an anchor, those of two surfaces included; if there were more, those are left out."""
MOST_SURE = 0.99
LEAST_STEPS = 10
"""At which a feature was heard before it counts as a surface."""
SAME_M = 0.3
"""Within which an image of an image is that of the other order."""
TURNED, APART_M = np.radians(5.0), 0.5
"""Of lines that count as one surface."""


class Images(NamedTuple):
    """Features (G) that are images, covariance (3 G, 3 G) of their x, y, b, slopes (3 G, 2 S) by lines."""

    table: FeatureEstimate
    covariance: Array
    slopes: Array


def image_features(table: SurfaceEstimate | None, known: Array | None, model: SignalModel) -> Images:
    """Images of all anchors in a map's surfaces and in pairs of them.

    Powers are those that the scene's radio would receive, over a noise of 1.

    Parameters
    ----------
    known : (2 S, 2 S), optional
        Covariance of all lines; default: each surface's own.
    """
    table = SurfaceEstimate.empty() if table is None else table
    keep = np.flatnonzero(table.existence > LEAST_EXISTENCE)
    line, count, anchors = table.line[keep], len(keep), model.anchors[:, :2]
    rows = entries(keep, OF_LINE)
    spread = together(table.line_cov[keep]) if known is None else known[np.ix_(rows, rows)]
    chains: list[tuple[int, ...]] = [(n,) for n in range(count)]
    if count**2 <= MOST:
        chains += [(n, m) for n in range(count) for m in range(count) if n != m]
    place: list[Array] = []
    whose: list[int] = []
    slope, power = [], []
    level = model.radio.amplitude_at_1m**2 / len(model.waveform.agent_element_m)
    for j, anchor in enumerate(anchors):
        for chain in chains:
            at, by = anchor, np.zeros((2, 2 * count))
            for n in chain:
                at, by = mirrored(at, by, line[n], n)
            others = [p for p, own in zip(place, whose, strict=True) if own == j]
            if any(np.hypot(*(p - at)) < SAME_M for p in others):  # the other order of the same two
                continue
            place.append(at)
            slope.append(by)
            whose.append(j)
            power.append(level * float(np.prod(table.reflection[keep[list(chain)]] ** 2)))
    total = len(place)
    if not total:
        return Images(FeatureEstimate.empty(), np.zeros((0, 0)), np.zeros((0, 2 * len(table))))
    jacobian = np.zeros((3 * total, 2 * count))
    jacobian.reshape(total, 3, -1)[:, :2] = slope
    joint = jacobian @ spread @ jacobian.T + np.diag(np.tile([0.0, 0.0, NONE_M**2], total))
    joint[np.arange(3 * total), np.arange(3 * total)] += np.tile([1e-6, 1e-6, 0.0], total)
    covariance = np.zeros((total, 4, 4))
    for n in range(total):
        covariance[n] = with_power(joint[3 * n : 3 * n + 3, 3 * n : 3 * n + 3], power[n])
    number, zeros = np.arange(total), np.zeros(total)
    slopes = np.zeros((3 * total, 2 * len(table)))
    slopes[:, rows] = jacobian
    features = FeatureEstimate(
        number, np.array(whose), anchors[whose], np.array(place), zeros, np.array(power), zeros + 1.0,
        covariance, np.full(total, MIRROR), np.zeros(total, np.int64), np.full(total, -1),
    )  # fmt: skip
    return Images(features, joint, slopes)


def mirrored(point: Array, slope: Array, line: Array, column: int) -> tuple[Array, Array]:
    """Mirror image of a point in a line [a, o], and its slopes by all lines (2, 2 S)."""
    normal = unit(line[0])
    out = slope - 2 * np.outer(normal, normal @ slope)
    out[:, 2 * column : 2 * column + 2] += mirror_derivative(line, point)
    return mirror(line, point), out


def mirror_surfaces(table: FeatureEstimate) -> SurfaceEstimate:
    """Surfaces of which features are the anchors' images, with these features' numbers.

    What they reflect isn't known.

    Left out: features that aren't sure to be images, images of images, and surfaces that a stronger
    feature stands for already.
    """
    good = np.flatnonzero((table.kind == MIRROR) & (table.steps_seen >= LEAST_STEPS))
    good = good[
        np.argsort(-table.variance[good] / table.noise[good])
    ]  # what lost less on its way comes first
    found: list[int] = []
    lines: list[Array] = []
    spreads: list[Array] = []
    for n in good:
        line, slope = between(table.anchor_m[n], table.position_m[n])
        if _of_two(table, int(n), lines) or any(same_line(line, other) for other in lines):
            continue
        found.append(int(n))
        lines.append(line)
        spreads.append(slope @ table.covariance[n, :2, :2] @ slope.T)
    count, rows = len(found), np.array(found, np.int64)
    if not count:
        return SurfaceEstimate.empty()
    line, spread = np.array(lines), np.array(spreads)
    normal = unit(line[:, 0])
    existence = np.minimum(1 - 0.5 ** (table.steps_seen[rows] / LEAST_STEPS), MOST_SURE)
    unknown = np.full(count, 0.5)
    return SurfaceEstimate(
        table.identity[rows], 2 * line[:, 1:] * normal, sfv_covariance(line, spread), line, spread,
        unknown, unknown**2 / 3, existence, np.full((count, 2), np.nan), np.full(count, -1),
    )  # fmt: skip


def between(anchor_m: Array, image_m: Array) -> tuple[Array, Array]:
    """The line [a, o], o >= 0, half-way between an anchor and its image; its slopes (2, 2) by the image."""
    way = image_m - anchor_m
    far = np.hypot(*way)
    normal = way / far
    offset = normal @ (image_m + anchor_m) / 2
    along, side = np.array([-normal[1], normal[0]]), 1.0 if offset >= 0 else -1.0
    angle = np.arctan2(side * way[1], side * way[0])
    return np.array([angle, side * offset]), np.array([along, side * (image_m - offset * normal)]) / far


def _of_two(table: FeatureEstimate, row: int, lines: list[Array]) -> bool:
    """Whether an image is that of an image, in two surfaces that are known already."""
    anchor, place = table.anchor_m[row], table.position_m[row]
    for first in lines:
        for second in lines:
            if first is second:
                continue
            gap = place - mirror(second, mirror(first, anchor))
            square = table.covariance[row, :2, :2] + ALIKE_M**2 * np.eye(2)
            if gap @ np.linalg.solve(square, gap) < ALIKE**2:
                return True
    return False


def same_line(one: Array, other: Array) -> bool:
    """Whether two lines can be one surface."""
    one, _ = facing(one, other)
    turned = np.angle(np.exp(1j * (one[0] - other[0])))
    return bool(abs(turned) < TURNED and abs(one[1] - other[1]) < APART_M)


def facing(line: Array, other: Array) -> tuple[Array, float]:
    """A line [a, o] with its normal on the side where another's is; 1, or -1 if the offset changed sign."""
    if np.cos(line[0] - other[0]) >= 0:
        return line.copy(), 1.0
    return np.array([line[0] + np.pi, -line[1]]), -1.0
