"""How well the line of sight to known anchors explains what was heard: a small particle filter of its own.

It knows nothing of walls, so it works before any map does, and it is blunt on purpose: the standard
deviations are wide, and a scan whose line of sight is blocked costs little. Its evidence compares readings of
the same table (radians or degrees, metres or seconds).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.range_errors import RangeError
from gridslam.checks.views import in_view
from gridslam.world.geometry import slant, unit, wrap
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene

PARTICLES, STEPS = 300, 100
TOLD_APART = 12
"""Steps after which as many particles as usual go on from many starts."""
DETECTED = 0.9
"""Share of the scans in which a line of sight is expected."""
DETECTED_BEHIND = 0.3
"""The same where the scene's walls hide the anchor from the middle of the particles, bluntly."""
LASTING = 0.9
"""Correlation of a particle's velocity from step to step, where it keeps any."""
ANGLE_STD = np.radians(5.0)
LEAST_DISTANCE_STD_M = 0.1
CROWD = 4
"""Times as many particles where the size of an error is looked for, too."""
LEAST_SEEN, LEAST_SEEN_THOROUGH = 0.3, 0.15
"""Share of the scans that walls must leave in sight for the others not to be judged."""
QUANTITIES = ("distance_m", "aod_rad", "aoa_rad")


@dataclass(frozen=True, eq=False)
class Sight:
    """What the line of sight explains under one reading of the table.

    Attributes
    ----------
    evidence : float
        Log likelihood ratio to a table whose values have nothing to do with the anchors, nats.
    scans : int
        Pairs of step and anchor with something heard.
    explained : float
        Expected share of them that hold a path in line of sight; of those alone in which the scene's walls
        leave the anchor in sight, if they do in enough of them.
    shares : (J,) float64
        The same of each anchor; NaN without scans.
    row, distance_m, probability : (R,) int, float64, float64
        The likeliest row of each scan, the distance predicted for it, and how likely it is the line of sight.
    position_m : (N, 2) float64, m
        Mean position of the agent at each step.
    size_m : float
        Of the error in the distances, as estimated; 0 if none was supposed.
    start : (3,) float64, m, m, rad
        Where the particles that are left at the end began, and how they faced.
    first : int or None
        Of how many steps, if the table has more.
    """

    evidence: float
    scans: int
    explained: float
    row: NDArray[np.intp]
    distance_m: Array
    probability: Array
    position_m: Array
    shares: Array
    size_m: float
    start: Array
    first: int | None = None

    @property
    def judged(self) -> str:
        """How many scans that is, and of which steps if it isn't of all, in words."""
        return f"{self.scans} scans" + (f" of the first {self.first} steps" if self.first else "")


