"""What users see of a belief: surfaces and paths as tables of their own; owner of their kernel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.estimates import PathEstimate, SurfaceEstimate
from gridslam.inference.state.belief import Belief
from gridslam.inference.state.rays import Rays, listed_at_most
from gridslam.inference.state.surface_bank import Bank

Array = NDArray[np.float64]
Whole = NDArray[np.int32]
Long = NDArray[np.int64]


def surface_estimate(belief: Belief, bank: Bank) -> SurfaceEstimate:
    """Table of all potential surfaces."""
    return estimates(belief, bank, np.zeros(0), np.zeros((0, 3)), 0, 0.0)[0]


def estimates(
    belief: Belief, bank: Bank, sight: Array, anchors: Array, most_bounces: int, at_1m: float,
    strength: Callable[[Rays, Array], Array] | None = None,
) -> tuple[SurfaceEstimate, PathEstimate]:  # fmt: skip
    """Tables of all potential surfaces, and of the paths believed in over them as they stand.

    Parameters
    ----------
    sight : (J,)
        Existence of every anchor's line of sight.
    anchors : (J, 3)
        x, y (m) and orientation (rad).
    at_1m : float
        Amplitude of a line of sight 1 m long: others follow from coefficients (paper 003, eq. (2)).
    strength : callable, optional
        Amplitudes (L,) of rays of given distances (L,), if they are known otherwise.
    """
    runtime.start()
    from gridslam.kernels.management.readout import describe

    count, places = len(bank), len(anchors)
    bank.check(belief, places, len(sight))
    table = np.empty((count, 16))
    most = 1 + places * listed_at_most(count, most_bounces)
    room = runtime.lasting("described", (most, count), lambda: _room(most, count))
    state, path, drawn, number, told, found = room
    describe(
        belief.mean, belief.covariance, bank.extent, bank.reflection, most_bounces, anchors, bank.existence,
        bank.owner, sight, bank.single, bank.double, bank.identity, at_1m, state, table, path, drawn, number,
        told, found,
    )  # fmt: skip
    several = int(found[0])
    surfaces = SurfaceEstimate(
        bank.identity, table[:, 6:8], table[:, 8:12].reshape(-1, 2, 2), table[:, :2],
        table[:, 2:6].reshape(-1, 2, 2), table[:, 12], table[:, 13], bank.existence.copy(), table[:, 14:],
        bank.owner,
    )  # fmt: skip
    number, told = number[:several].copy(), told[:several].copy()
    amplitude = told[:, 3]
    if strength is not None:
        rays = Rays(path[:several], told[:, 4].copy(), np.ones(several), (count, places))
        amplitude = strength(rays, told[:, 0].copy())
    return surfaces, PathEstimate(
        number[:, 0], number[:, 1:], told[:, 0], told[:, 1], told[:, 2], amplitude, told[:, 4],
        told[:, 5:].reshape(-1, 4, 2),
    )  # fmt: skip


def _room(most: int, surfaces: int) -> tuple[Array, Whole, Array, Long, Array, Whole]:
    """What `describe` fills in of so many paths, after scratch, and their number."""
    return (
        np.empty((3 + 3 * surfaces, 1)), np.empty((most, 4), np.int32), np.empty((most, 13)),
        np.empty((most, 3), np.int64), np.empty((most, 13)), np.empty(1, np.int32),
    )  # fmt: skip
