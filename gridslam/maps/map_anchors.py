"""Where anchors stand, as it was learned together with a map's surfaces; docs/model.md, (M569)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.io.covariances import require_covariance

PER_ANCHOR = 3


@dataclass(frozen=True, eq=False)
class MapAnchors:
    """How J anchors stand, correlated with a map's S surfaces. A value.

    Attributes
    ----------
    names : tuple of str
    position_m : (J, 2) float64, m
    orientation_rad : (J,) float64, rad
    covariance : (3 J, 3 J) float64
        Of x, y (m) and orientation (rad) of anchor after anchor.
    cross : (3 J, 2 S) float64
        Covariance with the surfaces' angles (rad) and offsets (m).
    """

    names: tuple[str, ...]
    position_m: Array
    orientation_rad: Array
    covariance: Array
    cross: Array

    def __len__(self) -> int:
        return len(self.names)

    @property
    def columns(self) -> Array:
        """x, y (m), orientation (rad) and their deviations, (6, J)."""
        std = np.sqrt(np.maximum(self.covariance.diagonal(), 0)).reshape(-1, PER_ANCHOR)
        return np.column_stack([self.position_m, self.orientation_rad, std]).T

    def require(self, lines: Array) -> None:
        """Refuse what can't be, beside surfaces whose lines have a joint covariance (2 S, 2 S).

        Raises
        ------
        InputError
        """
        count = len(self)
        shapes = {
            "position_m": (count, 2), "orientation_rad": (count,),
            "covariance": (PER_ANCHOR * count,) * 2, "cross": (PER_ANCHOR * count, len(lines)),
        }  # fmt: skip
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values.shape != shape:
                raise InputError(f"map: anchors: {name}", f"shape {values.shape}", f"{shape}")
            if not np.isfinite(values).all():
                raise InputError(f"map: anchors: {name}", "NaN or infinity", "finite numbers")
        if len(set(self.names)) < count:
            raise InputError("map: anchors: names", "one name twice", "every anchor once")
        joint = np.block([[self.covariance, self.cross], [self.cross.T, lines]])
        require_covariance(joint, "map: covariance of anchors and surfaces")

    def moved(self, by: Array, slope: Array) -> Self:
        """Moved by (2,) m, beside lines that the derivatives (2 S, 2 S) carry along."""
        return replace(self, position_m=self.position_m + by, cross=self.cross @ slope.T)
