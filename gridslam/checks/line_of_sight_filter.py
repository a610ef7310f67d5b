"""How well the line of sight to known anchors explains what was heard: a small particle filter of its own.

It knows nothing of walls, so it works before any map does, and it is blunt on purpose: a scan whose line of
sight is blocked costs little. Its evidence compares readings of the same table (radians or degrees, metres or
seconds).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.range_errors import RangeError
from gridslam.checks.remembered import remembered
from gridslam.checks.sight_likelihood import QUANTITIES, SightLikelihood
from gridslam.checks.views import in_view
from gridslam.world.geometry import slant, unit
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
CROWD = 4
"""Times as many particles where the size of an error is looked for, too."""
SHARP_RAD, SHARP_ONES = np.radians(45.0), 8
"""Standard deviation of a sharp turn within a step, and of how many particles one may take it."""
LEAST_SEEN, LEAST_SEEN_THOROUGH = 0.3, 0.15
"""Share of the scans that walls must leave in sight for the others not to be judged."""


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


@remembered
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
    sharp: bool = False,
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
    sharp : bool
        Let it turn within a step by far more than ``filter.heading_deg`` says, too.
    """
    draw = np.random.default_rng(0)
    some = _start(scene, agent, draw, crowd or (1 if error is None else CROWD))
    if starts is not None:
        pace = _paces(scene.agent(agent).step_m if agent is not None else 0.1, len(starts))
        some = _Particles.at(starts[:, :2], starts[:, 2], pace)
    if error is not None:
        some = replace(some, size_m=error.start(len(some.heading), draw))
    scans, likelihood = _Scans.of(columns, steps), SightLikelihood.of(columns, scene)
    walls, stands, heights = scene.segments(), scene.anchor_positions, scene.heights(agent)
    turn, lasting = np.radians(scene.filter.heading_deg), LASTING if thorough else 0.0
    widest = max(turn, SHARP_RAD) if sharp else turn
    facing = scene.anchor_orientations
    evidence, track = 0.0, list[Array]()
    likeliest, ranges, chances = list[int](), list[float](), list[float]()
    for after, anchors, rows, count in scans:
        some = some.moved(after, lasting, turn, widest, draw)
        viewpoints = some.position if thorough else some.position.mean(0, keepdims=True)
        seen = in_view(stands[anchors, None], viewpoints, walls)
        away = some.position - stands[anchors, None]
        direction = np.arctan2(away[..., 1], away[..., 0])
        distance = some.distances(away, anchors, heights[anchors], error)
        ahead = direction - facing[anchors, None]
        behind = direction + (np.pi if world_arrival else np.pi - some.heading)
        expected = dict(zip(QUANTITIES, (distance, ahead, behind), strict=True))
        ratio = likelihood.ratio(rows, np.repeat(np.arange(len(anchors)), count), expected)
        expectation, first = np.where(seen, DETECTED, DETECTED_BEHIND), np.cumsum(count) - count
        total = 1 - expectation + expectation * np.add.reduceat(ratio, first) / count[:, None]
        score = np.log(total).sum(0)
        weight = np.exp(score - score.max())
        evidence += score.max() + np.log(weight.mean())
        weight /= weight.sum()
        for scan, share in enumerate(expectation * weight / total / count[:, None]):
            own = slice(first[scan], first[scan] + count[scan])
            chance = ratio[own] @ share
            likeliest.append(rows[own][chance.argmax()])
            chances.append(chance.sum())
        ranges.extend((distance @ weight).tolist())
        track.append(weight @ some.position)
        # of many starts few are left once these steps have told them apart
        left = PARTICLES if starts is not None and len(track) >= TOLD_APART else len(weight)
        some = some.drawn(weight, left, error, draw)
    row, chance, places = np.array(likeliest, np.intp), np.array(chances), np.reshape(track, (-1, 2))
    step, anchor = columns["step"][row], columns["anchor"][row]
    least = LEAST_SEEN_THOROUGH if thorough else LEAST_SEEN
    judged = _in_sight(scene, anchor, places[np.unique(step, return_inverse=True)[1]], least)
    shares = [
        chance[judged & (anchor == number)].mean() if (judged & (anchor == number)).any() else np.nan
        for number in range(len(scene.anchors))
    ]
    return Sight(
        float(evidence),
        len(row),
        float(chance[judged].mean()) if len(row) else 0.0,
        row,
        np.array(ranges),
        chance,
        places,
        np.array(shares),
        float(some.size_m.mean()) if some.size_m is not None else 0.0,
        np.array([*some.begun[:, :2].mean(0), np.angle(np.exp(1j * some.begun[:, 2]).mean())]),
        steps if len(scans.rows) < len(columns["step"]) else None,
    )


def _in_sight(scene: Scene, anchor: NDArray[np.intp], position: Array, least: float) -> NDArray[np.bool_]:
    """Scans (R,) in which the scene's walls leave the anchor in sight; all if less than that share is."""
    clear = in_view(scene.anchor_positions[anchor], position, scene.segments())
    return clear if clear.sum() >= max(least * len(clear), 1) else np.ones(len(anchor), dtype=bool)