def explain(
    columns: Mapping[str, NDArray],
    scene: Scene,
    agent: str | None,
    world_arrival: bool = False,
    error: RangeError | None = None,
    thorough: bool = False,
    starts: Array | None = None,
    steps: int = STEPS,
    crowd: int | None = None,
) -> Sight:
    """Follow the agent by line of sight alone over the first steps.

    Parameters
    ----------
    columns : dict of (K,) arrays
        ``step`` and ``anchor`` (an index into the scene's), and any of ``distance_m``, ``aod_rad`` and
        ``aoa_rad``; NaN where not measured.
    scene : Scene
        For the anchors and the agent's start.
    agent : str or None
        None starts anywhere in the grid.
    world_arrival : bool
        Take ``aoa_rad`` as a direction in the world, not relative to the heading.
    error : RangeError, optional
        Suppose that the distances have it, and estimate its size.
    thorough : bool
        Judge from each particle which anchors the walls hide, and let it keep its velocity while they do: it
        follows an agent through doors, and finds readings of wrong tables that fit, too.
    starts : (P, 3) m, m, rad, optional
        Poses to begin with, instead of those about the scene's start.
    steps : int
        How many of the table's steps, from its first, the agent is followed over.
    crowd : int, optional
        Times as many particles as usual (default: 1, or `CROWD` with an error). More find more
        evidence by themselves: only equal numbers can be compared.
    """
    draw = np.random.default_rng(0)
    position, heading, pace = _start(scene, agent, draw, crowd or (1 if error is None else CROWD))
    if starts is not None:
        position, heading = starts[:, :2], starts[:, 2]
        pace = _paces(scene.agent(agent).step_m if agent is not None else 0.1, len(starts))
    begun = np.column_stack([position, heading])
    size = error.start(len(position), draw) if error is not None else None
    walls, stands, orientations = scene.segments(), scene.anchor_positions, scene.anchor_orientations
    turn, heights = np.radians(scene.filter.heading_deg), scene.heights(agent)
    step, anchor = columns["step"], columns["anchor"]
    first = int(step[0]) if len(step) else 0
    used = np.flatnonzero(step < first + steps)
    weight = np.full(len(position), 1 / len(position))
    quantities = {name: _quantity(columns, name, scene) for name in QUANTITIES if name in columns}
    going, lasting = np.zeros_like(position), LASTING if thorough else 0.0
    evidence, rows, ranges, chances, track = 0.0, [], [], [], []
    bounds = np.flatnonzero(np.diff(step[used])) + 1
    before = first
    for group in np.split(used, bounds) if len(used) else []:
        gap = np.sqrt(max(int(step[group[0]]) - before, 1))
        before = int(step[group[0]])
        going = lasting * going + np.sqrt(1 - lasting**2) * draw.standard_normal(position.shape)
        position = position + gap * pace[:, None] * going
        heading = heading + gap * turn * draw.standard_normal(len(heading))
        score = np.zeros(len(position))
        scans, there = [], np.unique(anchor[group])
        viewpoints = position if thorough else position.mean(0, keepdims=True)
        seen = in_view(stands[there, None], viewpoints, walls)
        for number, expectation in zip(there, np.where(seen, DETECTED, DETECTED_BEHIND), strict=True):
            own = group[anchor[group] == number]
            away = position - stands[number]
            direction = np.arctan2(away[:, 1], away[:, 0])
            level, height = np.hypot(*away.T), float(heights[number])
            distance = slant(level, height)
            if error is not None and size is not None:
                distance = error.spoilt(level, size, int(number), height)
            ahead = direction - orientations[number]
            behind = direction + (np.pi if world_arrival else np.pi - heading)
            expected = dict(zip(QUANTITIES, (distance, ahead, behind), strict=True))
            ratio = _ratio(quantities, own, expected)
            total = (1 - expectation) + expectation * ratio.sum(1) / len(own)
            score += np.log(total)
            scans.append((own, distance, (expectation / total / len(own))[:, None] * ratio))
        peak = score.max()
        weight = weight * np.exp(score - peak)
        evidence += peak + np.log(weight.sum())
        weight /= weight.sum()
        for own, distance, share in scans:
            chance = weight @ share
            rows.append(own[chance.argmax()])
            ranges.append(float(weight @ distance))
            chances.append(float(chance.sum()))
        track.append(weight @ position)
        # systematic resampling; of many starts few are left once these steps have told them apart
        left = PARTICLES if starts is not None and len(track) >= TOLD_APART else len(weight)
        places = (draw.random() + np.arange(left)) / left
        chosen = np.minimum(np.searchsorted(np.cumsum(weight), places), len(weight) - 1)
        position, heading, pace, going = position[chosen], heading[chosen], pace[chosen], going[chosen]
        begun = begun[chosen]
        weight = np.full(len(chosen), 1 / len(chosen))
        if error is not None and size is not None:
            size = error.redrawn(size[chosen], draw)
    row, chance, places = np.array(rows, dtype=np.intp), np.array(chances), np.reshape(track, (-1, 2))
    least = LEAST_SEEN_THOROUGH if thorough else LEAST_SEEN
    judged = _in_sight(scene, anchor[row], places[np.unique(step[row], return_inverse=True)[1]], least)
    shares = [
        chance[judged & (anchor[row] == number)].mean()
        if (judged & (anchor[row] == number)).any()
        else np.nan
        for number in range(len(scene.anchors))
    ]
    return Sight(
        float(evidence),
        len(rows),
        float(chance[judged].mean()) if len(row) else 0.0,
        row,
        np.array(ranges),
        chance,
        places,
        np.array(shares),
        float(size.mean()) if size is not None else 0.0,
        np.array([*begun[:, :2].mean(0), np.angle(np.exp(1j * begun[:, 2]).mean())]),
        steps if len(used) < len(step) else None,
    )


def _in_sight(scene: Scene, anchor: NDArray[np.intp], position: Array, least: float) -> NDArray[np.bool_]:
    """Scans (R,) in which the scene's walls leave the anchor in sight; all if less than that share is."""
    clear = in_view(scene.anchor_positions[anchor], position, scene.segments())
    return clear if clear.sum() >= max(least * len(clear), 1) else np.ones(len(anchor), dtype=bool)


