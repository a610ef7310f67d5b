"""The lines of sight of one of several agents, found by angles alone, whatever the labels and distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.sights.fit import fitting
from gridslam.checks.sights.line_of_sight_filter import Sight, explain
from gridslam.checks.tables.unit_hypotheses import ANGLES, finite
from gridslam.measurements.network import NetworkMeasurements
from gridslam.world.columns import Columns
from gridslam.world.geometry import slant
from gridslam.world.scene import Scene

FEWEST = 8
"""Lines of sight to an anchor that must be known for it to be judged."""
FLAT = 0.03
"""Least share of the weak direction's information in the strong one's, where directions cross."""
STRAY_M = 1.0
"""Distance from the middle of their offsets up to which lines of sight count as such, or 4 deviations."""


@dataclass(frozen=True, eq=False)
class Links:
    """Lines of sight of one agent.

    Attributes
    ----------
    agent : str
    anchor : (R,) int
        Whose they are by their angles.
    label : (R,) int
        Whose they say they are; -1 for nothing.
    late_m : (R,)
        By how much the distance is longer than it should be.
    row : (R,) int
        Of the agent's table.
    """

    agent: str
    anchor: NDArray[np.intp]
    label: NDArray[np.intp]
    late_m: Array
    row: NDArray[np.intp]


def lines_of_sight(measurements: NetworkMeasurements, scene: Scene, name: str) -> Links | None:
    """An agent's lines of sight whatever the labels and clocks; None if its angles don't show them."""
    part = measurements[name]
    if not all(len(finite(part.columns, column)) for column in ANGLES):
        return None
    rows, anchor = read_as_any(np.full(len(part.step), -1), len(scene.anchors))
    table: Columns = {key: part.columns[key][rows] for key in ("step", *ANGLES)} | {"anchor": anchor}
    sight = explain(table, scene, name)
    if sight.explained < fitting(scene) or sight.scans < FEWEST:
        return None
    return distinct(part.columns, rows, table, sight, scene, name)


def read_as_any(label: NDArray[np.intp], anchors: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows of a table and the anchors they may be of: rows without a label once for each anchor.

    Parameters
    ----------
    label : (K,) int
        -1 for nothing.

    Returns
    -------
    row, anchor : (M,) int
        By row, so that steps stay in order.
    """
    times = np.where(label < 0, anchors, 1)
    row = np.repeat(np.arange(len(label)), times)
    turn = np.arange(len(row)) - np.repeat(np.cumsum(times) - times, times)
    return row, np.where(label[row] < 0, turn, label[row])


def distinct(
    columns: Columns, rows: NDArray[np.intp], table: Columns, sight: Sight, scene: Scene, name: str
) -> Links:
    """The sure lines of sight whose distances agree but for one offset of each anchor.

    Parameters
    ----------
    columns : dict of str to (K,)
        The agent's whole table.
    rows : (R,) int
        Which of its rows each row of `table` is a reading of.
    table : dict of str to (R,)
        As `sight` was found in it: `anchor` is whose a row is read as.
    name : str
        The agent's.
    """
    sure = sight.sure
    found, anchor = rows[sight.row[sure]], table["anchor"][sight.row[sure]]
    aod = columns["aod_rad"][found] + scene.anchor_orientations[anchor]
    place = crossed(columns["step"][found], scene.anchor_positions[anchor], aod, sight.distance_m[sure])
    level = np.hypot(*(place - scene.anchor_positions[anchor]).T)
    late = columns["distance_m"][found] - slant(level, scene.heights(name)[anchor])
    usable = np.isfinite(late)
    for number in np.unique(anchor):
        own = (anchor == number) & usable
        if own.any():
            middle, spread = middle_of(late[own])
            usable &= (anchor != number) | (np.abs(late - middle) < max(STRAY_M, 4 * spread))
    return Links(name, anchor[usable], columns["anchor"][found][usable], late[usable], found[usable])


def crossed(step: NDArray[np.intp], place: Array, direction: Array, distance: Array) -> Array:
    """Where directions from known places cross at each step, by least squares, (R, 2) m.

    Parameters
    ----------
    step : (R,) int
    place : (R, 2) m
    direction : (R,) rad
    distance : (R,) m
        Roughly; near places tell more.

    Returns
    -------
    (R, 2) m
        Of each row's step; NaN where fewer than two directions cross at a fair angle.
    """
    number = np.unique(step, return_inverse=True)[1]
    across = np.stack([-np.sin(direction), np.cos(direction)], -1) / np.maximum(distance, 1.0)[:, None]
    products = across[:, :, None] * across[:, None]
    normal = np.zeros((number.max(initial=-1) + 1, 2, 2))
    right = np.zeros((len(normal), 2))
    np.add.at(normal, number, products)
    np.add.at(right, number, np.einsum("rij,rj->ri", products, place))
    size = np.linalg.eigvalsh(normal)
    poor = size[:, 0] < FLAT * size[:, 1]
    normal[poor] = np.eye(2)
    found = np.linalg.solve(normal, right[..., None])[..., 0]
    found[poor] = np.nan
    return np.asarray(found[number])


def middle_of(values: Array) -> tuple[float, float]:
    """Median and deviation, of values among which some are anything.

    Parameters
    ----------
    values : (N,) array
    """
    middle = float(np.median(values))
    return middle, 1.48 * float(np.median(np.abs(values - middle)))
