"""What anchors say of each other: seen at once, or one after the other, they put the agent in one place.

An anchor that is tied to no other one, nor to the told start, may stand anywhere and any way: its lines of
sight fit whatever the scene says of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.sights.line_of_sight_filter import Sight
from gridslam.checks.sights.own_poses import OwnPoses, Stand, continued, poses
from gridslam.world.columns import Columns
from gridslam.world.geometry import wrap
from gridslam.world.scene import Scene

LONGEST = 1000
"""Steps that are looked at, of a long table the first."""
MOST_STEPS = 3
"""Between two anchors' lines of sight that count as one after the other."""
AREA_M2 = 30.0
"""In which a place lies by chance: a room's."""
FACING_STD = np.radians(8.0)
STRAY = 0.1
"""Probability that one of the two isn't a line of sight at all."""
TIED = 10.0
"""Log likelihood ratio in nats, to places by chance, from which on two anchors are tied."""
MOST_MISFIT = 2.0
"""Mean misfit of handovers that agree up to which they do: of right tables it is 0.1 to 0.6."""
LEAST_NEAR = 5
"""Lines of sight of an anchor with one of another near in time, below which it is heard alone."""
LEAST_SIGHTS = 8
"""Lines of sight from which on something is said of an anchor."""
FIRST, LEAST_FIRST = 8, 4
"""Steps by which the start is judged, and lines of sight in them at least."""
NEAR_M = 0.4
"""To the line of the others, of those that count."""
MOST_START_M, MOST_START_DEG = 1.0, 30.0
"""Half widths of the start's prior up to which it ties what is in sight then."""


@dataclass(frozen=True, eq=False)
class Handovers:
    """Pairs of lines of sight of two anchors, at the same step or nearly.

    Attributes
    ----------
    rows : (H, 2) int
    anchors : (H, 2) int
    ratio : (H,) float64
        Log likelihood ratio in nats: the same pose, over poses by chance.
    misfit : (H,) float64
        Half the squared, normalised gaps: 1.5 on average, if these are as wide as they are taken for.
    """

    rows: NDArray[np.intp]
    anchors: NDArray[np.intp]
    ratio: Array
    misfit: Array

    @classmethod
    def of(cls, seen: OwnPoses, scene: Scene, agent: str | None) -> Handovers:
        """Of all anchors' lines of sight."""
        pairs = [
            _nearest(seen, one, other)
            for one, other in combinations(range(len(seen.sights)), 2)
            if len(seen.sights[one]) and len(seen.sights[other])
        ]
        rows = np.concatenate([np.zeros((0, 2), np.intp), *pairs])
        a, b = rows.T
        steps = np.abs(seen.step[a] - seen.step[b])
        pace = scene.agent(agent).step_m if agent is not None else 0.1
        spread = np.sqrt(seen.spread_m[a] ** 2 + seen.spread_m[b] ** 2 + (1.5 * pace * steps) ** 2)
        gap = np.linalg.norm(seen.place[a] - seen.place[b], axis=1)
        misfit = 0.5 * (gap / spread) ** 2
        ratio = np.log(AREA_M2 / (2 * np.pi * spread**2))
        turning = np.hypot(FACING_STD, np.radians(scene.filter.heading_deg) * np.sqrt(steps))
        turn = wrap(seen.facing[a] - seen.facing[b]) / turning
        misfit += np.nan_to_num(0.5 * turn**2)
        ratio += np.where(np.isfinite(turn), np.log(np.sqrt(2 * np.pi) / turning), 0.0) - misfit
        mixed = np.logaddexp(np.log(STRAY), np.log1p(-STRAY) + ratio)
        return cls(rows, seen.anchor[rows], mixed, misfit)

    @property
    def evidence(self) -> float:
        """Of those that agree, nats: nothing is gained where others only fall out of sight."""
        return float(np.maximum(self.ratio, 0.0).sum())

    def between(self, one: int, other: int) -> NDArray[np.bool_]:
        """Which (H,) are between two anchors."""
        return np.asarray((self.anchors == [min(one, other), max(one, other)]).all(1))

    def tied(self, one: int, other: int) -> bool:
        """Whether two anchors put the agent in the same place, more often than chance does."""
        own = self.between(one, other)
        good = own & (self.ratio > 0)
        return bool(self.ratio[own].sum() >= TIED and self.misfit[good].mean() < MOST_MISFIT)


