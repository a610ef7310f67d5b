"""What users see of a belief: surfaces and paths as tables of their own; owner of their kernel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.estimates import PathEstimate, SurfaceEstimate
from gridslam.inference.belief import Belief
from gridslam.inference.prediction import paths_now
from gridslam.inference.rays import Rays
from gridslam.inference.surfaces import Bank

Array = NDArray[np.float64]
Whole = NDArray[np.int32]


def surface_estimate(belief: Belief, bank: Bank) -> SurfaceEstimate:
    """Table of all potential surfaces."""
    none = np.zeros(0)
    return _described(belief, bank, Rays(np.zeros((0, 4), np.int32), none, none), np.zeros((0, 3)))[0]


def estimates(
    belief: Belief, bank: Bank, sight: Array, anchors: Array, most_bounces: int,
    strength: Callable[[Rays, Array], Array],
) -> tuple[SurfaceEstimate, PathEstimate]:  # fmt: skip
    """Tables of all potential surfaces, and of the paths believed in over them as they stand.

    Parameters
    ----------
    strength : callable
        Amplitudes (L,) of rays of given distances (L,).
    """
    rays, predicted = paths_now(bank, sight, belief, anchors, most_bounces)
    table, told, points = _described(belief, bank, rays, anchors)
    rays, value, points = rays.take(told), predicted.value[told], points[told]
    points[rays.bounces < 2, 2], points[rays.bounces < 1, 1] = np.nan, np.nan
    identity = np.append(bank.identity, -1)
    return table, PathEstimate(
        rays.anchor.astype(np.intp),
        identity[rays.table[:, 1:3]],
        value[:, 0],
        value[:, 1],
        value[:, 2],
        strength(rays, value[:, 0]),
        rays.existence * rays.surfaces,
        points,
    )


def _described(
    belief: Belief, bank: Bank, rays: Rays, anchors: Array
) -> tuple[SurfaceEstimate, Whole, Array]:
    """Surfaces; which of the rays are told of, and the corners of all these (L, 4, 2), rest left empty."""
    runtime.start()
    from gridslam.kernels.readout import describe

    count, paths = len(bank), len(rays)
    if len(belief.lines) != count:
        raise ValueError("belief and bank don't hold the same surfaces")
    rays.check(count, len(anchors))
    table, drawn, told = np.empty((count, 16)), np.empty((paths, 13)), np.empty(paths + 1, np.int32)
    describe(
        belief.mean, belief.covariance, bank.extent, bank.reflection, rays.table, rays.existence,
        rays.surfaces, anchors, runtime.scratch("describe", (3 + 3 * count, 1)), drawn, told, table,
    )  # fmt: skip
    surfaces = SurfaceEstimate(
        bank.identity, table[:, 6:8], table[:, 8:12].reshape(-1, 2, 2), table[:, :2],
        table[:, 2:6].reshape(-1, 2, 2), table[:, 12], table[:, 13], bank.existence, table[:, 14:],
        bank.owner,
    )  # fmt: skip
    return surfaces, told[1 : 1 + int(told[0])], drawn[:, :8].reshape(-1, 4, 2)
