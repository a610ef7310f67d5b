"""Walls and paths drawn by hand, for the tests of scores."""

import numpy as np

from gridslam.simulation.image_source import TruePaths
from gridslam.world.geometry import Segments


def walls(*pieces, curve=None):
    """Wall pieces (start, end, reflection, surface); `curve` tells of which curved wall each is a facet."""
    start, end, reflection, surface = (np.array(column) for column in zip(*pieces, strict=True))
    curve = np.full(len(start), -1) if curve is None else np.array(curve)
    return Segments(start.astype(float), end.astype(float), reflection.astype(float), surface, surface, curve)


def paths(*routes, repeat=1, anchor=None):
    """Paths (points, segments), one per step: points from anchor to agent."""
    rows = []
    segments = []
    for corners, segment in routes * repeat:
        row = np.full((4, 2), np.nan)
        row[0], row[3] = corners[0], corners[-1]
        row[1 : len(corners) - 1] = np.reshape(corners[1:-1], (-1, 2))
        rows.append(row)
        segments.append(segment)
    count = len(rows)
    none = np.zeros(count)
    bounces = np.array([(np.array(s) >= 0).sum() for s in segments])
    index = np.arange(count)
    anchor = index * 0 if anchor is None else np.array(anchor)
    return TruePaths(
        index, anchor, none, none, none, none, bounces, np.array(segments), np.array(rows), index
    )
