"""What users see of a belief: surfaces and paths as tables of their own; owner of the kernel for paths."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.estimates import PathEstimate, SurfaceEstimate
from gridslam.inference.belief import Belief
from gridslam.inference.particles import at_mean
from gridslam.inference.rays import Rays
from gridslam.inference.surfaces import Bank, canonical_lines
from gridslam.signal import REFLECTION_BINS

Array = NDArray[np.float64]
BELIEVED = 0.5
"""Existence from which on a path is told of."""


def surface_estimate(belief: Belief, bank: Bank) -> SurfaceEstimate:
    """Table of all potential surfaces."""
    line, covariance = canonical_lines(belief)
    mean = bank.reflection @ REFLECTION_BINS
    variance = bank.reflection @ REFLECTION_BINS**2 - mean**2
    flip = belief.lines[:, 1] < 0  # the tangent turns with the normal
    extent = np.where(flip[:, None], -bank.extent[:, ::-1], bank.extent)
    return SurfaceEstimate.from_lines(
        line, covariance, mean, variance, bank.existence, extent, bank.identity, bank.owner
    )


def path_estimate(
    belief: Belief, bank: Bank, sight: Array, anchors: Array, most_bounces: int,
    strength: Callable[[Rays, Array], Array],
) -> PathEstimate:  # fmt: skip
    """Table of the paths believed in, over the surfaces as they stand.

    Parameters
    ----------
    strength : callable
        Amplitudes (L,) of rays of given distances (L,).
    """
    runtime.start()
    from gridslam.kernels.rays import report

    if len(belief.lines) != len(bank) or len(anchors) != len(sight):
        raise ValueError("surfaces or anchors don't belong together")
    room = len(anchors) * (1 + len(bank) ** 2)
    table, told = np.empty((room, 4), np.int32), np.empty((room, 4))
    drawn, found = np.empty((room, 13)), np.empty(1, np.int32)
    report(
        most_bounces, BELIEVED, belief.mean, anchors, bank.existence, bank.owner, sight, bank.single,
        bank.double, at_mean(belief).state, table, told, drawn, found,
    )  # fmt: skip
    count = int(found[0])
    rays = Rays(table[:count], told[:count, 0], np.ones(count))
    points = drawn[:count, :8].reshape(-1, 4, 2).copy()
    points[rays.bounces < 2, 2], points[rays.bounces < 1, 1] = np.nan, np.nan
    identity = np.append(bank.identity, -1)
    return PathEstimate(
        rays.anchor.astype(np.intp),
        identity[rays.table[:, 1:3]],
        told[:count, 1].copy(),
        told[:count, 2].copy(),
        told[:count, 3].copy(),
        strength(rays, told[:count, 1]),
        told[:count, 0].copy(),
        points,
    )
