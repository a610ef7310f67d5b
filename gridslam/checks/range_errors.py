"""What spoils all distances of an anchor in the same way: clocks that disagree, and heights that do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gridslam.arrays import Array
from gridslam.world.geometry import level_of, slant

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
        "offset" adds a constant; "slant" is a height difference other than the scene's.
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

    def spoilt(self, level: Array, size: Array, anchor: int, height: float) -> Array:
        """What is measured (N,) in m for true horizontal distances (N,).

        `height` is that of the anchor above the agent by the scene; a slant range has `size` in its place.
        """
        if anchor not in self.anchors:
            return slant(level, height)
        return slant(level, size) if self.kind == "slant" else slant(level, height) + size

    def cured(self, distance: Array, size: float, height: Array) -> Array:
        """What would have been measured without it."""
        if self.kind == "slant":
            return slant(np.maximum(level_of(distance, size), 1e-2), height)
        return distance - size
