"""What spoils all distances of an anchor in the same way: clocks that disagree, and heights that do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gridslam.arrays import Array
from gridslam.world.geometry import level_of, slant

MOST_OFFSET_M, MOST_HEIGHT_M, MOST_RISE_M = 10.0, 8.0, 3.0
"""Within which they are looked for."""
LEAST_OFFSET_M, LEAST_HEIGHT_M, LEAST_RISE_M = 0.3, 0.7, 0.3
"""Smaller ones aren't told of: a receiver's own bias, or a map that is drawn roughly, makes them, too."""


SHRINKAGE = 0.98
"""Of the spread of particles at each redrawing (Liu and West, 2001); noise makes up for it."""


@dataclass(frozen=True)
class RangeError:
    """An error of unknown size in the distances of some anchors.

    Attributes
    ----------
    kind : str
        "offset" adds a constant; "slant" is a height difference other than the scene's; "rise" is how much
        higher the agent is than the scene says; "plan" leaves heights out, as distances on a floor plan do,
        and has no size.
    anchors : tuple of int
        Whose distances have it, as indices into the scene's.
    """

    kind: str
    anchors: tuple[int, ...]

    @property
    def least_m(self) -> float:
        """The smallest size worth telling of, m."""
        return {"slant": LEAST_HEIGHT_M, "rise": LEAST_RISE_M, "plan": 0.0}.get(self.kind, LEAST_OFFSET_M)

    @property
    def bounds_m(self) -> tuple[float, float]:
        """Sizes between which it is looked for, m."""
        if self.kind == "plan":
            return 0.0, 0.0
        most = {"slant": MOST_HEIGHT_M, "rise": MOST_RISE_M}.get(self.kind, MOST_OFFSET_M)
        return (0.0 if self.kind == "slant" else -most), most

    def start(self, count: int, draw: np.random.Generator) -> Array:
        """Sizes (N,) in m that are possible beforehand, evenly spread."""
        return draw.uniform(*self.bounds_m, count)

    def by_size(self, height: Array) -> Array:
        """How it spoils distances of J anchors, (J, 3).

        Columns: height above the agent but for the size, m; how many times the size is added to the height,
        and to the distance. `height` (J,) in m is that of the scene; see `spoilt`.
        """
        own = np.isin(np.arange(len(height)), self.anchors)
        fixed = np.where(own & (self.kind in ("slant", "plan")), 0.0, height)
        tilt = {"slant": 1.0, "rise": -1.0}.get(self.kind, 0.0)
        return np.column_stack([fixed, own * tilt, own * float(self.kind == "offset")])

    def spoilt(self, level: Array, size: Array, anchor: int, height: float) -> Array:
        """What is measured (N,) in m for true horizontal distances (N,).

        Parameters
        ----------
        level : (N,) m
        size : (N,) m
            Of the error; it broadcasts.
        anchor : int
        height : float
            Above the agent by the scene, m; a slant range has `size` in its place.
        """
        if anchor not in self.anchors:
            return slant(level, height)
        if self.kind == "plan":
            return level
        if self.kind == "rise":
            return slant(level, height - size)
        return slant(level, size) if self.kind == "slant" else slant(level, height) + size

    def cured(self, distance: Array, size: float, height: Array) -> Array:
        """What would have been measured without it, (K,) m.

        Parameters
        ----------
        distance : (K,) m
            As measured.
        size : float
            Of the error, m.
        height : (K,) m
            Of each row's anchor above the agent by the scene.
        """
        if self.kind == "plan":
            return slant(distance, height)
        if self.kind in ("slant", "rise"):
            true = size if self.kind == "slant" else height - size
            return slant(np.maximum(level_of(distance, true), 1e-2), height)
        return distance - size
