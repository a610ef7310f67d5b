"""What users see of a belief: surfaces and paths as tables of their own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gridslam.estimates import PathEstimate, SurfaceEstimate
from gridslam.inference.belief import Belief
from gridslam.inference.rays import Rays, predict_paths, rays_of
from gridslam.inference.surfaces import Bank, canonical_lines
from gridslam.signal import REFLECTION_BINS

Array = NDArray[np.float64]


def surface_estimate(belief: Belief, bank: Bank) -> SurfaceEstimate:
    """Table of all potential surfaces."""
    line, covariance = canonical_lines(belief)
    mean = bank.reflection @ REFLECTION_BINS
    variance = bank.reflection @ REFLECTION_BINS**2 - mean**2
    flip = belief.lines[:, 1] < 0  # the tangent turns with the normal
    extent = np.where(flip[:, None], -bank.extent[:, ::-1], bank.extent)
    return SurfaceEstimate.from_lines(line, covariance, mean, variance, bank.existence, extent, bank.identity)


def path_estimate(
    belief: Belief, bank: Bank, sight: Array, places: Array, facings: Array, most_bounces: int,
    strength: Callable[[int, Rays, Array], Array],
) -> PathEstimate:  # fmt: skip
    """Table of the paths believed in, over the surfaces as they stand.

    Parameters
    ----------
    strength : callable
        Amplitudes (L,) of an anchor's rays of given distances (L,).
    """
    tables = []
    identity = np.append(bank.identity, -1)
    for anchor in range(len(places)):
        rays = rays_of(bank, sight, anchor, most_bounces, now=True)
        chance = rays.existence * rays.surfaces
        rows = np.flatnonzero(chance > 0.5)
        found = predict_paths(rays, rows, belief, places[anchor], float(facings[anchor]))
        good = found.geometry.valid
        rows, value = rows[good], found.value[good]
        double = rays.bounces[rows] == 2
        points = np.full((len(rows), 4, 2), np.nan)
        points[:, 0], points[:, 3] = places[anchor], belief.mean[:2]
        points[:, 1] = found.geometry.first_point[good]
        points[double, 2] = found.geometry.last_point[good][double]
        tables.append(
            PathEstimate(
                np.full(len(rows), anchor),
                np.stack([identity[rays.last[rows]], identity[rays.first[rows]]], -1),
                value[:, 0],
                value[:, 1],
                value[:, 2],
                strength(anchor, rays.take(rows), value[:, 0]),
                chance[rows],
                points,
            )
        )
    return PathEstimate.stack(tables)
