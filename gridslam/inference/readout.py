"""What users see of a belief: surfaces and paths as tables of their own; owner of their kernel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.estimates import PathEstimate, SurfaceEstimate
from gridslam.inference.belief import Belief
from gridslam.inference.rays import Rays, listed_at_most
from gridslam.inference.surfaces import Bank

Array = NDArray[np.float64]
Whole = NDArray[np.int32]


def surface_estimate(belief: Belief, bank: Bank) -> SurfaceEstimate:
    """Table of all potential surfaces."""
    return _described(belief, bank, np.zeros(0), np.zeros((0, 3)), 0)[0]


def estimates(
    belief: Belief, bank: Bank, sight: Array, anchors: Array, most_bounces: int,
    strength: Callable[[Rays, Array], Array],
) -> tuple[SurfaceEstimate, PathEstimate]:  # fmt: skip
    """Tables of all potential surfaces, and of the paths believed in over them as they stand.

    Parameters
    ----------
    sight : (J,)
        Existence of every anchor's line of sight.
    anchors : (J, 3)
        x, y (m) and orientation (rad).
    strength : callable
        Amplitudes (L,) of rays of given distances (L,).
    """
    table, path, existence, value, points = _described(belief, bank, sight, anchors, most_bounces)
    rays = Rays(path, existence, np.ones(len(path)), (len(bank), len(anchors)))
    points[rays.bounces < 2, 2], points[rays.bounces < 1, 1] = np.nan, np.nan
    identity = np.append(bank.identity, -1)
    return table, PathEstimate(
        rays.anchor.astype(np.intp),
        identity[path[:, 1:3]],
        value[:, 0],
        value[:, 1],
        value[:, 2],
        strength(rays, value[:, 0]),
        existence,
        points,
    )


def _described(
    belief: Belief, bank: Bank, sight: Array, anchors: Array, most_bounces: int
) -> tuple[SurfaceEstimate, Whole, Array, Array, Array]:
    """Surfaces; of the paths told of: table (L, 4), existence (L,), values (L, 3), corners (L, 4, 2)."""
    runtime.start()
    from gridslam.kernels.readout import describe

    places = len(anchors)
    bank.check(belief, places, len(sight))
    count = len(bank)
    table = np.empty((count, 16))
    most = 1 + places * listed_at_most(count, most_bounces)
    told = runtime.lasting("described", (most, count), lambda: _room(most, count))
    state, path, existence, predicted, drawn, found = told
    describe(
        belief.mean, belief.covariance, bank.extent, bank.reflection, most_bounces, anchors, bank.existence,
        bank.owner, sight, bank.single, bank.double, state, table, path, existence, predicted, drawn, found,
    )  # fmt: skip
    several = int(found[0])
    surfaces = SurfaceEstimate(
        bank.identity, table[:, 6:8], table[:, 8:12].reshape(-1, 2, 2), table[:, :2],
        table[:, 2:6].reshape(-1, 2, 2), table[:, 12], table[:, 13], bank.existence.copy(), table[:, 14:],
        bank.owner,
    )  # fmt: skip
    corners = drawn[:several, :8].copy().reshape(-1, 4, 2)
    return surfaces, path[:several], existence[:several].copy(), predicted[:several].copy(), corners


def _room(most: int, surfaces: int) -> tuple[Array, Whole, Array, Array, Array, Whole]:
    """What `describe` fills in of so many paths, between scratch and their number."""
    path, existence, predicted = np.empty((most, 4), np.int32), np.empty(most), np.empty((most, 3))
    return (
        np.empty((3 + 3 * surfaces, 1)),
        path,
        existence,
        predicted,
        np.empty((most, 13)),
        np.empty(1, np.int32),
    )
