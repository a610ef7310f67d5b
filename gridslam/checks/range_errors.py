"""What spoils all distances of an anchor in the same way: clocks that disagree, and heights that do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gridslam.arrays import Array

MOST_OFFSET_M, MOST_HEIGHT_M = 10.0, 8.0
"""Within which they are looked for."""
LEAST_OFFSET_M, LEAST_HEIGHT_M = 0.3, 0.7
"""Smaller ones aren't told of: a receiver's own bias, or a map that is drawn roughly, makes them, too."""
SHRINKAGE = 0.98
"""Of the spread of particles at each redrawing (Liu and West, 2001); noise makes up for it."""


@dataclass(frozen=True)
class RangeError:
    """An error of unknown size in the distances of some anchors.

    Attributes
    ----------
    kind : str
        "offset" adds a constant; "slant" makes the hypotenuse of the distance and a height difference.
    anchors : tuple of int
        Whose distances have it, as indices into the scene's.
    """

    kind: str
    anchors: tuple[int, ...]

    @property
    def least_m(self) -> float:
        """The smallest size worth telling of, m."""
        return LEAST_HEIGHT_M if self.kind == "slant" else LEAST_OFFSET_M

    def start(self, count: int, draw: np.random.Generator) -> Array:
        """Sizes (N,) in m that are possible beforehand, evenly spread."""
        if self.kind == "slant":
            return draw.uniform(0, MOST_HEIGHT_M, count)
        return draw.uniform(-MOST_OFFSET_M, MOST_OFFSET_M, count)

    def redrawn(self, size: Array, draw: np.random.Generator) -> Array:
        """Sizes (N,) moved a little, mean and spread kept, so that particles stay apart."""
        mean, spread = size.mean(), size.std()
        noise = np.sqrt(1 - SHRINKAGE**2) * spread * draw.standard_normal(len(size))
        return mean + SHRINKAGE * (size - mean) + noise

    def spoilt(self, distance: Array, size: Array, anchor: int) -> Array:
        """What is measured (N,) in m for true horizontal distances (N,)."""
        if anchor not in self.anchors:
            return distance
        return np.hypot(distance, size) if self.kind == "slant" else distance + size
