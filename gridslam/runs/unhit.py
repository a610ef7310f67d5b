"""Where walls of methods without cells were never hit between their first hit and their last.

The cells of grid methods tell where a wall is open. Without them, the bounces of the paths that were believed
in tell where there was none: a door, a gap, or a wall that nothing was heard off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.arrays import Array
from gridslam.estimate_tables import PathEstimate, SurfaceEstimate
from gridslam.estimates import Estimate
from gridslam.maps.walls import LONGEST_GAP_M
from gridslam.world.geometry import unit

BELIEVED = 0.9
"""Probability from which on a path is taken to be there."""
MOST_NAMED = 4


def unhit(estimates: Sequence[Estimate], surfaces: SurfaceEstimate) -> Array:
    """Stretches of over 0.5 m between two hits of a surface, off which nothing was heard, longest first.

    Parameters
    ----------
    estimates : sequence of Estimate
        Of all steps of all agents that made the map.
    surfaces : SurfaceEstimate
        As found in the end.

    Returns
    -------
    (U, 2, 2) float64, m
        Their ends, indexed [stretch, end, xy].
    """
    tables = [one.paths.take(one.paths.existence > BELIEVED) for one in estimates]
    paths = PathEstimate.stack(tables) if tables else PathEstimate.empty()
    found = list[Array]()
    for identity, line, extent in zip(surfaces.identity, surfaces.line, surfaces.extent_m, strict=True):
        if not np.isfinite(extent).all():
            continue
        normal, tangent = unit(line[0]), unit(line[0] + 0.5 * np.pi)
        last, first = (paths.surfaces == identity).T
        hits = np.concatenate([paths.points[first, 1], paths.points[last, 2]]) @ tangent
        low, high = np.sort(extent)
        places = np.unique([low, *hits[(hits > low) & (hits < high)], high])
        for gap in np.flatnonzero(np.diff(places) > LONGEST_GAP_M):
            found.append(line[1] * normal + places[gap : gap + 2, None] * tangent)
    length = [-float(np.linalg.norm(one[1] - one[0])) for one in found]
    return np.reshape([found[index] for index in np.argsort(length, kind="stable")], (-1, 2, 2))


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
