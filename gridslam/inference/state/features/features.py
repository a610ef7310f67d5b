"""Learned features: points with an extra length and a power, each of one anchor; docs/model.md, (M125)."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

Indices = NDArray[np.int64]
MOVING, ENTRIES = 4, 3
"""Entries of the joint belief: the agent's [x, y, vx, vy], each feature's [length, direction, extra]."""
CROWD = 8
"""Features of an anchor beyond which they stand for more scatterers than a pulse can tell apart."""
CROWD_EXTENT_M = 0.2
"""Extent of features in a crowd."""


def _all_there(before: dict[str, Any]) -> Array:
    """Presence in older files."""
    return np.ones(len(before["power"]))


@dataclass(frozen=True, eq=False)
class FeatureBank:
    """What is known of F features beside the entries of the joint belief.

    Attributes
    ----------
    identity, anchor : (F,) int64
        Number that a feature keeps; index of the anchor that it is heard from.
    origin_m : (F, 2) float64, m
        From where length and direction are counted: where the agent was when the feature was learned.
    power : (F,) float64
        Mean power at 1 m, in units of the samples squared.
    steps_seen, last_step : (F,) int64
        At how many steps it was heard, and the latest of them.
    presence : (F,) float64
        Probability that its path is there, and not hidden.
    """

    identity: Indices
    anchor: Indices
    origin_m: Array
    power: Array
    steps_seen: Indices
    last_step: Indices
    presence: Array = field(metadata={"later": _all_there})

    @classmethod
    def empty(cls) -> Self:
        """No features."""
        none = np.zeros(0, np.int64)
        return cls(none, none, np.zeros((0, 2)), np.zeros(0), none, none, np.zeros(0))

    def __len__(self) -> int:
        return len(self.power)

    def take(self, rows: NDArray[np.bool_] | Indices) -> Self:
        """Rows chosen by a mask or indices."""
        return type(self)(*(getattr(self, f.name)[rows] for f in fields(self)))

    def add(self, identity: int, anchor: int, origin_m: Array, power: float, step: int) -> Self:
        """One more at an origin (2,), m, with a power at 1 m, heard at this step for the first time."""
        row = type(self)(
            np.array([identity]), np.array([anchor]), np.reshape(origin_m, (1, 2)), np.array([power]),
            np.array([0]), np.array([step]), np.ones(1),
        )  # fmt: skip
        return type(self)(
            *(np.concatenate([getattr(table, f.name) for table in (self, row)]) for f in fields(self))
        )


def places(mean: Array, origin_m: Array) -> Array:
    """Places and extra lengths (F, 3) m: x, y, b, of features by the joint belief's mean (4 + 3 F,)."""
    length, direction, extra = mean[MOVING:].reshape(-1, ENTRIES).T
    far = length - extra
    return np.stack(
        [origin_m[:, 0] + far * np.cos(direction), origin_m[:, 1] + far * np.sin(direction), extra], 1
    )


def entries(place: Array, origin_m: Array) -> Array:
    """Length, direction and extra length (3,) of a feature [x, y, b] as seen from an origin (2,)."""
    way = place[:2] - origin_m
    return np.array([np.hypot(*way) + place[2], np.arctan2(way[1], way[0]), place[2]])


def place_jacobian(mean: Array) -> Array:
    """Slopes of `places` by each feature's own entries, (F, 3, 3)."""
    length, direction, extra = mean[MOVING:].reshape(-1, ENTRIES).T
    c, s, far = np.cos(direction), np.sin(direction), length - extra
    zero, one = np.zeros_like(c), np.ones_like(c)
    rows = [[c, -far * s, -c], [s, far * c, -s], [zero, zero, one]]
    return np.moveaxis(np.array(rows).reshape(3, 3, -1), -1, 0)
