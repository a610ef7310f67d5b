"""Walls as a floor plan draws them, and the units that drawings are in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gridslam.errors import InputError

MOST_PIECES, LARGEST_BYTES = 20_000, 2**26
NAMED_M = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Units of drawings and GeoJSON, as --unit names them."""


@dataclass(frozen=True)
class Line:
    """One wall of a plan.

    Attributes
    ----------
    points : tuple of (x, y), m
        Corners of a polyline; empty for an arc.
    material : str
    closed : bool
        Whether the last corner joins the first.
    reflection : float or None
        Amplitude reflection coefficient that the file gives.
    name : str or None
    arc : dict or None
        An arc as in scene files.
    """

    points: tuple[tuple[float, float], ...]
    material: str = "concrete"
    closed: bool = False
    reflection: float | None = None
    name: str | None = None
    arc: Mapping[str, Any] | None = None

    @property
    def wall(self) -> dict[str, Any]:
        """The entry of a scene file."""
        entry: dict[str, Any] = {"name": self.name} if self.name else {}
        entry["material"] = self.material
        if self.arc is not None:
            return entry | {"arc": dict(self.arc)}
        entry["points_m"] = [list(point) for point in self.points]
        return entry | {"closed": True} if self.closed else entry


def unit_m(unit: str) -> float:
    """Metres in a unit that --unit names.

    Raises
    ------
    InputError
        It isn't one of `NAMED_M`.
    """
    if unit not in NAMED_M:
        raise InputError("--unit", repr(unit), ", ".join(NAMED_M))
    return NAMED_M[unit]
