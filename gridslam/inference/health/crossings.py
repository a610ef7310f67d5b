"""Where the lines of sight of several anchors cross, at one step; docs/model.md, (M262)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.health.range_fits import Crossing, errors_of
from gridslam.inference.scans.anchor_measurements import AnchorScan, whole_of
from gridslam.kernels.primitives.tables import AMPLITUDE
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import lean, level_of, unit, wrap

SLACK = np.array([0.05, 0.03])
"""Deviations of distance (m) and direction (rad) besides those of the radio: places of anchors are drawn."""
AGREE = 4.0
"""Deviations within which headings agree that follow from two lines of sight."""


def crossing_of(
    scans: Sequence[AnchorScan], deviations: Array, model: FilterModel,
    clear: NDArray[np.bool_] | None = None,
) -> Crossing | None:  # fmt: skip
    """Where the lines of sight of two anchors or more put the agent; None where there aren't two.

    An anchor's is taken to be the shortest of its paths, if that is the loudest, too, and if the heading that
    follows from it is that of another anchor's.

    Parameters
    ----------
    deviations : (M, 3)
        Of all measurements, one anchor's after the other's; as of `own_deviations`.
    clear : (M,) bool, optional
        Which of them can be lines of sight for all that is known of walls.
    """
    begins = accumulate((len(scan) for scan in scans), initial=0)
    first = [(scan.anchor, begin + row) for scan, begin in zip(scans, begins, strict=False)
             if (row := _first(scan)) is not None and (clear is None or clear[begin + row])]  # fmt: skip
    if len(first) < 2:
        return None
    anchor, rows = np.array(first).T
    value, std = whole_of(scans).value[rows], deviations[rows]
    direction = value[:, 1] + model.places[anchor, 2]
    heading = direction + np.pi - value[:, 2]
    reach = AGREE * np.hypot(np.hypot(std[:, 1], std[:, 2]), SLACK[1])
    agree = np.abs(wrap(heading[:, None] - heading)) < np.hypot(reach[:, None], reach)
    known = np.isfinite(std).all(1)
    chosen = known & ((agree & known).sum(1) > 1)
    if np.count_nonzero(chosen) < 2:
        return None
    anchor, distance, direction, std = anchor[chosen], value[chosen, 0], direction[chosen], std[chosen]
    height = model.places[anchor, 3]
    level, steep = level_of(distance, height)[:, None], lean(distance, height)[:, None]
    toward, across = unit(direction), unit(direction + 0.5 * np.pi)
    along = np.hypot(std[:, :1], SLACK[0]) / steep
    aside = level * np.hypot(std[:, 1:2], SLACK[1]) + 1e-3
    precision = (toward[:, :, None] * toward[:, None]) / along[..., None] ** 2
    precision += (across[:, :, None] * across[:, None]) / aside[..., None] ** 2
    slope, n = np.zeros((len(anchor), 2, errors_of(model.senders))), np.arange(len(anchor))
    slope[n, :, anchor], slope[n, :, model.senders + anchor] = toward / steep, level * across
    for axis in (0, 1):
        slope[n, axis, 2 * (model.senders + anchor) + axis] = -1.0
    if not model.anchor_heights.any():
        slope[..., -1] = toward / (2 * distance[:, None])
    return Crossing(model.places[anchor, :2] + level * toward, precision, slope)


def _first(scan: AnchorScan) -> int | None:
    """The row that is an anchor's line of sight, if any is: the shortest path, and the loudest."""
    if not len(scan):
        return None
    length = np.where(scan.measured.all(1), scan.value[:, 0], np.inf)
    row = int(length.argmin())
    if not abs(scan.height) < length[row] < np.inf:
        return None
    return row if scan.amplitude[row] >= scan.table[:, AMPLITUDE].max() else None
