"""Where nothing was heard off walls of methods without cells, between two stretches of one surface.

There may be a door, a gap, or a wall off which nothing was heard.
"""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.maps.walls import WallSegments

MOST_NAMED = 4


def unhit(walls: WallSegments) -> Array:
    """What lies between neighbouring stretches of one surface, longest first.

    Parameters
    ----------
    walls : WallSegments
        Of a map without cells.

    Returns
    -------
    (U, 2, 2) float64, m
        Ends, indexed [gap, end, xy].
    """
    same = walls.surface[1:] == walls.surface[:-1]
    gaps = np.stack([walls.ends_m[:-1, 1], walls.ends_m[1:, 0]], axis=1)[same]
    return np.asarray(gaps[np.argsort(-np.linalg.norm(gaps[:, 1] - gaps[:, 0], axis=-1), kind="stable")])


def unhit_words(stretches: Array) -> str:
    """How much of the walls nothing was heard off, and where (U, 2, 2) m; nothing if there is none."""
    if not len(stretches):
        return ""
    length = float(np.linalg.norm(stretches[:, 1] - stretches[:, 0], axis=-1).sum())
    places = ", ".join(
        f"from ({a[0]:.1f}, {a[1]:.1f}) to ({b[0]:.1f}, {b[1]:.1f})" for a, b in stretches[:MOST_NAMED]
    )
    rest = f" and {len(stretches) - MOST_NAMED} more" * (len(stretches) > MOST_NAMED)
    return f". Nothing was heard off {length:.1f} m in between: {places}{rest}"
