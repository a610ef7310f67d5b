"""Predicted parameters of paths, linearised at the mean of the belief; owner of that kernel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.belief import Belief
from gridslam.inference.particles import Cloud, Draft, Particles, Recipe, Single
from gridslam.inference.rays import P_APPEAR, P_STAY, Rays, listed_at_most
from gridslam.inference.surfaces import Bank

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """Predicted parameters of paths at the mean of the belief.

    Attributes
    ----------
    whole : (L, 12)
        Both of the following, as the kernel leaves them.
    """

    whole: Array

    @property
    def value(self) -> Array:
        """Distance (m), AoD and AoA relative to anchor and heading (rad), (L, 3)."""
        return self.whole[:, :3]

    @property
    def spread(self) -> Array:
        """Covariance from the belief alone, (L, 3, 3)."""
        return self.whole[:, 3:].reshape(-1, 3, 3)


def foresee(
    bank: Bank, sight: Array, belief: Belief, anchors: Array, anchor: int, most_bounces: int,
    particles: Particles, few: Array,
) -> tuple[Rays, Prediction, Recipe]:  # fmt: skip
    """All paths worth a look from `anchor`, with their existence one step ahead, and as they are predicted.

    What is told lasts until the anchor's paths are foreseen again.

    Parameters
    ----------
    sight : (J,)
        Existence of every anchor's line of sight.
    anchors : (J, 3)
        x, y (m) and orientation (rad).
    particles : Particles
        How to draw these comes along.
    few : (N, R)
        Standard normal points of some exact samples, which come with that.
    """
    if not 0 <= anchor < len(anchors):
        raise ValueError("there is no such anchor")
    count, kept = particles.ask(belief)
    rays, predicted, (root, base, samples) = _listed(
        bank, sight, belief, anchors, anchor, most_bounces, P_STAY, P_APPEAR, kept, few
    )
    return rays, predicted, Recipe(root, base, particles.points, count, kept, samples)


def paths_now(bank: Bank, sight: Array, belief: Belief, anchors: Array, most_bounces: int) -> Rays:
    """All paths worth a look from any anchor, anchor by anchor, with their existence as it is now."""
    none = np.empty((len(belief.mean), 0))
    return _listed(bank, sight, belief, anchors, -1, most_bounces, 1.0, 0.0, 0.0, none)[0]


def _listed(
    bank: Bank, sight: Array, belief: Belief, anchors: Array, anchor: int, most_bounces: int, stay: float,
    appear: float, kept: float, points: Array,
) -> tuple[Rays, Prediction, tuple[Single, Single, Cloud]]:  # fmt: skip
    runtime.start()
    from gridslam.kernels.rays import foresee

    among = count, places = len(bank), len(anchors)
    bank.check(belief, places, len(sight))
    most = (places if anchor < 0 else 1) * listed_at_most(count, most_bounces)
    size, samples = shape = points.shape
    if size != len(belief.mean):
        raise ValueError(f"points of {size} entries for a belief of {len(belief.mean)}")
    site, room = f"paths {anchor}", (most, *shape)
    ready, told = runtime.lasting(site, room, lambda: (Draft.of(size, samples), _room(most)))
    table, existence, surfaces, predicted, found = told
    mean, covariance = belief.mean, belief.covariance
    foresee(
        anchor, most_bounces, stay, appear, mean, covariance, anchors, bank.existence, bank.owner, sight,
        bank.single, bank.double, math.sqrt(1 - kept), points, *ready, table, existence, surfaces, predicted,
        found,
    )  # fmt: skip
    count = int(found[0])
    table, predicted = runtime.lasting(
        f"listed {anchor}", (id(table), count), lambda: (table[:count], predicted[:count])
    )
    rays = Rays(table, existence[:count], surfaces[:count], among)
    return rays, Prediction(predicted), ready.drawn(belief, kept, points)


def _room(most: int) -> tuple[NDArray[np.int32], Array, Array, Array, NDArray[np.int32]]:
    """Table, existence, surfaces and prediction of so many paths, and room for their number."""
    table, found = np.empty((most, 4), np.int32), np.empty(1, np.int32)
    return table, np.empty(most), np.empty(most), np.empty((most, 12)), found
