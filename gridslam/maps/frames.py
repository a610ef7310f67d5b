"""Which frame a map's coordinates are in, and its fit to a scene: refused, taken over or resampled.

A frame is known by its anchors: every agent needs their places, so two maps whose anchors of one name
stand in different places can't mean the same coordinates, and two that share an anchor do. A map names them
in its provenance as the parallel lists ``anchors``, ``anchor_x_m`` and ``anchor_y_m``. Where no anchor is
shared (other radios, another part of a building), the scene's key ``frame`` tells, kept as ``frame``; where
that isn't given either (other software, earlier files), only the user can: ``same_frame``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gridslam.errors import InputError
from gridslam.maps.feature_rows import SAME_PLACE_M, of_anchor
from gridslam.maps.map import Map
from gridslam.maps.map_cells import ANCHOR_KEYS, anchors_of
from gridslam.maps.run_identity import refuse_repeated_runs

if TYPE_CHECKING:
    from gridslam.world.scene import Scene

FAR = 4.0
"""Deviations beyond which an anchor doesn't stand where it was learned to."""


def stamped(grid: Map, scene: Scene) -> Map:
    """Return the map with the scene's anchors, and its frame where it has a name, in its provenance."""
    x, y = scene.anchor_positions.T.tolist()
    marks: dict[str, Any] = dict(zip(ANCHOR_KEYS, (list(scene.anchor_names), x, y), strict=True))
    if scene.frame is not None:
        marks["frame"] = scene.frame
    return replace(grid, provenance={**grid.provenance, **marks})


def assured(grid: Map, scene: Scene) -> Map:
    """Return the map as one of the scene's frame, on the user's word: its anchors and the scene's.

    An anchor that stands elsewhere in the scene keeps its place, so that it is found out.
    """
    known = dict(anchors_of(grid.provenance))
    ours = dict(zip(scene.anchor_names, map(tuple, scene.anchor_positions.tolist()), strict=True))
    both = {**ours, **known}
    columns = list(both), [place[0] for place in both.values()], [place[1] for place in both.values()]
    others = {key: value for key, value in grid.provenance.items() if key != "frame"}
    marks: dict[str, Any] = dict(zip(ANCHOR_KEYS, columns, strict=True))
    if scene.frame is not None:
        marks["frame"] = scene.frame
    return replace(grid, provenance={**others, **marks})


def require_map(grid: object, where: str) -> None:
    """Refuse what is no map, its file's name above all.

    Raises
    ------
    InputError
    """
    if not isinstance(grid, Map):
        raise InputError(where, type(grid).__name__, "a Map, as gs.Map.load(path) returns")


def fitted(grid: Map, scene: Scene, where: str = "map", same_frame: bool = False) -> tuple[Map, str | None]:
    """Bring a map onto a scene's grid.

    Parameters
    ----------
    grid : Map
    scene : Scene
    where : str
        Names the map in errors and notes.
    same_frame : bool
        The user's word that the map is in the scene's frame, where nothing in it tells so.

    Returns
    -------
    Map
        The same map if it is on the scene's grid already (and no word was needed).
    str or None
        What was done to it, whether its makers were told the truth or lost, and whether it names no frame
        where the scene does, in one line.

    Raises
    ------
    InputError
        The map is of another frame or of one that can't be told, or of another place; or it holds the
        evidence of a run twice.
    """
    require_map(grid, where)
    refuse_repeated_runs(grid, where)
    places = dict(zip(scene.anchor_names, map(tuple, scene.anchor_positions.tolist()), strict=True))
    found = dict(anchors_of(grid.provenance))
    learned = _learned(grid, scene)
    _require_same([one for one in found.items() if one[0] not in learned], places, where)
    grid, surveyed = _surveyed(grid, {n: (found[n], places[n]) for n in found if n in learned}, where)
    named = {scene.frame} if scene.frame is not None else set()
    if same_frame:
        grid = grid if _linked(found, _names(grid.provenance), places, named) else assured(grid, scene)
    else:
        _require_linked(found, _names(grid.provenance), places, named, f"{where}: frame", scene.name)
    try:
        on_grid = grid.resample(scene.grid.origin_m, scene.grid.cell_m, scene.grid.shape)
    except InputError as error:
        raise InputError(error.where.replace("map", where, 1), error.found, error.allowed) from error
    unnamed = scene.frame is not None and not same_frame and not _names(grid.provenance)
    notes = [f"{where}: names no frame; taken for {scene.frame}, by its anchors"] if unnamed else []
    notes += surveyed
    notes += [f"{where}: whoever made it was told the {grid.truth_given}"] if grid.truth_given else []
    if grid.lost:
        notes.append(f"{where}: {grid.lost} noticed in the end that it was lost, so nobody goes on from it")
    if on_grid is not grid:
        sizes = [f"{g.shape[1]} x {g.shape[0]} cells of {g.cell_m:g} m" for g in (grid, on_grid)]
        notes.append(f"{where}: {sizes[0]} resampled to the scene's {sizes[1]}")
    return on_grid, "; ".join(notes) or None


