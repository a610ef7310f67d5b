"""Tables of surfaces and of learned features, made by hand."""

import numpy as np

from gridslam.estimate_tables import MIRROR, FeatureEstimate, SurfaceEstimate

LINES = np.array([[0.2, 6.0], [1.9, 5.0]])
ANCHOR = np.array([3.0, 4.0])


def surfaces(lines=LINES, deviation=(0.02, 0.05)):
    count = len(lines)
    normal = np.column_stack([np.cos(lines[:, 0]), np.sin(lines[:, 0])])
    square = np.tile(np.diag(np.square(deviation)), (count, 1, 1))
    return SurfaceEstimate(
        np.arange(count), 2 * lines[:, 1:] * normal, square, lines, square, np.full(count, 0.7),
        np.full(count, 0.01), np.full(count, 0.9), np.full((count, 2), np.nan), np.full(count, -1),
    )  # fmt: skip


def learned(position, **more):
    """A table of features of one anchor, well known."""
    count = len(position)
    whole = {
        "identity": np.arange(count), "anchor": np.zeros(count, np.int64),
        "anchor_m": np.tile(ANCHOR, (count, 1)), "position_m": np.array(position),
        "bias_m": np.zeros(count), "variance": np.array([1.0, 0.9, 0.4, 0.4])[:count],
        "noise": np.ones(count),
        "covariance": np.tile(1e-3 * np.eye(4), (count, 1, 1)), "kind": np.full(count, MIRROR),
        "steps_seen": np.full(count, 50), "last_step": np.full(count, 60),
    }  # fmt: skip
    return FeatureEstimate(**(whole | more))