@dataclass(frozen=True)
class Beginning:
    """Where the first lines of sight put the agent at the table's first step.

    Attributes
    ----------
    anchors : tuple of int
        By which.
    gap_m, gap_rad : float
        To the told start, to the told heading (signed; NaN if no AoA tells).
    place, pace_m : (2,) m
        Where, and how far it goes in a step.
    spread_m, spread_rad : float
        Standard deviations of these.
    """

    anchors: tuple[int, ...]
    gap_m: float
    gap_rad: float
    place: Array
    pace_m: Array
    spread_m: float
    spread_rad: float

    def ratio(self, scene: Scene, agent: str) -> float:
        """Log likelihood ratio in nats of the told start over one by chance."""
        prior = scene.agent(agent).prior
        spread = np.hypot(max(prior.position_m, 0.2), self.spread_m)
        ratio = float(np.log(AREA_M2 / (2 * np.pi * spread**2)) - 0.5 * (self.gap_m / spread) ** 2)
        if np.isfinite(self.gap_rad):
            turning = np.sqrt(FACING_STD**2 + np.radians(prior.heading_deg) ** 2 + self.spread_rad**2)
            ratio += float(np.log(np.sqrt(2 * np.pi) / turning) - 0.5 * (self.gap_rad / turning) ** 2)
        return float(np.logaddexp(np.log(STRAY), np.log1p(-STRAY) + ratio))


def beginning(seen: OwnPoses, scene: Scene, agent: str | None) -> Beginning | None:
    """The beginning by straight lines through the first poses; None if they are too few, or tell nothing."""
    if agent is None or not len(seen.step):
        return None
    rows = np.concatenate(seen.sights)
    rows = rows[seen.step[rows] < seen.step[0] + FIRST]
    rows = rows[_on_a_line((seen.step[rows] - seen.step[0]).astype(np.float64), seen.place[rows])]
    after = (seen.step[rows] - seen.step[0]).astype(np.float64)
    if len(rows) < LEAST_FIRST or len(np.unique(after)) < 2:
        return None
    body = scene.agent(agent)
    (place, pace), spread_m = _at_first(after, seen.place[rows])
    told = np.radians(body.start_heading_deg)
    turn = seen.facing[rows] - told
    middle = float(np.angle(np.nanmean(np.exp(1j * turn)))) if np.isfinite(turn).any() else np.nan
    good = np.isfinite(turn)
    gap_rad, spread_rad = np.nan, np.inf
    if good.sum() >= LEAST_FIRST and len(np.unique(after[good])) > 1:
        (left, _), spread_rad = _at_first(after[good], wrap(turn[good] - middle)[:, None])
        gap_rad = float(wrap(middle + left[0]))
    gap_m = float(np.linalg.norm(place - body.start_m))
    anchors = tuple(np.unique(seen.anchor[rows]).tolist())
    return Beginning(anchors, gap_m, gap_rad, place, pace, spread_m, spread_rad)


def _on_a_line(after: Array, place: Array) -> NDArray[np.bool_]:
    """Which places (N, 2) lie near the line over the steps (N,) that most do: reflections don't."""
    best = np.zeros(len(after), dtype=bool)
    for one, other in combinations(range(len(after)), 2):
        if after[one] == after[other]:
            continue
        pace = (place[other] - place[one]) / (after[other] - after[one])
        expected = place[one] + (after[:, None] - after[one]) * pace
        near = np.linalg.norm(place - expected, axis=1) < NEAR_M
        best = near if near.sum() > best.sum() else best
    return best


