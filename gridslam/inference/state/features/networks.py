"""Networks that say where features are, as [HybridSlam], section VI, has them; docs/model.md, (M324)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from gridslam.arrays import Array

HIDDEN = 64
"""Units of either hidden layer; the paper prints none."""
FEATURES = 30
"""Of every anchor."""
PLACES_M, POWER = 35.0, 0.1
"""Features start uniformly in a square of twice this side, with this share of the line of sight's power."""
SCALE_M = 10.0
"""By which anchors' places are divided."""


@dataclass(frozen=True, eq=False)
class Network:
    """Two hidden layers, what they were moved by before, and how often.

    Attributes
    ----------
    weights : tuple of Array
        (H, 2), (H,), (H, H), (H,), (n, H), (n,): a matrix and a vector of every layer.
    first, second : tuple of Array
        Adam's running means of slopes and of their squares, shaped like the weights.
    moves : int
    """

    weights: tuple[Array, ...]
    first: tuple[Array, ...]
    second: tuple[Array, ...]
    moves: int

    @classmethod
    def drawn(cls, draw: np.random.Generator, anchors: Array, target: Array) -> Self:
        """One whose outputs at the anchors (J, 2) are those asked for, (J, n), by the last layer alone."""
        inner = (
            draw.normal(size=(HIDDEN, 2)), np.zeros(HIDDEN),
            draw.normal(size=(HIDDEN, HIDDEN)) * np.sqrt(2 / HIDDEN), np.zeros(HIDDEN),
        )  # fmt: skip
        units = hidden(inner, anchors)[1]
        outer = np.linalg.lstsq(units, target, rcond=None)[0].T
        weights = (*inner, np.ascontiguousarray(outer), np.zeros(target.shape[1]))
        zeros = tuple(np.zeros_like(one) for one in weights)
        return cls(weights, zeros, zeros, 0)

    def at(self, anchors: Array) -> Array:
        """Outputs (J, n) at anchors (J, 2)."""
        out: Array = hidden(self.weights, anchors)[1] @ self.weights[4].T + self.weights[5]
        return out


def hidden(weights: tuple[Array, ...], anchors: Array) -> tuple[Array, Array]:
    """Units (J, H) of both hidden layers."""
    one = np.maximum(anchors / SCALE_M @ weights[0].T + weights[1], 0.0)
    return one, np.maximum(one @ weights[2].T + weights[3], 0.0)


@dataclass(frozen=True, eq=False)
class FeatureNetworks:
    """Places and extra lengths of all features by one network, their powers by another.

    Attributes
    ----------
    places, powers : Network
        Of 3 and 1 outputs for every feature: x, y, extra length, m; power in units of the line of sight's.
    """

    places: Network
    powers: Network

    @classmethod
    def drawn(cls, anchors: Array, seed: list[int]) -> Self:
        """From random places."""
        draw, count = np.random.default_rng(seed), len(anchors)
        place = draw.uniform(-PLACES_M, PLACES_M, (count, FEATURES, 3))
        place[..., 2] = draw.uniform(0.0, 1.0, place.shape[:2])
        places = Network.drawn(draw, anchors, place.reshape(count, -1))
        return cls(places, Network.drawn(draw, anchors, np.full((count, FEATURES), POWER)))