@dataclass(frozen=True, eq=False)
class _Scans:
    """The rows of a table's first steps, by step and anchor.

    Attributes
    ----------
    rows : (R,) int
        Indices into the table.
    step, anchor, count : (S,) int
        Of each scan, and how many rows it has.
    begin : int
        The table's first step.
    """

    rows: NDArray[np.intp]
    step: NDArray[np.intp]
    anchor: NDArray[np.intp]
    count: NDArray[np.intp]
    begin: int

    @classmethod
    def of(cls, columns: Mapping[str, NDArray], steps: int) -> _Scans:
        step, anchor = np.asarray(columns["step"], np.intp), np.asarray(columns["anchor"], np.intp)
        begin = int(step[0]) if len(step) else 0
        rows = np.flatnonzero(step < begin + steps)
        rows = rows[np.lexsort((anchor[rows], step[rows]))]
        first = np.flatnonzero(np.diff(step[rows], prepend=-1) | np.diff(anchor[rows], prepend=-1))
        count = np.diff(first, append=len(rows))
        return cls(rows, step[rows[first]], anchor[rows[first]], count, begin)

    def __iter__(self) -> Iterator[tuple[int, NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]]:
        """Of each step: steps since the one before; anchors (A,) heard; their rows, and how many of each."""
        first = np.flatnonzero(np.diff(self.step, prepend=-1))
        behind, before = np.cumsum(self.count), self.begin
        for start, end in zip(first, [*first[1:], len(self.step)], strict=True):
            after, before = max(int(self.step[start]) - before, 1), int(self.step[start])
            scans = slice(start, end)
            rows = self.rows[behind[start] - self.count[start] : behind[end - 1]]
            yield after, self.anchor[scans], rows, self.count[scans]


@dataclass(frozen=True, eq=False)
class _Particles:
    """Where the agent may be.

    Attributes
    ----------
    position, heading : (P, 2) m, (P,) rad
    pace : (P,) m
        Standard deviation of a step.
    going : (P, 2)
        The latest step, in paces.
    begun : (P, 3) m, m, rad
        Where it began, and how it faced.
    size_m : (P,), optional
        Of the error that is supposed in the distances.
    """

    position: Array
    heading: Array
    pace: Array
    going: Array
    begun: Array
    size_m: Array | None = None

    @classmethod
    def at(cls, position: Array, heading: Array, pace: Array) -> _Particles:
        """Particles that begin there."""
        begun = np.column_stack([position, heading])
        return cls(position, heading, pace, np.zeros_like(position), begun)

    def moved(
        self, steps: int, lasting: float, turn_rad: float, widest_rad: float, draw: np.random.Generator
    ) -> _Particles:
        """Those after so many steps, of which some turn by up to `widest_rad`, not `turn_rad`."""
        gap = np.sqrt(steps)
        going = lasting * self.going + np.sqrt(1 - lasting**2) * draw.standard_normal(self.position.shape)
        turn = np.where(np.arange(len(self.heading)) % SHARP_ONES == 0, widest_rad, turn_rad)
        heading = self.heading + gap * turn * draw.standard_normal(len(self.heading))
        position = self.position + gap * self.pace[:, None] * going
        return _Particles(position, heading, self.pace, going, self.begun, self.size_m)

    def distances(
        self, away: Array, anchors: NDArray[np.intp], heights: Array, error: RangeError | None
    ) -> Array:
        """Distances (A, P) in m that each expects of anchors which it is `away` (A, P, 2) m from."""
        level = np.hypot(away[..., 0], away[..., 1])
        if error is None or self.size_m is None:
            return slant(level, heights[:, None])
        spoilt = zip(level, anchors.tolist(), heights.tolist(), strict=True)
        return np.stack([error.spoilt(own, self.size_m, *anchor) for own, *anchor in spoilt])

    def drawn(
        self, weight: Array, left: int, error: RangeError | None, draw: np.random.Generator
    ) -> _Particles:
        """So many of them, drawn systematically by weight (P,)."""
        places = (draw.random() + np.arange(left)) / left
        chosen = np.minimum(np.searchsorted(np.cumsum(weight), places), len(weight) - 1)
        size = None
        if error is not None and self.size_m is not None:
            size = error.redrawn(self.size_m[chosen], draw)
        return _Particles(
            self.position[chosen], self.heading[chosen], self.pace[chosen], self.going[chosen],
            self.begun[chosen], size,
        )  # fmt: skip


def _start(scene: Scene, agent: str | None, draw: np.random.Generator, times: int) -> _Particles:
    """Particles about the agent's start, `times` as many as usual; anywhere in the grid without an agent."""
    if agent is None:
        low, high = np.transpose([scene.grid.x_m, scene.grid.y_m])
        count = 10 * PARTICLES
        position = draw.uniform(low, high, (count, 2))
        return _Particles.at(position, draw.uniform(-np.pi, np.pi, count), np.full(count, 0.1))
    body = scene.agent(agent)
    wide = max(body.prior.position_m, 0.1)
    count = times * PARTICLES
    position = body.start_m + draw.uniform(-wide, wide, (count, 2))
    facing = np.radians(body.start_heading_deg + body.prior.heading_deg * draw.uniform(-1, 1, count))
    return _Particles.at(position, facing, _paces(body.step_m, count))


def _paces(step_m: float, count: int) -> Array:
    """Standard deviations (count,) of a step in m.

    A quarter of the particles hurries, since a table of one's own needn't keep to the scene's step.
    """
    return step_m * np.where(np.arange(count) % 4 == 0, 4.0, 0.8)


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