def _start(
    scene: Scene, agent: str | None, draw: np.random.Generator, times: int
) -> tuple[Array, Array, Array]:
    """Positions, headings and paces (std of a step, m) of the particles, `times` as many as usual."""
    if agent is None:
        low, high = np.transpose([scene.grid.x_m, scene.grid.y_m])
        count = 10 * PARTICLES
        return draw.uniform(low, high, (count, 2)), draw.uniform(-np.pi, np.pi, count), np.full(count, 0.1)
    body = scene.agent(agent)
    wide = max(body.prior.position_m, 0.1)
    count = times * PARTICLES
    position = body.start_m + draw.uniform(-wide, wide, (count, 2))
    facing = np.radians(body.start_heading_deg + body.prior.heading_deg * draw.uniform(-1, 1, count))
    return position, facing, _paces(body.step_m, count)


def _paces(step_m: float, count: int) -> Array:
    """Standard deviations (count,) of a step in m.

    A quarter of the particles hurries, since a table of one's own needn't keep to the scene's step.
    """
    return step_m * np.where(np.arange(count) % 4 == 0, 4.0, 0.8)


@dataclass(frozen=True)
class _Quantity:
    """A column, as the likelihood of a line of sight takes it.

    Attributes
    ----------
    values : (K,) float64
        0 where not measured.
    precision : (K,) float64
        One over the standard deviation; 0 where not measured.
    peak : (K,) float64
        Density of the line of sight at its best, over that of any path; 1 where not measured.
    turns : bool
        Whether it is an angle.
    """

    values: Array
    precision: Array
    peak: Array
    turns: bool


def _quantity(columns: Mapping[str, NDArray], name: str, scene: Scene) -> _Quantity:
    values, turns = np.asarray(columns[name], dtype=np.float64), name.endswith("_rad")
    least = ANGLE_STD if turns else max(LEAST_DISTANCE_STD_M, 0.5 * SPEED_OF_LIGHT / scene.radio.bandwidth_hz)
    own = columns.get("distance_std_m" if name == "distance_m" else name.replace("rad", "std_rad"))
    sigma = np.hypot(least, np.nan_to_num(own) if own is not None else np.zeros(len(values)))
    missing = np.isnan(values)
    usual = _density(np.asarray(wrap(values)) if turns else values)  # spread over turns they'd seem rarer
    return _Quantity(
        np.where(missing, 0.0, values),
        np.where(missing, 0.0, 1 / sigma),
        np.where(missing, 1.0, 1 / (np.sqrt(2 * np.pi) * sigma * usual)),
        turns,
    )


def _ratio(
    quantities: Mapping[str, _Quantity], rows: NDArray[np.intp], expected: Mapping[str, Array]
) -> Array:
    """Likelihood of each row (P, M) as the line of sight to an anchor, over that of any path.

    `expected` holds what each particle (P,) expects of it.
    """
    shape = (len(expected["distance_m"]), len(rows))
    exponent, peak = np.zeros(shape), np.ones(len(rows))
    for name, quantity in quantities.items():
        gap = quantity.values[rows] - expected[name][:, None]
        if quantity.turns:
            gap -= 2 * np.pi * np.rint(gap / (2 * np.pi))
        gap *= quantity.precision[rows]
        exponent += gap * gap
        peak *= quantity.peak[rows]
    return peak * np.exp(-0.5 * exponent)


def _density(values: Array) -> Array:
    """How dense the column's own values lie about each of them, by quantiles: what chance would give (K,).

    Without it, whatever reading draws the values together would look like a discovery.
    """
    known = values[np.isfinite(values)]
    bins = int(np.clip(len(known) // 10, 1, 16))
    edges = np.quantile(known, np.linspace(0, 1, bins + 1)) if len(known) else np.array([0.0, 1.0])
    width = np.maximum(np.diff(edges), 1e-9)
    return 1 / (bins * width[np.clip(np.searchsorted(edges, values, side="right") - 1, 0, bins - 1)])


def turning_rad(track: Array, leg_m: float = 0.5) -> float:
    """Greatest change of course of a noisy track (N, 2) in m, seen over legs of some length, rad."""
    corners = [0]
    for place in range(len(track)):
        if np.linalg.norm(track[place] - track[corners[-1]]) > leg_m:
            corners.append(place)
    legs = np.diff(track[corners], axis=0)
    if len(legs) < 2:
        return 0.0
    course = np.arctan2(legs[:, 1], legs[:, 0])
    return float(np.abs(np.arccos(np.clip(unit(course) @ unit(course[0]), -1, 1))).max())
