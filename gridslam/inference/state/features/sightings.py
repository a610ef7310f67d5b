"""From where features and anchors were heard: what lies between is open, and mirrors reflect there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

APART_M = 0.2
"""A place from which something was heard is kept if all that are kept of it are farther off than this."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """Places of the agent, H of them, and what was heard there.

    They grow with the length of the way, not with time.

    Attributes
    ----------
    identity : (H,) int64
        Number of a feature; ``-1 - j``: the line of sight to anchor j.
    agent_m : (H, 2) float64, m
        Where the agent was believed to be.
    """

    identity: NDArray[np.int64]
    agent_m: Array

    @classmethod
    def none(cls) -> Self:
        """Before the first step."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 2)))

    def __len__(self) -> int:
        return len(self.identity)

    def of(self, identity: int) -> Array:
        """From where one was heard, (n, 2) m."""
        places: Array = self.agent_m[self.identity == identity]
        return places

    def add(self, identity: NDArray[np.int64], agent_m: Array) -> Self:
        """These (n,) were heard from a place (2,), too."""
        near = self.identity[((self.agent_m - agent_m) ** 2).sum(1) < APART_M**2]
        new = identity[~np.isin(identity, near)]
        if not len(new):
            return self
        places = np.concatenate([self.agent_m, np.tile(agent_m, (len(new), 1))])
        return type(self)(np.concatenate([self.identity, new]), places)

    def keep(self, identity: NDArray[np.int64]) -> Self:
        """Those of these features, and the lines of sight."""
        rows = (self.identity < 0) | np.isin(self.identity, identity)
        return type(self)(self.identity[rows], self.agent_m[rows])
