"""Twin of the kernel that describes a belief to users."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import canonical, sfv, sfv_covariance
from gridslam.inference.belief import AGENT, Belief
from gridslam.inference.particles import at_mean
from gridslam.twins.paths import polylines

Array = NDArray[np.float64]
Whole = NDArray[np.int32]
BINS: Array = (np.arange(20) + 0.5) / 20


def describe(
    mean: Array, covariance: Array, extent: Array, reflection: Array, path: Whole, existence: Array,
    surfaces: Array, places: Array,
) -> tuple[Array, NDArray[np.intp], Array]:  # fmt: skip
    """Twin of `kernels.readout.describe`: table (S, 16), paths told of, and their corners (T, 4, 2)."""
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
    corners, valid = polylines(at_mean(Belief(mean, covariance)).state, path, places)
    told = np.flatnonzero((existence * surfaces > 0.5) & (valid[:, 0] > 0.5))
    return table, told, corners[told, 0]
