"""How well the line of sight to known anchors explains what was heard: a small particle filter of its own.

It knows nothing of walls, so it works before any map does, and it is blunt on purpose: a scan whose line of
sight is blocked costs little. Its evidence compares readings of the same table (radians or degrees, metres or
seconds).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.checks.scene.range_errors import SHRINKAGE, RangeError
from gridslam.checks.scene.views import in_view
from gridslam.checks.sights.likelihood import rows_of
from gridslam.checks.sights.particles import TOLD_APART, Scans, paces, particles_at, particles_of
from gridslam.checks.sights.remembered import remembered
from gridslam.kernels.primitives import sights as column
from gridslam.kernels.primitives.sights import Sights
from gridslam.world.geometry import unit
from gridslam.world.scene import Scene

STEPS = 100
DETECTED = 0.9
"""Share of the scans in which a line of sight is expected."""
DETECTED_BEHIND = 0.3
"""Share of those in which one is expected where the scene's walls hide the anchor from the middle of the
particles, bluntly."""
LASTING = 0.9
"""Correlation of a particle's velocity from step to step, where it keeps any."""
CROWD = 4
"""Times as many particles where the size of an error is looked for, too."""
SHARP_RAD, SHARP_ONES = np.radians(45.0), 8
"""Standard deviation of a sharp turn within a step, and of how many particles one may take it."""
LEAST_SEEN, LEAST_SEEN_THOROUGH = 0.3, 0.15
"""Share of the scans that walls must leave in sight for the others not to be judged."""
SURE, LIKELY = 0.7, 0.5
"""Probabilities above which a row is taken for a line of sight: surely, and rather than not."""


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
    def sure(self) -> NDArray[np.bool_]:
        """Which of `row` (R,) are surely lines of sight: what is measured of an error goes by these."""
        return self.probability > SURE

    @property
    def likely(self) -> NDArray[np.bool_]:
        """Which of `row` (R,) are lines of sight rather than not: whom a row belongs to goes by these."""
        return self.probability > LIKELY

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
    across: bool = False,
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
    across : bool
        Follow it across holes in time that steps don't count, too: it may get lost there.
    """
    draw = np.random.default_rng(0)
    some = particles_of(scene, agent, draw, crowd or (1 if error is None else CROWD))
    if starts is not None:
        pace = paces(scene.agent(agent).step_m if agent is not None else 0.1, len(starts))
        some = particles_at(starts[:, :2], starts[:, 2], pace)
    if error is not None:
        some[:, column.SIZE] = error.start(len(some), draw)
    scans = Scans.of(columns, steps, across)
    # of many starts few are left once some steps have told them apart
    few = TOLD_APART if starts is not None else len(scans.step) + 1
    step, draws = scans.by_step(len(some), few, error is not None, draw)
    turn = np.radians(scene.filter.heading_deg)
    choice = np.array([
        LASTING if thorough else 0.0, turn, max(turn, SHARP_RAD) if sharp else turn, SHARP_ONES,
        world_arrival, thorough, DETECTED, DETECTED_BEHIND, SHRINKAGE if error is not None else 0.0,
    ])  # fmt: skip
    walls, spoilt = scene.segments(), (error or RangeError("offset", ())).by_size(scene.heights(agent))
    tables = Sights(
        choice, step, scans.by_scan, rows_of(columns, scene)[scans.rows],
        np.column_stack([scene.anchor_positions, scene.anchor_orientations, spoilt]),
        np.hstack([walls.start, walls.end]), draws,
    )  # fmt: skip
    place, likeliest, some = _followed(tables, some)
    places, begun = place[:, 1:], some[:, column.BEGUN :]
    row, chance, ranges = scans.rows[likeliest[:, 0].astype(np.intp)], likeliest[:, 1], likeliest[:, 2]
    step_of, anchor = columns["step"][row], columns["anchor"][row]
    least = LEAST_SEEN_THOROUGH if thorough else LEAST_SEEN
    clear = in_view(scene.anchor_positions[anchor], places[np.unique(step_of, return_inverse=True)[1]], walls)
    # all, if walls leave too few in sight for the others not to be judged
    judged = clear if clear.sum() >= max(least * len(clear), 1) else np.ones(len(anchor), dtype=bool)
    shares = [
        chance[judged & (anchor == number)].mean() if (judged & (anchor == number)).any() else np.nan
        for number in range(len(scene.anchors))
    ]
    return Sight(
        float(place[:, 0].sum()),
        len(row),
        float(chance[judged].mean()) if len(row) else 0.0,
        row,
        ranges,
        chance,
        places,
        np.array(shares),
        float(some[:, column.SIZE].mean()) if error is not None else 0.0,
        np.array([*begun[:, :2].mean(0), np.angle(np.exp(1j * begun[:, 2]).mean())]),
        scans.steps if len(scans.rows) < len(columns["step"]) else None,
    )


def _followed(tables: Sights, some: Array) -> tuple[Array, Array, Array]:
    """What `follow_sights` tells of steps (S, 3) and scans (Q, 3), and the particles that are left."""
    steps, scans = len(tables.step) - 1, len(tables.scan) - 1
    if not steps:
        return np.zeros((0, 3)), np.zeros((0, 3)), some
    if runtime.start() != "cpu":  # a step needs the one before, and a few hundred particles don't fill a GPU
        from gridslam import reference

        return reference.follow_sights(tables, some)
    from gridslam.kernels.management.sight_filter import follow_sights

    count = int(tables.step[:, column.COUNT].max())
    rows = np.diff(tables.scan[tables.step[:, column.SCANS], column.ROWS]).max()
    most = int(rows + np.diff(tables.step[:, column.SCANS]).max())
    particle, place, likeliest = (
        np.zeros((2, count, column.PARTICLE)),
        np.empty((steps, 3)),
        np.empty((scans, 3)),
    )
    particle[0, : len(some)] = some
    follow_sights(tables, particle, np.empty((most + column.LINES, count)), place, likeliest)
    return place, likeliest, particle[steps % 2, : tables.step[-1, column.COUNT]]


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
