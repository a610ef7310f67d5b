"""Whether labels and clocks of several agents' measurements fit the scene: by lines of sight, angles alone.

The agent is followed by the angles of lines of sight, with every row as possibly any anchor's
(`gridslam.checks.line_of_sight_filter`). Where that works, the rows that are lines of sight are known without
their labels and distances, and say what is wrong with either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.fit import FITTING
from gridslam.checks.line_of_sight_filter import Sight, explain
from gridslam.checks.range_errors import LEAST_OFFSET_M
from gridslam.checks.unit_hypotheses import ANGLES, finite
from gridslam.measurements.network import NetworkMeasurements
from gridslam.world.clocks import NS
from gridslam.world.columns import Columns
from gridslam.world.geometry import slant
from gridslam.world.network_scene import clock_model
from gridslam.world.scene import Scene

SURE = 0.7
"""Probability from which on a row is taken for a line of sight."""
FEWEST = 8
"""Lines of sight to an anchor that must be known for it to be judged."""
EXCHANGED, MISTAKEN = 0.5, 0.12
"""Shares of an anchor's lines of sight with one other label that count as exchanged, and as mistaken rows: up
to 7 % were reflections that look like one."""
FLAT = 0.03
"""Least share of the weak direction's information in the strong one's, where directions cross."""
STRAY_M = 1.0
"""Distance from the middle of their offsets up to which lines of sight count as such, or 4 deviations."""
WRONG = 4.0
"""Deviations by which an offset must lie outside of what the scene has for it."""


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
    """

    agent: str
    anchor: NDArray[np.intp]
    label: NDArray[np.intp]
    late_m: Array


def label_and_clock_lines(measurements: NetworkMeasurements, scene: Scene) -> list[str]:
    """Suspicions about labels and clocks, for a person; or that there is too little to tell."""
    links = [
        link
        for name in measurements.agents
        if (link := lines_of_sight(measurements, scene, name)) is not None
    ]
    missing = [name for name in measurements.agents if name not in [link.agent for link in links]]
    lines = []
    if missing:
        lines.append(f"  {', '.join(missing)}: too few lines of sight to judge labels and clocks by")
    if links:
        lines += label_lines(links, scene.anchor_names) + clock_lines(links, scene)
    return lines


def lines_of_sight(measurements: NetworkMeasurements, scene: Scene, name: str) -> Links | None:
    """An agent's lines of sight whatever the labels and clocks; None if its angles don't show them."""
    part = measurements[name]
    if not all(len(finite(part.columns, column)) for column in ANGLES):
        return None
    count = len(scene.anchors)
    rows = np.repeat(np.arange(len(part.step)), count)
    table: Columns = {key: part.columns[key][rows] for key in ("step", *ANGLES)}
    table["anchor"] = np.tile(np.arange(count), len(part.step)).astype(np.intp)
    sight = explain(table, scene, name)
    given = scene.signal_model().given_detection
    if sight.explained < FITTING * (1.0 if given is None else given) or sight.scans < FEWEST:
        return None
    return _distinct(part.columns, rows, table, sight, scene, name)


def _distinct(
    columns: Columns, rows: NDArray[np.intp], table: Columns, sight: Sight, scene: Scene, name: str
) -> Links:
    """The sure lines of sight whose distances agree but for one offset of each anchor."""
    sure = sight.probability > SURE
    found, anchor = rows[sight.row[sure]], table["anchor"][sight.row[sure]]
    aod = columns["aod_rad"][found] + scene.anchor_orientations[anchor]
    place = crossed(columns["step"][found], scene.anchor_positions[anchor], aod, sight.distance_m[sure])
    level = np.hypot(*(place - scene.anchor_positions[anchor]).T)
    late = columns["distance_m"][found] - slant(level, scene.heights(name)[anchor])
    usable = np.isfinite(late)
    for number in np.unique(anchor):
        own = (anchor == number) & usable
        if own.any():
            middle, spread = _middle(late[own])
            usable &= (anchor != number) | (np.abs(late - middle) < max(STRAY_M, 4 * spread))
    return Links(name, anchor[usable], columns["anchor"][found][usable], late[usable])


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


def _middle(values: Array) -> tuple[float, float]:
    """Median and deviation, of values among which some are anything."""
    middle = float(np.median(values))
    return middle, 1.48 * float(np.median(np.abs(values - middle)))


def label_lines(links: Sequence[Links], names: Sequence[str]) -> list[str]:
    """Labels that are exchanged for some or all agents, or mistaken on some rows."""
    lines, exchanged = [], dict[tuple[str, ...], list[str]]()
    for link in links:
        found = confusion(link, len(names))
        count = found.sum(1)
        share = found / np.maximum(count, 1)[:, None]
        judged = count >= FEWEST
        other = share.argmax(1)
        moved: NDArray[np.bool_] = judged & (share.max(1) > EXCHANGED) & (other != np.arange(len(names)))
        if moved.any():
            swapped = tuple(
                f"{names[other[i]]} is the scene's {names[i]}" for i in np.flatnonzero(moved).tolist()
            )
            exchanged.setdefault(swapped, []).append(link.agent)
        own = np.arange(len(names))
        share[own, np.where(moved, other, own)] = 0.0
        for i, j in np.argwhere(judged[:, None] & ~moved[:, None] & (share > MISTAKEN)):
            lines.append(
                f"suspect: {link.agent}: {found[i, j]} of {count[i]} rows with angles and distances of "
                f"the line of sight to {names[i]} are labelled {names[j]}"
            )
    for swapped, who in exchanged.items():
        whom = "all agents" if len(who) == len(links) and len(who) > 1 else ", ".join(who)
        lines.insert(0, f"suspect: labels exchanged for {whom}: {', '.join(swapped)}")
    return lines


def confusion(link: Links, count: int) -> NDArray[np.intp]:
    """Labelled lines of sight by anchor (rows) and label (columns), (J, J)."""
    found = np.zeros((count, count), np.intp)
    labelled = link.label >= 0
    np.add.at(found, (link.anchor[labelled], link.label[labelled]), 1)
    return found


def clock_lines(links: Sequence[Links], scene: Scene) -> list[str]:
    """Offsets in the distances that the scene has no clocks for."""
    clocks = clock_model(scene, [link.agent for link in links])
    lines, half, anchors = [], clocks.half_width_m, len(scene.anchors)
    for number, name in enumerate(scene.anchor_names):
        offsets = []
        for index, link in enumerate(links):
            late = link.late_m[link.anchor == number]
            if len(late) < FEWEST:
                continue
            middle, spread = _middle(late)
            doubt = max(LEAST_OFFSET_M, WRONG * spread / np.sqrt(len(late)))
            allowed = half[number] + half[anchors + index] + doubt
            if abs(middle) > allowed:
                offsets.append((link.agent, middle))
        if offsets:
            lines.append(_offset_line(name, offsets, scene))
    return lines


def _offset_line(name: str, offsets: Sequence[tuple[str, float]], scene: Scene) -> str:
    each = ", ".join(f"{far:+.2f} m ({far / NS:+.1f} ns) at {agent}" for agent, far in offsets)
    cure = (
        "give the scene a table [clocks]" if scene.clocks is None else "its prior in [clocks] is too narrow"
    )
    return f"suspect: distances of anchor {name} are off by {each}, as by clocks that differ: {cure}"
