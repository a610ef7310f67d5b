"""How likely rows of a table are the line of sight to an anchor, against any path: what `check` weighs by.

It is blunt on purpose: the standard deviations are wide, and what any path would give is how dense the
column's own values lie.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.kernels.primitives.sights import PEAK, SURE, VALUES
from gridslam.world.geometry import wrap
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene

ANGLE_STD = np.radians(5.0)
LEAST_DISTANCE_STD_M = 0.1
QUANTITIES = ("distance_m", "aod_rad", "aoa_rad")


def rows_of(columns: Mapping[str, NDArray], scene: Scene) -> Array:
    """The K rows of a table as `gridslam.kernels.primitives.sights.Sights` takes them, (K, 7).

    Parameters
    ----------
    columns : dict of (K,) arrays
        As of `gridslam.checks.sights.line_of_sight_filter.explain`.
    """
    rows = np.zeros((len(columns["step"]), PEAK + 1))
    rows[:, PEAK] = 1.0
    for number, name in enumerate(QUANTITIES):
        if name not in columns:
            continue
        values, angle = np.asarray(columns[name], dtype=np.float64), name.endswith("_rad")
        resolution = 0.5 * SPEED_OF_LIGHT / scene.radio.bandwidth_hz
        least = ANGLE_STD if angle else max(LEAST_DISTANCE_STD_M, resolution)
        own = columns.get("distance_std_m" if name == "distance_m" else name.replace("rad", "std_rad"))
        sigma = np.hypot(least, np.nan_to_num(own) if own is not None else np.zeros(len(values)))
        known = np.isfinite(values)
        usual = _density(np.asarray(wrap(values)) if angle else values)  # spread over turns they'd seem rarer
        rows[:, VALUES + number] = np.where(known, values, 0.0)
        rows[:, SURE + number] = np.where(known, 1 / sigma, 0.0)
        rows[known, PEAK] /= (np.sqrt(2 * np.pi) * sigma * usual)[known]
    return rows


def _density(values: Array) -> Array:
    """How dense the column's own values lie about each of them, by quantiles: what chance would give (K,).

    Without it, whatever reading draws the values together would look like a discovery.
    """
    edges = _edges(np.asarray(values, np.float64).tobytes())
    bins, width = len(edges) - 1, np.maximum(np.diff(edges), 1e-9)
    return 1 / (bins * width[np.clip(np.searchsorted(edges, values, side="right") - 1, 0, bins - 1)])


@lru_cache(maxsize=64)
def _edges(values: bytes) -> Array:
    """Quantiles of a column, as the bytes of float64, the smallest and the greatest among them (B + 1,).

    Readings of a table differ in a column or two: the others are sorted once.
    """
    column = np.frombuffer(values)
    known = column[np.isfinite(column)]
    bins = int(np.clip(len(known) // 10, 1, 16))
    return np.quantile(known, np.linspace(0, 1, bins + 1)) if len(known) else np.array([0.0, 1.0])
