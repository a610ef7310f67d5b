"""Twin of the kernel that describes a belief to users."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import AGENT
from gridslam.inference.beliefs.particles import at_mean
from gridslam.kernels.primitives import blocks
from gridslam.reference.paths import polylines
from gridslam.reference.rays import asked, list_paths
from gridslam.world.geometry import canonical, sfv, sfv_covariance
from gridslam.world.radio import REFLECTION_BINS as BINS

Whole = NDArray[np.int32]


def describe(
    head: int, bounces: int, at_1m: float, belief: blocks.Belief, places: Array, links: blocks.Links,
    surfaces: blocks.SurfaceRows,
) -> tuple[Array, Whole, NDArray[np.int64], Array]:  # fmt: skip
    """Twin of `readout.describe`: table (S, 16); paths, numbers (T, 3), parameters (T, 13)."""
    (mean, covariance), (extent, reflection, identity) = belief, surfaces
    line, count = mean[head:].reshape(-1, 2), len(extent)
    spread = np.stack([covariance[n : n + 2, n : n + 2] for n in range(head, len(mean), 2)] or [np.eye(2)])[
        :count
    ]
    flip = line[:, 1] < 0
    sign = np.stack([np.ones(count), np.where(flip, -1.0, 1.0)], -1)
    both = canonical(line)
    turned = spread * sign[:, :, None] * sign[:, None, :]
    first = reflection @ BINS
    stretch = np.where(flip[:, None], -extent[:, ::-1], extent)
    table = np.concatenate(
        [
            both, turned.reshape(-1, 4), sfv(both), sfv_covariance(both, turned).reshape(-1, 4),
            first[:, None], (reflection @ BINS**2 - first**2)[:, None], stretch,
        ],
        1,
    )  # fmt: skip
    path, existence, together, predicted = list_paths(asked(-1, bounces, head), belief, places, links)
    corners, valid = polylines(at_mean(Belief(mean, covariance, head - AGENT)).state, path, places)
    likely = (existence * together > 0.5) & (valid[:, 0] > 0.5)
    path, corners, value, length = (
        path[likely],
        corners[likely, 0],
        predicted[likely, :3],
        predicted[likely, 12],
    )
    corners[path[:, 0] < 1, 1], corners[path[:, 0] < 2, 2] = np.nan, np.nan
    coefficient = np.append(first, 1.0)
    strength = at_1m / np.maximum(length, 1e-3) * coefficient[path[:, 1]]
    strength *= np.where(path[:, 0] == 2, coefficient[path[:, 2]], 1.0)
    number = np.column_stack([path[:, 3], np.append(identity, -1)[path[:, 1:3]]])
    there = (existence * together)[likely]
    return table, path, number, np.column_stack([value, strength, there, corners.reshape(-1, 8)])
