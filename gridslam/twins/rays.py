"""Twins of the kernels that list rays, report them, and count what lies near them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import wrap
from gridslam.twins.gaussian import predict
from gridslam.twins.paths import polylines

Array = NDArray[np.float64]
Whole = NDArray[np.int32]
Long = NDArray[np.int64]
STRONG = 0.3


def listed(
    anchor: int, bounces: int, surface: Array, owner: Long, sight: Array, single: Array, double: Array
) -> tuple[Whole, Array, Array]:
    """All paths of an anchor (L, 4), and the existences of rays and of surfaces, (L,) both."""
    own = np.flatnonzero((owner == -1) | (owner == anchor))
    strong = np.flatnonzero(surface > STRONG)
    pairs = [(s, r) for s in strong for r in strong if s != r and bounces > 1]
    last, first = np.array(pairs, int).reshape(-1, 2).T
    kind = np.repeat([0, 1, 2], [1, len(own), len(pairs)])
    path = np.stack(
        [kind, np.concatenate([[-1], own, last]), np.concatenate([[-1], own, first]), 0 * kind + anchor], -1
    )
    existence = np.concatenate([[sight[anchor]], single[anchor, own], double[anchor, last, first]])
    return (
        path.astype(np.int32),
        existence,
        np.concatenate([[1.0], surface[own], surface[last] * surface[first]]),
    )


def foresee(
    anchor: int, bounces: int, mean: Array, covariance: Array, places: Array, surface: Array, owner: Long,
    sight: Array, single: Array, double: Array,
) -> tuple[Whole, Array, Array, Array]:  # fmt: skip
    """Twin of `kernels.rays.foresee`: paths, existence of ray and of surfaces, prediction (L, 12)."""
    path, existence, surfaces = listed(anchor, bounces, surface, owner, sight, single, double)
    value, _, spread = predict(mean, covariance, path, places)
    whole = np.concatenate([value, spread.reshape(-1, 9)], 1)
    return path, 0.95 * existence + 0.005 * (1 - existence), surfaces, whole


def report(
    bounces: int, least: float, mean: Array, places: Array, surface: Array, owner: Long, sight: Array,
    single: Array, double: Array, state: Array,
) -> tuple[Whole, Array, Array]:  # fmt: skip
    """Twin of `kernels.rays.report`: paths, existence with distance and angles (L, 4), corners (L, 4, 2)."""
    found: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
    for anchor in range(len(places)):
        path, existence, surfaces = listed(anchor, bounces, surface, owner, sight, single, double)
        corners, possible = polylines(state, path, places)
        good = (existence * surfaces > least) & (possible[:, 0] > 0.5)
        value, _, _ = predict(mean, np.zeros((len(mean), len(mean))), path, places)
        for part, new in zip(
            found, (path, np.column_stack([existence * surfaces, value]), corners[:, 0]), strict=True
        ):
            part.append(new[good])
    paths, told, points = (np.concatenate(part) for part in found)
    return paths.astype(np.int32), told, points


def near(
    mean: Array, covariance: Array, places: Array, surface: Array, owner: Long, start: Whole, heard: Array,
    radio: Array,
) -> NDArray[np.bool_]:  # fmt: skip
    """Twin of `kernels.rays.near`: which measurements are loud and lie near a path, (M,)."""
    anchors, count = len(places), len(surface)
    single, double = np.ones((anchors, count)), np.ones((anchors, count, count))
    own = [listed(a, 1, surface, owner, np.ones(anchors), single, double) for a in range(anchors)]
    path, _, surfaces = (np.concatenate(part) for part in zip(*own, strict=True))
    value, _, spread = predict(mean, covariance, path, places)
    anchor = np.repeat(np.arange(anchors), np.diff(start))
    amplitude = np.where(heard[:, 6] >= 0, heard[:, 6], radio[anchor, 9])
    std = np.empty((len(heard), 3))
    std[:, 0] = np.where(radio[anchor, 1] > 0, radio[anchor, 1], radio[anchor, 0] / amplitude)
    for q in (1, 2):
        square = radio[anchor, 2 * q : 2 * q + 2].mean(1)
        std[:, q] = 1 / (np.sqrt(8) * np.pi * amplitude * np.sqrt(np.maximum(square, 1e-30)))
    std = np.where(heard[:, 3:6] > 0, heard[:, 3:6], std)
    gap = heard[:, :3] - value[:, None]
    gap[..., 1:] = wrap(gap[..., 1:])
    total = np.diagonal(spread, axis1=1, axis2=2)[:, None] + std**2
    far = np.where(heard[:, 3:6] < 0, 0.0, gap**2 / total).sum(-1)
    there = (surfaces > STRONG)[:, None] & (path[:, 3, None] == anchor)
    return np.asarray(((far < 16.0) & there).any(0) & (heard[:, 7] > 0.5))
