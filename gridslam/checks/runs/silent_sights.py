"""Anchors that an earlier map says are in sight, and that aren't heard: a door that has shut, say.

A closed door that reflects is learned. Of one that only hides what lies behind it silence alone tells, and a
filter that keeps rays with memory, (M20), takes that for a ray that has ended: the cells stay free.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.estimates import Estimate
from gridslam.maps.map import Map
from gridslam.maps.walls import OPEN_NAT
from gridslam.measurements.table import Measurements
from gridslam.world.filter_model import FilterModel

LEAST_STEPS = 10
"""Steps in a row of those at which an anchor should be heard."""
DETECTED, KNOWN_M = 0.9, 0.3
"""Probability of detection at least; deviation of the position at most."""
CLEAR_M, NEAR_M = 0.4, 0.5
"""So near to agent and anchor nothing is asked of cells; how far off a line of sight's length may be."""


def silent_sights(
    estimates: Sequence[Estimate],
    heard: Measurements,
    earlier: Map,
    model: FilterModel,
    later: Map | None = None,
) -> list[tuple[str, int, int]]:
    """Anchors that weren't heard for long though the map knows their line of sight to be free.

    Parameters
    ----------
    later : Map, optional
        What was made of it since: what stands in the way by this map explains silence, too.

    Returns
    -------
    list of (name, expected, silent)
        At how many steps it should be heard, and at how many of them it wasn't.
    """
    found = []
    for anchor, name in enumerate(model.anchor_names[: model.senders]):
        if name not in heard.anchors:
            continue
        silent = [
            not _is_heard(heard, one, anchor, model)
            and (later is None or _is_open(one, anchor, later, model))
            for one in estimates
            if _is_open(one, anchor, earlier, model)
        ]
        if _longest(silent) >= LEAST_STEPS:
            found.append((name, len(silent), sum(silent)))
    return found


def _is_open(one: Estimate, anchor: int, earlier: Map, model: FilterModel) -> bool:
    """Whether an anchor should be heard: surely free cells alone lie between, and its path is loud."""
    if np.sqrt(np.trace(one.covariance[:2, :2])) > KNOWN_M:
        return False
    way = model.anchor_positions[anchor] - one.position_m
    far = float(np.hypot(*way))
    amplitude = model.radio.amplitude(np.array([max(far, 1e-3)]))
    if not far < model.radio.max_distance_m or model.radio.detection_probability(amplitude)[0] < DETECTED:
        return False
    along = np.arange(CLEAR_M, max(far - CLEAR_M, CLEAR_M), 0.5 * earlier.cell_m)
    cell = np.floor((one.position_m + along[:, None] / far * way - earlier.origin_m) / earlier.cell_m)
    column, row = cell.astype(np.intp).T
    height, width = earlier.shape
    if not len(along) or not ((column >= 0) & (column < width) & (row >= 0) & (row < height)).all():
        return False
    return bool((earlier.observed[row, column] & (earlier.evidence[row, column] < OPEN_NAT)).all())


def _is_heard(heard: Measurements, one: Estimate, anchor: int, model: FilterModel) -> bool:
    """Whether some path of an anchor is about as long as its line of sight."""
    scan = heard.scan(one.step)
    far = np.hypot(*(model.anchor_positions[anchor] - one.position_m))
    own = heard.anchors.index(model.anchor_names[anchor])
    length: Array = np.asarray(scan.distance_m)[np.asarray(scan.anchor) == own]
    height = model.anchor_heights[anchor]
    near: NDArray[np.bool_] = np.abs(length - np.hypot(far, height)) < NEAR_M
    return bool(near.any())


def _longest(values: Sequence[bool]) -> int:
    """Length of the longest run of what is true."""
    best = now = 0
    for value in values:
        now = now + 1 if value else 0
        best = max(best, now)
    return best
