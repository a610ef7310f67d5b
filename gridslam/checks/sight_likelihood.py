"""How likely rows of a table are the line of sight to an anchor, against any path: what `check` weighs by.

It is blunt on purpose: the standard deviations are wide, and what any path would give is how dense the
column's own values lie.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.geometry import wrap
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene

ANGLE_STD = np.radians(5.0)
LEAST_DISTANCE_STD_M = 0.1
QUANTITIES = ("distance_m", "aod_rad", "aoa_rad")
TURN = 2 * np.pi


@dataclass(frozen=True)
class _Quantity:
    """A column, as the likelihood of a line of sight takes it.

    Attributes
    ----------
    values : (K,) float64
        0 where not measured.
    precision : (K,) float64
        One over the standard deviation; 0 where not measured.
    peak : (K,) float64
        Density of the line of sight at its best, over that of any path; 1 where not measured.
    turns : bool
        Whether it is an angle.
    """

    values: Array
    precision: Array
    peak: Array
    turns: bool


@dataclass(frozen=True)
class SightLikelihood:
    """Likelihood of the K rows of a table as lines of sight, over that of any path.

    Attributes
    ----------
    quantities : dict of _Quantity
        The columns that there are.
    peak : (K,) float64
        The ratio where all of them are as expected.
    """

    quantities: dict[str, _Quantity]
    peak: Array

    @classmethod
    def of(cls, columns: Mapping[str, NDArray], scene: Scene) -> SightLikelihood:
        """Of a table's columns, see `line_of_sight_filter.explain`."""
        quantities = {name: _quantity(columns, name, scene) for name in QUANTITIES if name in columns}
        peak = np.ones(len(columns["step"]))
        for quantity in quantities.values():
            peak *= quantity.peak
        return cls(quantities, peak)

    def ratio(self, rows: NDArray[np.intp], whose: NDArray[np.intp], expected: Mapping[str, Array]) -> Array:
        """The ratios (M, P) of some rows (M,) at P particles.

        Parameters
        ----------
        whose : (M,) int
            Which of the A scans each row is of.
        expected : dict of (A, P) arrays
            What each particle expects of each scan.
        """
        exponent = np.zeros((len(rows), expected["distance_m"].shape[1]))
        for name, quantity in self.quantities.items():
            gap = quantity.values[rows, None] - expected[name][whose]
            if quantity.turns:
                gap -= TURN * np.rint(gap / TURN)
            gap *= quantity.precision[rows, None]
            gap *= gap
            exponent += gap
        exponent *= -0.5
        return self.peak[rows, None] * np.exp(exponent, out=exponent)


def _quantity(columns: Mapping[str, NDArray], name: str, scene: Scene) -> _Quantity:
    values, turns = np.asarray(columns[name], dtype=np.float64), name.endswith("_rad")
    least = ANGLE_STD if turns else max(LEAST_DISTANCE_STD_M, 0.5 * SPEED_OF_LIGHT / scene.radio.bandwidth_hz)
    own = columns.get("distance_std_m" if name == "distance_m" else name.replace("rad", "std_rad"))
    sigma = np.hypot(least, np.nan_to_num(own) if own is not None else np.zeros(len(values)))
    missing = np.isnan(values)
    usual = _density(np.asarray(wrap(values)) if turns else values)  # spread over turns they'd seem rarer
    return _Quantity(
        np.where(missing, 0.0, values),
        np.where(missing, 0.0, 1 / sigma),
        np.where(missing, 1.0, 1 / (np.sqrt(2 * np.pi) * sigma * usual)),
        turns,
    )


def _density(values: Array) -> Array:
    """How dense the column's own values lie about each of them, by quantiles: what chance would give (K,).

    Without it, whatever reading draws the values together would look like a discovery.
    """
    known = values[np.isfinite(values)]
    bins = int(np.clip(len(known) // 10, 1, 16))
    edges = np.quantile(known, np.linspace(0, 1, bins + 1)) if len(known) else np.array([0.0, 1.0])
    width = np.maximum(np.diff(edges), 1e-9)
    return 1 / (bins * width[np.clip(np.searchsorted(edges, values, side="right") - 1, 0, bins - 1)])
