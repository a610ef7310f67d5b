"""Which frame a map's coordinates are in, and its fit to a scene: refused, taken over or resampled.

A frame is known by its anchors: every agent needs their places, so two maps whose anchors of one name
stand in different places can't mean the same coordinates. A map names them in its provenance as the
parallel lists ``anchors``, ``anchor_x_m`` and ``anchor_y_m``. Where it shares no name with the scene (other
software, other radios), overlap with the scene's region is all that can be asked for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gridslam.errors import InputError

if TYPE_CHECKING:
    from gridslam.maps.map import Map
    from gridslam.world.scene import Scene

SAME_PLACE_M = 0.01
"""Anchors are surveyed better than this."""
KEYS = ("anchors", "anchor_x_m", "anchor_y_m")


def stamped(grid: Map, scene: Scene) -> Map:
    """Return the map with the scene's anchors in its provenance."""
    x, y = scene.anchor_positions.T.tolist()
    marks = dict(zip(KEYS, (list(scene.anchor_names), x, y), strict=True))
    return replace(grid, provenance={**grid.provenance, **marks})


def fitted(grid: Map, scene: Scene, where: str = "map") -> tuple[Map, str | None]:
    """Bring a map onto a scene's grid.

    Parameters
    ----------
    grid : Map
    scene : Scene
    where : str
        Names the map in errors and notes.

    Returns
    -------
    Map
        The same map if it is on the scene's grid already.
    str or None
        What was done to it, in one line.

    Raises
    ------
    InputError
        The map is of another frame, of cells whose size or lattice doesn't fit, or of another place.
    """
    places = dict(zip(scene.anchor_names, map(tuple, scene.anchor_positions), strict=True))
    _require_same(_anchors(grid.provenance), places, where)
    try:
        sheet = grid.resample(scene.grid.origin_m, scene.grid.cell_m, scene.grid.shape)
    except InputError as error:
        raise InputError(error.where.replace("map", where, 1), error.found, error.allowed) from error
    if sheet is grid:
        return grid, None
    sizes = [f"{g.shape[1]} x {g.shape[0]} cells of {g.cell_m:g} m" for g in (grid, sheet)]
    return sheet, f"{where}: {sizes[0]} resampled to the scene's {sizes[1]}"


def require_one_frame(maps: Sequence[Map]) -> None:
    """Refuse maps that can't be of one frame.

    Raises
    ------
    InputError
        An anchor stands in different places.
    """
    places: dict[str, tuple[float, float]] = {}
    for grid in maps:
        found = list(_anchors(grid.provenance))
        _require_same(found, places, "fuse")
        places |= dict(found)


def _anchors(provenance: Mapping[str, object]) -> Iterator[tuple[str, tuple[float, float]]]:
    """Names and places of a map's anchors; nothing if other software kept something else there."""
    lists = [provenance.get(key) for key in KEYS]
    if all(isinstance(column, list) for column in lists):
        for name, x, y in zip(*lists, strict=False):
            if isinstance(x, float | int) and isinstance(y, float | int):
                yield str(name), (x, y)


def _require_same(
    found: Iterator[tuple[str, tuple[float, float]]] | Sequence[tuple[str, tuple[float, float]]],
    places: Mapping[str, tuple[float, float]],
    where: str,
) -> None:
    for name, place in found:
        if name in places and not np.hypot(*np.subtract(place, places[name])) < SAME_PLACE_M:
            there = "({:.6g}, {:.6g}) m"
            raise InputError(
                f"{where}: frame",
                f"anchor {name!r} at {there.format(*place)}",
                f"{there.format(*places[name])}, its place here: a map of the same frame",
            )
