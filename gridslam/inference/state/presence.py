"""Whether single bounces are there, given the coefficients of their surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.radio import BINS

FRESH_SIGHT = 0.9
"""Probability of an anchor's line of sight before anything was heard."""


@dataclass(frozen=True, eq=False)
class Presence:
    """Chance that single bounces were there when they were last listened for, for each coefficient.

    Attributes
    ----------
    identity : (S,) int64
        Of the surfaces.
    chance : (J, S, BINS)
        By anchor and `REFLECTION_BINS`; -1 where nothing was heard yet.
    """

    identity: NDArray[np.int64]
    chance: Array

    @classmethod
    def none(cls, anchors: int) -> Self:
        """Of no surfaces."""
        return cls(np.zeros(0, np.int64), np.zeros((anchors, 0, BINS)))

    def of(self, identity: NDArray[np.int64]) -> Self:
        """That of other surfaces (S,), of which some may be new."""
        chance = np.full((len(self.chance), len(identity), BINS), -1.0)
        same = identity[:, None] == self.identity
        known = same.any(1)
        chance[:, known] = self.chance[:, same.argmax(1)[known]] if len(self.identity) else 0.0
        return type(self)(identity.copy(), chance)
