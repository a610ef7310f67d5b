"""What published methods believe: particles of the agent and of every potential feature, each apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array


@dataclass(frozen=True, eq=False)
class Features:
    """Potential features, F rows of P particles; the first of each anchor is the anchor itself.

    Attributes
    ----------
    identity, anchor : (F,) int64
    fixed : (F,) bool
        Whether it is the anchor itself, of known place.
    existence : (F,)
    position : (F, P, 2) m
    intensity : (F, P)
        Mean power of its path (direct SLAM), or its normalised amplitude.
    """

    identity: NDArray[np.int64]
    anchor: NDArray[np.int64]
    fixed: NDArray[np.bool_]
    existence: Array
    position: Array
    intensity: Array

    def __len__(self) -> int:
        return len(self.identity)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Self:
        """Some of the features."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def put(self, rows: NDArray[np.intp], other: Features) -> Self:
        """The same with `other` in place of some rows."""
        columns = {f.name: getattr(self, f.name).copy() for f in fields(self)}
        for name, column in columns.items():
            column[rows] = getattr(other, name)
        return replace(self, **columns)

    @classmethod
    def of(cls, parts: Sequence[Features]) -> Self:
        """Those of several tables, at least one, below one another."""
        return cls(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)})

    def joined(self, other: Features) -> Self:
        """These and then the others."""
        pairs = {f.name: (getattr(self, f.name), getattr(other, f.name)) for f in fields(self)}
        return replace(self, **{name: np.concatenate(pair) for name, pair in pairs.items()})


@dataclass(frozen=True, eq=False)
class ParticleState:
    """The state of direct SLAM as published, equally weighted after each step.

    Attributes
    ----------
    agent : (P, 4) m, m/s
    noise : (J, P)
        Power of the noise in a sample; 0 before the anchor was heard.
    features : Features
    step, next_identity : int
    time_s : float or None
    """

    agent: Array
    noise: Array
    features: Features
    step: int = 0
    next_identity: int = 0
    time_s: float | None = None


@dataclass(frozen=True, eq=False)
class ImageState:
    """The state of SLAM by virtual anchors as published, equally weighted after each step.

    Attributes
    ----------
    agent : (P, 5) m, m/s, rad
        Position, velocity, heading.
    features : Features
        Lines of sight first, then potential virtual anchors; `intensity` is the amplitude of the path.
    step, next_identity : int
    time_s : float or None
    """

    agent: Array
    features: Features
    step: int = 0
    next_identity: int = 0
    time_s: float | None = None
