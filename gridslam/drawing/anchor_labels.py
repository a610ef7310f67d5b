"""Anchors with their names, which stand clear of walls."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from gridslam.arrays import Array
from gridslam.world.geometry import distance_to_segments, unit
from gridslam.world.scene import Scene

SIDES = np.array([[1, 1], [-1, 1], [1, -1], [-1, -1]])
"""Beside an anchor, where its name may stand; the first that is clear is taken."""
ACROSS = 0.045
"""How far off the middle of a name lies, of the width that the axes show."""
ASIDE_POINTS = 6.0, 5.0
NEAR = 0.85
"""Cosine of the angle up to which a side lies on a way."""
FOUND = "#D55E00"


class Standing(Protocol):
    """What is drawn of where anchors stand, as it was learned."""

    @property
    def columns(self) -> Array:
        """x, y (m), orientation (rad) and their deviations, (6, J)."""
        ...


def anchors(
    axes: Axes, scene: Scene, size: float = 8.0, facing: bool = False, found: Standing | None = None
) -> None:
    """Anchors with their names; the limits of the axes are those of what is shown.

    Parameters
    ----------
    size : float, points
        Of their marks.
    facing : bool
        Whether arrows show where they face, which names stand clear of, too.
    found : Standing, optional
        Where they stand, as it was learned.
    """
    place = scene.anchor_positions
    axes.plot(*place.T, "^", color="k", mec="w", ms=size, ls="", label="anchors", zorder=6)
    if found is not None:
        x, y, _, x_std, y_std, _ = found.columns
        bars: dict[str, Any] = {"fmt": "none", "ecolor": FOUND, "elinewidth": 1.5, "zorder": 7}
        axes.errorbar(x, y, 2 * y_std, 2 * x_std, label="anchors as found, 2 deviations", **bars)
    halo = [withStroke(linewidth=2, foreground="w")]
    style: dict[str, Any] = {"fontsize": "small", "path_effects": halo, "zorder": 6}
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    corners = np.array([[left, low], [right, high]])
    ways = unit(scene.anchor_orientations) if facing else [None] * len(place)
    for name, where, way in zip(scene.anchor_names, place, ways, strict=True):
        x, y = side_of(where, scene, corners, way)
        aside = (x * ASIDE_POINTS[0], y * ASIDE_POINTS[1])
        align: dict[str, Any] = {"ha": "left" if x > 0 else "right", "va": "bottom" if y > 0 else "top"}
        axes.annotate(name, where, aside, textcoords="offset points", annotation_clip=True, **align, **style)


def side_of(place: Array, scene: Scene, corners: Array, taken: Array | None = None) -> Array:
    """On which side of an anchor at `place` (2,) m its name meets no wall: signs (2,) of x and y.

    If none is clear, the one farthest from walls.

    Parameters
    ----------
    corners : (2, 2) m
        Lower left and upper right of what is shown.
    taken : (2,), optional
        Unit vector of a way on which something stands.
    """
    walls, reach = scene.segments(), ACROSS * float(np.ptp(corners[:, 0]))
    middle = place + reach * SIDES
    inside = ((middle > corners[0]) & (middle < corners[1])).all(1)
    room = np.full(len(SIDES), np.inf)
    if len(walls):
        room = distance_to_segments(middle, walls.start, walls.end).min(-1)
    room = np.where(inside, np.minimum(room, 0.6 * reach), -1.0)
    if taken is not None:
        room = np.where((SIDES @ taken) / np.sqrt(2) > NEAR, -1.0, room)
    return np.asarray(SIDES[int(room.argmax())])
