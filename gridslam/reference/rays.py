"""Twins of the kernels that list rays, and tell what lies near them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.kernels.primitives.blocks import HEAD, MOST_BOUNCES, ONLY, SENDERS, Belief, Links, Query
from gridslam.reference.gaussian import late, of_length, predict
from gridslam.reference.paths import prepare
from gridslam.world.geometry import lean, wrap

Whole = NDArray[np.int32]
Long = NDArray[np.int64]
STRONG = 0.3


def listed(anchor: int, bounces: int, links: Links) -> tuple[Whole, Array, Array]:
    """All paths of an anchor (L, 4), and the existences of rays and of surfaces, (L,) both."""
    surface, owner, sight, single, double = links
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


def asked(only: int, bounces: int, head: int) -> Query:
    """A query for paths as they are."""
    return Query(np.array([only, bounces, head, 0, 0, 1], np.int32), np.array([1.0, 0.0, 1.0]))


def list_paths(
    query: Query, belief: Belief, places: Array, links: Links, points: Array | None = None
) -> tuple[Whole, Array, Array, Array]:
    """Twin of `rays.list_paths`: paths, existence of ray and of surfaces, prediction (L, 15).

    What it drafts by `points` is that of `prepare`, and isn't told.
    """
    only, bounces, head, senders = query.choice[[ONLY, MOST_BOUNCES, HEAD, SENDERS]].tolist()
    stay, appear, share = query.weight.tolist()
    if points is not None:
        prepare(*belief, head, share, points)
    anchors = [anchor for anchor in range(len(places)) if only < 0 or anchor % senders == only]
    parts = [listed(anchor, bounces, links) for anchor in anchors]
    path, existence, surfaces = (np.concatenate(part) for part in zip(*parts, strict=True))
    value, slope, spread = predict(*belief, head, path, places)
    length = value[:, 0] - late(belief.mean, head, path[:, 3], places)
    unclear, learnt = of_length(slope[:, 0], belief.covariance, head, places)
    whole = np.column_stack([value, spread.reshape(-1, 9), length, unclear, learnt])
    return path, stay * existence + appear * (1 - existence), surfaces, whole


def near(
    mean: Array, covariance: Array, head: int, places: Array, surface: Array, owner: Long, scan: Array,
    radio: Array,
) -> NDArray[np.bool_]:  # fmt: skip
    """Twin of `rays.near`: which measurements are loud and lie near a path, (M,)."""
    none = np.zeros((len(places), len(surface)))
    links = Links(surface, owner, none.sum(1), none, none[:, None])
    belief = Belief(mean, covariance)
    path, _, surfaces, predicted = list_paths(asked(-1, 1, head), belief, places, links)
    amplitude = np.where(scan[:, 6] >= 0, scan[:, 6], radio[path[:, 3], 9][:, None])  # (L, M)
    own = radio[path[:, 3]][:, None]
    std = np.empty((*amplitude.shape, 3))
    std[..., 0] = np.where(own[..., 1] > 0, own[..., 1], own[..., 0] / amplitude)
    steep = lean(predicted[:, 12], places[path[:, 3], 3])[:, None]
    for q in (1, 2):
        square = own[..., 2 * q : 2 * q + 2].mean(-1)
        std[..., q] = 1 / (np.sqrt(8) * np.pi * amplitude * steep * np.sqrt(np.maximum(square, 1e-30)))
    std = np.where(scan[:, 3:6] > 0, scan[:, 3:6], std)
    gap = scan[:, :3] - predicted[:, None, :3]
    gap[..., 1:] = wrap(gap[..., 1:])
    total = predicted[:, None, 3:12:4] + std**2
    far = np.where(scan[:, 3:6] < 0, 0.0, gap**2 / total).sum(-1)
    there = (surfaces > STRONG)[:, None] & ((scan[:, 9] < 0) | (own[..., 11] == scan[:, 9]))
    return np.asarray(((far < 16.0) & there).any(0) & (scan[:, 7] > 0.5))
