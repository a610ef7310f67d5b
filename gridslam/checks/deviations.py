"""Deviations of a table's own that are the squares of what the radio's would be: variances, most likely."""

from __future__ import annotations

import numpy as np

from gridslam.checks.unit_hypotheses import Suspicion
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

ALIKE, OTHER = np.log(3.0), np.log(3.0)
"""Median factor within which values are squares, and beyond which they aren't deviations; logarithms."""
LEAST = 20
"""Rows with a deviation of their own and an amplitude, to tell by."""


def variances(table: Columns, scene: Scene) -> list[Suspicion]:
    """Columns of deviations that are rather variances, by what the radio measures at these amplitudes.

    Parameters
    ----------
    table : dict of (K,) arrays
    """
    if not {"distance_std_m", "amplitude"} <= table.keys():
        return []
    own, amplitude = table["distance_std_m"], table["amplitude"]
    rows = (own > 0) & (amplitude > 0)
    if np.count_nonzero(rows) < LEAST:
        return []
    expected = np.log(scene.signal_model().distance_scale / amplitude[rows])
    given = np.log(own[rows])
    squares, deviations = (float(np.median(np.abs(given - power * expected))) for power in (2, 1))
    if squares > ALIKE or deviations < OTHER or squares > 0.5 * deviations:
        return []
    text = (
        "variances, where standard deviations belong: take roots (of deviations of angles, too, if squared)"
    )
    usual = float(np.exp(np.median(expected)))
    reason = (
        f"median {np.median(own[rows]):.2g}, where this radio's deviation is about {usual:.2g} at these "
        f"amplitudes, and its square {usual**2:.2g}"
    )
    return [Suspicion("distance_std_m", "variances", text, False, reason)]
