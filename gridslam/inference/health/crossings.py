"""Where the lines of sight of several anchors cross, at one step; docs/model.md, (M262)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.health.range_watch import Crossing
from gridslam.inference.state.anchor_measurements import AnchorScan
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import lean, level_of, unit, wrap

SLACK = np.array([0.05, 0.03])
"""Deviations of distance (m) and direction (rad) besides those of the radio: places of anchors are drawn."""
AGREE = 4.0
"""Deviations within which headings agree that follow from two lines of sight."""


def crossing_of(
    scans: Sequence[AnchorScan], deviations: Sequence[Array], model: FilterModel
) -> Crossing | None:
    """Where the lines of sight of two anchors or more put the agent; None where there aren't two.

    An anchor's is taken to be the shortest of its paths, if that is the loudest, too, and if the heading that
    follows from it is that of another anchor's.

    Parameters
    ----------
    deviations : sequence of (M, 3)
        As of `own_deviations`.
    """
    rows, heading, spread = list[tuple[AnchorScan, int]](), list[float](), list[Array]()
    for heard, own in zip(scans, deviations, strict=True):
        row = _first(heard)
        if row is None:
            continue
        value, std = heard.value[row], own[row]
        if np.isfinite(std).all():
            rows.append((heard, row))
            heading.append(float(value[1] + heard.orientation + np.pi - value[2]))
            spread.append(std)
    if len(rows) < 2:
        return None
    stds = np.array(spread)
    apart = np.abs(wrap(np.array(heading)[:, None] - heading))
    reach = AGREE * np.hypot(np.hypot(stds[:, 1], stds[:, 2]), SLACK[1])
    chosen = np.flatnonzero((apart < np.hypot(reach[:, None], reach)).sum(1) > 1)
    if len(chosen) < 2:
        return None
    anchors, size = model.senders, 2 * model.senders + 1
    place, precision = np.empty((len(chosen), 2)), np.empty((len(chosen), 2, 2))
    slope = np.zeros((len(chosen), 2, size))
    for n, k in enumerate(chosen.tolist()):
        (heard, row), std = rows[k], stds[k]
        distance, direction = float(heard.value[row, 0]), float(heard.value[row, 1]) + heard.orientation
        level, steep = float(level_of(distance, heard.height)), float(lean(distance, heard.height))
        toward, across = unit(direction), unit(direction + 0.5 * np.pi)
        place[n] = heard.position + level * toward
        along, aside = np.hypot(std[0], SLACK[0]) / steep, level * np.hypot(std[1], SLACK[1]) + 1e-3
        precision[n] = np.outer(toward, toward) / along**2 + np.outer(across, across) / aside**2
        slope[n, :, heard.anchor] = toward / steep
        slope[n, :, anchors + heard.anchor] = level * across
        if not model.anchor_heights.any():
            slope[n, :, -1] = toward / (2 * distance)
    return Crossing(place, precision, slope)


def _first(heard: AnchorScan) -> int | None:
    """The row that is an anchor's line of sight, if any is: the shortest path, and the loudest."""
    whole = np.isfinite(heard.value).all(1)
    if not whole.any():
        return None
    row = int(np.where(whole, heard.value[:, 0], np.inf).argmin())
    if not heard.amplitude[row] >= np.nanmax(heard.amplitude, initial=-np.inf):
        return None
    return row if heard.value[row, 0] > abs(heard.height) else None
