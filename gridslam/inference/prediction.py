"""Predicted parameters of paths, linearised at the mean of the belief; owner of that kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.belief import Belief
from gridslam.inference.rays import Rays

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


def predict_paths(rays: Rays, belief: Belief, anchors: Array) -> Prediction:
    """Predict all rays; anchors (J, 3) are x, y (m) and orientation (rad)."""
    runtime.start()
    from gridslam.kernels.gaussian import predict

    rays.check(len(belief.lines), len(anchors))
    out = np.zeros((len(rays), 12))
    if len(rays):
        mean = np.ascontiguousarray(belief.mean)
        covariance = np.ascontiguousarray(belief.covariance)
        predict(mean, covariance, rays.table, anchors, out)
    return Prediction(out)
