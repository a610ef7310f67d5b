"""Predicted parameters of paths, linearised at the mean of the belief; owner of that kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.belief import Belief
from gridslam.inference.rays import P_APPEAR, P_STAY, Rays
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
    bank: Bank, sight: Array, belief: Belief, anchors: Array, anchor: int, most_bounces: int
) -> tuple[Rays, Prediction]:
    """All paths worth a look from `anchor`, with their existence one step ahead, and as they are predicted.

    Parameters
    ----------
    sight : (J,)
        Existence of every anchor's line of sight.
    anchors : (J, 3)
        x, y (m) and orientation (rad).
    """
    if not 0 <= anchor < len(anchors):
        raise ValueError("there is no such anchor")
    return _listed(bank, sight, belief, anchors, anchor, most_bounces, P_STAY, P_APPEAR)


def paths_now(
    bank: Bank, sight: Array, belief: Belief, anchors: Array, most_bounces: int
) -> tuple[Rays, Prediction]:
    """All paths worth a look from any anchor, anchor by anchor, with their existence as it is now."""
    return _listed(bank, sight, belief, anchors, -1, most_bounces, 1.0, 0.0)


def _listed(
    bank: Bank, sight: Array, belief: Belief, anchors: Array, anchor: int, most_bounces: int, stay: float,
    appear: float,
) -> tuple[Rays, Prediction]:  # fmt: skip
    runtime.start()
    from gridslam.kernels.rays import foresee as launch

    count, places = among = len(bank), len(anchors)
    if not (
        len(belief.lines) == len(bank.existence) == len(bank.owner) == count
        and len(sight) == places
        and bank.single.shape == (places, count)
        and bank.double.shape == (places, count, count)
    ):
        raise ValueError("surfaces or anchors don't belong together")
    # line of sight, S single and S (S - 1) double bounces
    room = (len(anchors) if anchor < 0 else 1) * (1 + len(bank) ** 2)
    table, found = np.empty((room, 4), np.int32), runtime.scratch("found", (1,), np.int32)
    existence, surfaces, predicted = np.empty(room), np.empty(room), np.empty((room, 12))
    launch(
        anchor, most_bounces, stay, appear, belief.mean, belief.covariance, anchors, bank.existence,
        bank.owner, sight, bank.single, bank.double, table, existence, surfaces, predicted, found,
    )  # fmt: skip
    count = int(found[0])
    return Rays(table[:count], existence[:count], surfaces[:count], among), Prediction(predicted[:count])
