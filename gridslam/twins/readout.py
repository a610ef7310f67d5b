"""Twin of the kernel that describes a belief to users."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import canonical, sfv, sfv_covariance
from gridslam.inference.belief import AGENT, Belief
from gridslam.inference.particles import at_mean
from gridslam.twins.paths import polylines
from gridslam.twins.rays import foresee

Array = NDArray[np.float64]
Whole = NDArray[np.int32]
BINS: Array = (np.arange(20) + 0.5) / 20


def describe(
    mean: Array, covariance: Array, extent: Array, reflection: Array, bounces: int, places: Array,
    surface: Array, owner: NDArray[np.int64], sight: Array, single: Array, double: Array,
) -> tuple[Array, Whole, Array, Array, Array]:  # fmt: skip
    """Twin of `kernels.readout.describe`: table (S, 16); paths, existence, values, corners (T, 4, 2)."""
    line, count = mean[AGENT:].reshape(-1, 2), len(extent)
    spread = np.stack([covariance[n : n + 2, n : n + 2] for n in range(AGENT, len(mean), 2)] or [np.eye(2)])[
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
    path, existence, surfaces, predicted = foresee(
        -1, bounces, 1.0, 0.0, mean, covariance, places, surface, owner, sight, single, double
    )
    corners, valid = polylines(at_mean(Belief(mean, covariance)).state, path, places)
    told = (existence * surfaces > 0.5) & (valid[:, 0] > 0.5)
    return table, path[told], (existence * surfaces)[told], predicted[told, :3], corners[told, 0]
