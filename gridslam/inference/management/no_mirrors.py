"""Surfaces that aren't mirrors go; docs/model.md, (M517), (M548). Ours.

Those whose paths leave or arrive elsewhere than a mirror's; and those whose departures are rather a corner's,
and which lie as if they stood for the double bounce over the corner of two surer ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.mirrors import departures_weighed, mirror_odds, missed_angles
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels import LIKELIER_THAN_NOT, REPLACES
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import mirror, unit
from gridslam.world.network_model import NetworkModel

SURE = 5.0
"""Deviations by which the mean angle of an anchor's paths has to miss a mirror's."""
WALL, SHARP_M = 0.9, 0.1
"""Existence of the two surer ones, and the deviation of their offsets."""
AROUND_M, THROUGH_M, CROSSING = 2.0, 0.15, 0.2
"""How far the image of a double bounce may be from the surface's own, how far the corner from its line, and
the least sine of the corner's angle. Departures that aren't a mirror's pull an image by up to some metres."""
MOST_CORNERS = 64
"""Corners that are kept: the latest."""


def no_mirrors(bank: SurfaceBank) -> NDArray[np.bool_]:
    """Which surfaces' paths leave or arrive elsewhere than a mirror's do, (S,) bool; (M517)."""
    return np.asarray((missed_angles(bank) > SURE**2).any((1, 2)))


def over_corners(
    bank: SurfaceBank, belief: Belief, anchors: Array, odds: Array | None = None
) -> NDArray[np.bool_]:
    """Which surfaces stand for double bounces over corners of two surer ones, (S,) bool; (M548).

    Parameters
    ----------
    anchors : (J, 2) m
        The bank's rays are those of one agent or more, each of all anchors.
    odds : (S,), optional
        The bank's `mirror_odds`, where they are known.
    """
    odds = mirror_odds(bank) if odds is None else odds
    over, weighed = np.zeros(len(bank), bool), departures_weighed(bank)
    untold = np.flatnonzero(weighed & (odds < 0))
    if not len(untold):
        return over
    sharp = belief.covariance.diagonal()[belief.layout.head + 1 :: 2] < SHARP_M**2
    sure = sharp & weighed & (odds > 0) & (bank.existence > WALL) & (bank.seen >= REPLACES)
    walls = belief.lines[sure]
    if len(walls) < 2:
        return over
    corners = corners_of(walls)
    for row in untold.tolist():
        hearing = {link % len(anchors) for link in np.flatnonzero(bank.single[:, row] > LIKELIER_THAN_NOT)}
        if len(hearing) == 1:
            over[row] = over_corner(belief.lines[row], walls, corners, anchors[hearing.pop()])
    return over


class Corners(NamedTuple):
    """Corners of all pairs of walls: rows of the wall hit last and first (P,), sine of the angle between them
    (P,), and where they cross, times that (P, 2) m."""

    last: NDArray[np.intp]
    first: NDArray[np.intp]
    sine: Array
    place: Array


def corners_of(walls: Array) -> Corners:
    """Corners of walls (W, 2)."""
    last, first = np.divmod(np.arange(len(walls) ** 2), max(len(walls), 1))
    normals = unit(walls[:, 0])
    by_last, by_first = normals[last], normals[first]
    sine = by_last[:, 0] * by_first[:, 1] - by_last[:, 1] * by_first[:, 0]
    a, b = walls[last, 1], walls[first, 1]
    place = np.stack([a * by_first[:, 1] - b * by_last[:, 1], b * by_last[:, 0] - a * by_first[:, 0]], axis=1)
    return Corners(last, first, sine, place)


def over_corner(line: Array, walls: Array, corners: Corners, anchor: Array) -> bool:
    """Whether a line (2,) lies as a double bounce of an anchor (2,) over two walls (W, 2) would have it.

    `corners` as by `corners_of`.
    """
    width = np.abs(corners.sine)
    through = np.abs(corners.place @ unit(line[0]) - line[1] * corners.sine) < THROUGH_M * width
    pairs = np.flatnonzero(through & (width > CROSSING))
    if not len(pairs):
        return False
    last, first = walls[corners.last[pairs]], walls[corners.first[pairs]]
    gap = mirror(last, mirror(first, anchor)) - mirror(line, anchor)
    return bool((np.hypot(gap[:, 0], gap[:, 1]) < AROUND_M).any())


def drop_no_mirrors(state: State, model: FilterModel, *, work: Workspace) -> State:
    """The state without them; where their paths arrive from is kept, for births there to be doubted."""
    bank, places = state.surfaces, model.places[: model.senders, :2]
    odds = work.once(mirror_odds, bank)  # they are read out, too
    wrong = no_mirrors(bank) | over_corners(bank, state.belief, places, odds)
    if not wrong.any():
        return state
    images = [
        [anchor, *mirror(state.belief.lines[row], places[anchor])]
        for row in np.flatnonzero(wrong)
        for anchor in np.flatnonzero(bank.single[: model.senders, row] > LIKELIER_THAN_NOT)
    ]
    corners = np.concatenate([state.corners, np.reshape(images, (-1, 3))])[-MOST_CORNERS:]
    return replace(state, corners=corners, surfaces=without(bank, wrong))


def drop_shared_no_mirrors(state: NetworkState, model: NetworkModel) -> NetworkState:
    """As `drop_no_mirrors`, of surfaces that all agents share; births there aren't doubted."""
    bank = state.surfaces
    wrong = no_mirrors(bank) | over_corners(bank, state.belief, model.agents[0].anchor_positions)
    return replace(state, surfaces=without(bank, wrong)) if wrong.any() else state


def without(bank: SurfaceBank, gone: NDArray[np.bool_]) -> SurfaceBank:
    """The bank in which some don't exist."""
    return replace(bank, existence=np.where(gone, 0.0, bank.existence))
