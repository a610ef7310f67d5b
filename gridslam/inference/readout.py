"""What users see of a belief: surfaces and paths as tables of their own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gridslam.estimates import PathEstimate, SurfaceEstimate
from gridslam.inference.belief import Belief
from gridslam.inference.particles import at_mean
from gridslam.inference.polylines import draw_paths
from gridslam.inference.prediction import paths_now
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
    rays, predicted = paths_now(bank, sight, belief, anchors, most_bounces)
    believed = np.flatnonzero(rays.existence * rays.surfaces > BELIEVED)
    rays, value = rays.take(believed), predicted.value[believed]
    drawn = draw_paths(rays, at_mean(belief), anchors)
    points = drawn.corners[:, 0]
    if not drawn.possible.all():
        good = np.flatnonzero(drawn.possible)
        rays, value, points = rays.take(good), value[good], points[good]
    points[rays.bounces < 2, 2], points[rays.bounces < 1, 1] = np.nan, np.nan
    identity = np.append(bank.identity, -1)
    return PathEstimate(
        rays.anchor.astype(np.intp),
        identity[rays.table[:, 1:3]],
        value[:, 0],
        value[:, 1],
        value[:, 2],
        strength(rays, value[:, 0]),
        rays.existence * rays.surfaces,
        points,
    )