def _at_first(after: Array, values: Array) -> tuple[Array, float]:
    """A straight line of values (N, C): (2, C), at the first step, and by step; deviation of the former."""
    design = np.column_stack([np.ones(len(after)), after])
    line: Array = np.linalg.lstsq(design, values, rcond=None)[0].astype(np.float64)
    left = values - design @ line
    spread = np.sqrt((left**2).sum(1).mean() * len(after) / max(len(after) - 2, 1))
    return line, float(spread * np.sqrt(np.linalg.inv(design.T @ design)[0, 0]))


@dataclass(frozen=True, eq=False)
class Ties:
    """What ties the anchors of a table.

    Attributes
    ----------
    seen : OwnPoses
    handovers : Handovers
    start : Beginning or None
    """

    seen: OwnPoses
    handovers: Handovers
    start: Beginning | None

    @classmethod
    def of(cls, table: Columns, scene: Scene, agent: str | None) -> Ties | None:
        """Of a table in the order of steps; None if no anchor alone tells where the agent is.

        Nor does it where nobody set the clocks, which lengths are off by.

        Parameters
        ----------
        table : dict of (K,) arrays
            Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
        """
        if scene.clocks is not None:
            return None
        short = first_steps(table)
        stand = Stand.of(scene, agent)
        kept = continued(short, scene, agent, stand)
        if not len(kept):
            return None
        seen = poses(short, scene, stand, kept)
        return cls(seen, Handovers.of(seen, scene, agent), beginning(seen, scene, agent))

    def untied(self, scene: Scene, agent: str | None) -> list[int]:
        """Anchors that are in sight, but tied to no other one and not to the start."""
        starting = self._starting(scene, agent)
        often = [number for number, rows in enumerate(self.seen.sights) if len(rows) >= LEAST_SIGHTS]
        return [
            one
            for one in often
            if one not in starting
            and not any(
                self.handovers.tied(one, other) for other in range(len(self.seen.sights)) if other != one
            )
        ]

    def _starting(self, scene: Scene, agent: str | None) -> tuple[int, ...]:
        """Anchors that are in sight at first, where the start is known well enough to tie them."""
        return self.start.anchors if self.start is not None and start_ties(scene, agent) else ()


def first_steps(table: Columns) -> Columns:
    """A table in the order of steps, cut where nobody looks any more.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    """
    near = table["step"] < table["step"][0] + LONGEST
    return {name: values[near] for name, values in table.items()}


def _nearest(seen: OwnPoses, one: int, other: int) -> NDArray[np.intp]:
    """Rows (H, 2) of two anchors that are each other's nearest in time, and near."""
    first, second = seen.sights[one], seen.sights[other]
    apart = np.abs(seen.step[first][:, None] - seen.step[second])
    to, back = apart.argmin(1), apart.argmin(0)
    mutual = back[to] == np.arange(len(first))
    near = mutual & (apart[np.arange(len(first)), to] <= MOST_STEPS)
    return np.column_stack([first[near], second[to[near]]])


def start_ties(scene: Scene, agent: str | None) -> bool:
    """Whether a start is known well enough to tie the anchors that are in sight then."""
    if agent is None:
        return False
    prior = scene.agent(agent).prior
    return bool(prior.position_m <= MOST_START_M and prior.heading_deg <= MOST_START_DEG)


def heard_alone(table: Columns, sight: Sight, scene: Scene, agent: str | None) -> list[int]:
    """Anchors of whose lines of sight, as a filter found them, hardly any is near one of another anchor.

    For tables without angles of departure: no anchor alone tells of a place there.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    sight : Sight
        Its lines of sight.
    """
    rows = sight.row[sight.sure]
    step, anchor = table["step"][rows], table["anchor"][rows]
    found = []
    for number in range(len(scene.anchors)):
        own, others = step[anchor == number], step[anchor != number]
        if len(own) < LEAST_SIGHTS:
            continue
        if start_ties(scene, agent) and (own < table["step"][0] + FIRST).sum() >= LEAST_FIRST:
            continue
        near = np.abs(own[:, None] - others).min(1, initial=MOST_STEPS + 1) <= MOST_STEPS
        found += [number] if near.sum() < LEAST_NEAR else []
    return found
