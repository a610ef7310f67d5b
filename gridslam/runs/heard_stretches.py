"""Where along their surfaces paths were reflected, of methods without cells.

The cells of grid methods tell where a wall is open. Without them, the bounces of the paths that were believed
in tell where there is a wall: between two of them there may be a door, or a wall that nothing was heard off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.estimate_tables import PathEstimate, SurfaceEstimate, SurfaceStretches
from gridslam.estimates import Estimate
from gridslam.inference.management.network.readout import NetworkEstimate
from gridslam.maps.map import Map
from gridslam.maps.stretches import NEAR_M, joined, stretches_of
from gridslam.systems.slam import Slam, mapped
from gridslam.world.geometry import unit

LIKELY, SURE = 0.5, 0.9
"""Probabilities of a path from which on its bounces count, and from which on they are sure."""
LEAST_SURE = 3
"""Sure bounces that a stretch needs: one or two are of a path that soon proved to be none."""
APART_M, PACES = 0.1, 2.0
"""Between neighbouring bounces of a stretch; or so many ways of an agent from step to step."""


def with_stretches(grid: Map, estimates: Sequence[Sequence[Estimate]], earlier: Map | None = None) -> Map:
    """A map that says where paths were reflected by its surfaces; as it is if no step tells of any bounce.

    Parameters
    ----------
    grid : Map
        Of a method without cells.
    estimates : sequence of sequences of Estimate
        Of each agent that made the map, all steps.
    earlier : Map, optional
        That the run began with: what is wall there stays so.
    """
    heard = None if grid.surfaces is None else heard_stretches(estimates, grid.surfaces)
    if heard is None or grid.surfaces is None:
        return grid
    if earlier is not None:
        heard = SurfaceStretches.stack([heard, stretches_of(earlier.wall_segments().ends_m, grid.surfaces)])
    return replace(grid, stretches=joined(heard))


def map_so_far(
    slam: Slam, estimates: Sequence[Estimate] | Sequence[NetworkEstimate], prior_map: Map | None = None
) -> Map:
    """A filter's map in the middle of a run, as the end of a run has it.

    Of methods without cells walls end where paths were reflected by them, which the estimates tell; by
    `slam.map` each is whole, from its first hit to its last.

    Parameters
    ----------
    slam : Slam
        Which `step` has taken so far.
    estimates : sequence of Estimate, or of NetworkEstimate
        What it has returned, all of it.
    prior_map : Map, optional
        That the filter began with: what is wall there stays so.
    """
    found = mapped(slam)
    if getattr(slam, "keeps_grid", found.observed.any()):
        return found
    each: dict[str, list[Estimate]] = {}
    for one in estimates:
        for name, own in one.agents.items() if isinstance(one, NetworkEstimate) else [("", one)]:
            each.setdefault(name, []).extend([] if own is None else [own])
    return with_stretches(found, list(each.values()), prior_map)


def heard_stretches(
    estimates: Sequence[Sequence[Estimate]], found: SurfaceEstimate
) -> SurfaceStretches | None:
    """Stretches of surfaces, as found in the end, that paths were reflected by; None without any bounce.

    Bounces far off the line that a surface has in the end were told of a line that wasn't known yet.
    """
    place, identity, sure = _bounces([one for own in estimates for one in own])
    if not len(place):
        return None
    widest, pieces = max(APART_M, PACES * max(map(_pace_m, estimates))), [SurfaceStretches.empty()]
    for row, (number, (angle, offset)) in enumerate(zip(found.identity, found.line, strict=True)):
        own = (identity == number) & (np.abs(place @ unit(angle) - offset) < NEAR_M)
        extent = _runs(place[own] @ unit(angle + 0.5 * np.pi), sure[own], widest)
        pieces.append(SurfaceStretches(np.full(len(extent), row), extent))
    return SurfaceStretches.stack(pieces)


def _bounces(estimates: Sequence[Estimate]) -> tuple[Array, NDArray[np.int64], NDArray[np.bool_]]:
    """Where paths were reflected (H, 2), m, by which surfaces (H,), and whether that is sure (H,)."""
    paths = PathEstimate.stack([one.paths.take(one.paths.existence > LIKELY) for one in estimates])
    last, first = paths.surfaces.T
    double = last != first
    place = np.concatenate([paths.points[:, 1], paths.points[double, 2]])
    identity = np.concatenate([first, last[double]])
    sure = np.concatenate([paths.existence, paths.existence[double]]) > SURE
    there = (identity >= 0) & np.isfinite(place).all(axis=1)
    return place[there], identity[there], sure[there]


def _pace_m(estimates: Sequence[Estimate]) -> float:
    """The way from step to step that is as often exceeded as not, m."""
    if len(estimates) < 2:
        return 0.0
    return float(np.median(np.hypot(*np.diff([one.position_m[:2] for one in estimates], axis=0).T)))


def _runs(along: Array, sure: NDArray[np.bool_], widest: float) -> Array:
    """Runs (R, 2) of bounces (H,) along a surface that lie close enough and hold enough sure ones."""
    order = np.argsort(along, kind="stable")
    along, sure = along[order], sure[order]
    cut = np.flatnonzero(np.diff(along) > widest) + 1
    runs = zip(np.split(along, cut), np.split(sure, cut), strict=True)
    return np.reshape([(one[0], one[-1]) for one, known in runs if known.sum() >= LEAST_SURE], (-1, 2))