def _learned(grid: Map, scene: Scene) -> set[str]:
    """Anchors that stand where a map's agents learned, of a scene that has them elsewhere than theirs had.

    Perhaps it was surveyed since, or their places are rough guesses, known to no better than is told.
    """
    told = {anchor.name: anchor for anchor in scene.anchors}
    found = grid.anchors
    if found is None:
        return set()
    near = set[str]()
    for name, x, y, _, x_std, y_std, _ in zip(found.names, *found.columns, strict=True):
        if name in told:
            spread = np.hypot([x_std, y_std], told[name].position_std_m)
            off = np.subtract((x, y), told[name].position_m[:2])
            if (np.abs(off) < SAME_PLACE_M + FAR * spread).all():
                near.add(name)
    return near


def _surveyed(
    grid: Map, moved: Mapping[str, tuple[tuple[float, float], tuple[float, float]]], where: str
) -> tuple[Map, list[str]]:
    """A map with its features' anchors where a scene has them, and notes on those that stand elsewhere.

    Parameters
    ----------
    moved : dict of (place, place)
        Where the map's maker and the scene have anchors, m.
    """
    notes, table = list[str](), grid.features
    for name, (there, here) in moved.items():
        off = float(np.hypot(*np.subtract(here, there)))
        if off < SAME_PLACE_M:
            continue
        notes.append(f"{where}: its anchor {name} is the scene's, {off:.2g} m from where its maker was told")
        if table is not None:
            own = of_anchor(table, np.asarray(there))[:, None]
            table = replace(table, anchor_m=np.where(own, here, table.anchor_m))
    return (grid if table is grid.features else replace(grid, features=table)), notes


def refuse_lost(maps: Sequence[Map], names: Sequence[str]) -> None:
    """Refuse maps whose maker noticed in the end that it was lost.

    Parameters
    ----------
    maps : sequence of Map
    names : sequence of str
        What errors call them.

    Raises
    ------
    InputError
        The first of them.
    """
    for grid, name in zip(maps, names, strict=True):
        if grid.lost:
            found = f"a map of {grid.lost}, which noticed in the end that it was lost"
            raise InputError(name, found, "one of agents that didn't")


def require_one_frame(maps: Sequence[Map], names: Sequence[str], same_frame: bool = False) -> None:
    """Refuse maps that can't be of one frame, or of which that can't be told.

    Parameters
    ----------
    maps : sequence of Map
    names : sequence of str
        What errors call them.
    same_frame : bool
        The user's word that they are, where nothing in them tells so.

    Raises
    ------
    InputError
        An anchor stands in different places, or some maps share neither an anchor nor the name of their frame
        with the others.
    """
    every = [(dict(anchors_of(grid.provenance)), _names(grid.provenance)) for grid in maps]
    places: dict[str, tuple[float, float]] = {}
    for found, _ in every:
        _require_same(found.items(), places, "fuse")
        places |= found
    if same_frame:
        return
    places, frames, rest = dict(every[0][0]), set(every[0][1]), list(range(1, len(maps)))
    while rest:  # a map may be linked to the first by way of others
        near = [n for n in rest if _linked(*every[n], places, frames)]
        if not near:
            found, own = every[rest[0]]
            _require_linked(found, own, places, frames, f"fuse: frame of {names[rest[0]]}", names[0])
        for n in near:
            places |= every[n][0]
            frames |= every[n][1]
        rest = [n for n in rest if n not in near]


def _names(provenance: Mapping[str, object]) -> set[str]:
    """Names that were given to a map's frame; several where maps were fused on the user's word."""
    name = provenance.get("frame")
    several = name if isinstance(name, list) else [name]
    return {one for one in several if isinstance(one, str) and one}


def _linked(
    found: Mapping[str, tuple[float, float]], own: set[str], places: Mapping[str, object], frames: set[str]
) -> bool:
    """Whether a map tells that it is of the same frame: by name or, where one has none, by an anchor."""
    return bool(own & frames) if own and frames else any(name in places for name in found)


def _require_linked(
    found: Mapping[str, tuple[float, float]], own: set[str], places: Mapping[str, object],
    frames: set[str], where: str, whose: str,
) -> None:  # fmt: skip
    if _linked(found, own, places, frames):
        return
    found_there = f"anchors {', '.join(found)}, none of those of {whose}" if found else "no anchors to go by"
    found_there = f"frame {', '.join(sorted(own))}" if own and frames else found_there
    known = f"frame {', '.join(sorted(frames))}" if own and frames else "an anchor in common"
    raise InputError(
        where, found_there, f"{known}, or --same-frame (same_frame=True) if you know that it fits"
    )


def _require_same(
    found: Iterable[tuple[str, tuple[float, float]]],
    places: Mapping[str, tuple[float, float]],
    where: str,
) -> None:
    for name, place in found:
        if name in places and not np.hypot(*np.subtract(place, places[name])) < SAME_PLACE_M:
            there = "({:.6g}, {:.6g}) m"
            raise InputError(
                f"{where}: frame",
                f"anchor {name!r} at {there.format(*place)}",
                f"{there.format(*places[name])}, its place here: a map of the same frame; an anchor that"
                " was moved since has another name",
            )
