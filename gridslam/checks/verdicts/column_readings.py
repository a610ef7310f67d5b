"""How columns read otherwise would fit the scene: one after the other, and each alone in the whole table."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gridslam.arrays import Array
from gridslam.checks.anchors.rivals import ALIKE, CERTAIN, CLEAR, EXPLAINED, MOST_BEHIND, STRAIGHT_RAD
from gridslam.checks.sights.fit import least_share, settled
from gridslam.checks.sights.line_of_sight_filter import Sight, explain, turning_rad
from gridslam.checks.starts.start_search import one_in_sight
from gridslam.checks.tables.unit_hypotheses import ADVICE, ANGLES, IN_WORLD, Suspicion, finite, readings
from gridslam.world.columns import OPTIONAL, Columns
from gridslam.world.geometry import wrap
from gridslam.world.scene import Scene

ENOUGH = 10.0
"""Log likelihood ratio in nats above which a reading is looked at."""
LEG_M, SMOOTHED = 1.0, 10
"""Legs of a way by which its course is told where it isn't well known, and steps over which places are
averaged first."""
CLOCKWISE_AND_NORTH = {("aod_rad", "flipped"), ("aoa_rad", "compass")}
"""Columns and kinds of readings that are bearings of both angles, if every anchor in sight faces north."""
NEARLY, MISSED = 0.9, 0.5
"""Share of scans that a column explains above which no reading explains far more; and share, of those that it
leaves over, which such a reading may leave."""
GAINED = 0.1
"""Share of scans that another reading must explain beyond those that the column explains as it stands."""


@dataclass(frozen=True)
class Reading:
    """A column read otherwise.

    Attributes
    ----------
    column, kind : str
    alike : dict of float
        Share of scans that readings explain that fit nearly as well, by what they are called.
    """

    column: str
    kind: str
    alike: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Way:
    """A whole table with some of its columns read otherwise.

    Attributes
    ----------
    read : tuple of Reading
        Empty: as it stands.
    table : dict of (K,) arrays
    sight : Sight
        What is explained then.
    """

    read: tuple[Reading, ...]
    table: Columns
    sight: Sight

    @property
    def kinds(self) -> set[tuple[str, str]]:
        """Columns that are read otherwise, each with how."""
        return {(one.column, one.kind) for one in self.read}

    @property
    def in_world(self) -> bool:
        """Whether arrivals are taken as directions in the world, of which the table knows nothing."""
        return bool(self.kinds & IN_WORLD)

    def outdoes(self, best: Way, least: float, margin: float = CLEAR) -> bool:
        """Whether it explains more by a margin in nats than the best so far, or than `least` if none is."""
        return self.sight.evidence > (best.sight.evidence + margin if best.read else least)

    def suspicions(self, table: Columns, scene: Scene, agent: str | None) -> list[Suspicion]:
        """What is wrong with a table as it stands; nothing if the cured one doesn't fit either.

        Parameters
        ----------
        table : dict of (K,) arrays
            As it stands.
        """
        if not self.read:
            return []
        before = settled(table, scene, agent)
        after = settled(self.table, scene, agent, self.in_world)
        if after.explained < least_share(scene):
            return []
        gain = self.sight.evidence - explain(table, scene, agent).evidence
        more = after.explained >= min(before.explained + GAINED, EXPLAINED)
        found = []
        for one in self.read:
            reason = (
                f"line of sight in {after.explained:.0%} of {after.judged}, "
                f"{before.explained:.0%} as it stands; log likelihood ratio {gain:.0f}"
            )
            if one.alike:
                advice = "; ".join(f"{label} ({share:.0%})" for label, share in one.alike.items())
                reason += f"; nearly as much is explained by: {advice}"
            sure = more and gain > CERTAIN and not one.alike
            found.append(Suspicion(one.column, one.kind, advice_on(one.column, one.kind), sure, reason))
        return found


def advice_on(column: str, kind: str) -> str:
    """What a reading of a column is called."""
    return ADVICE[
        kind if kind in ADVICE else f"{kind} of {'departure' if column == 'aod_rad' else 'arrival'}"
    ]


def likeliest_way(table: Columns, scene: Scene, agent: str | None, plain: Sight) -> Way:
    """The way to read a table's columns that explains most; as it stands, if none explains clearly more.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    plain : Sight
        What is explained as it stands.
    """
    asis = Way((), table, plain)
    if plain.explained >= EXPLAINED:
        world = _world_frame(table, scene, agent, plain)
        return world or _far_better(table, scene, agent, plain) or asis
    alone = _each_alone(table, scene, agent)
    least = max(plain.evidence + CERTAIN, CERTAIN)
    fair = [way for way in alone if way.sight.evidence > least and way.sight.explained >= least_share(scene)]
    best = _with_rivals(fair, scene) if fair else asis
    together = _one_by_one(table, scene, agent)
    if not scene.walls and one_in_sight(together.sight):
        return best  # about one anchor, with nobody knowing when it is hidden, two errors explain anything
    if len(together.read) > 1 and together.outdoes(best, least):
        best = together
    bearings = _bearings(table, scene, agent)
    if bearings is not None and bearings.sight.explained >= least_share(scene):
        # about an anchor that faces north, departures that are counted clockwise are the same
        margin = -CERTAIN if best.kinds == CLOCKWISE_AND_NORTH else CLEAR
        best = bearings if bearings.outdoes(best, least, margin) else best
    mirrored = _mirrored(table, scene, agent)
    if mirrored is None or mirrored.sight.explained < least_share(scene):
        return best
    both = best.kinds == {(name, "flipped") for name in ANGLES}
    return mirrored if both or mirrored.outdoes(best, least) else best


def _far_better(table: Columns, scene: Scene, agent: str | None, plain: Sight) -> Way | None:
    """One column's other reading that explains far more than a table that nearly fits as it stands.

    Along a wall arrivals of the other sense pass for the agent's, whose heading then turns as it goes by, and
    only one anchor of several shows that they are wrong.
    """
    if not scene.walls or plain.explained > NEARLY:
        return None
    least = plain.evidence + 2 * CERTAIN
    ways = [way for way in _each_alone(table, scene, agent) if way.sight.evidence > least]
    fair = [way for way in ways if 1.0 - way.sight.explained <= MISSED * (1.0 - plain.explained)]
    return _with_rivals(fair, scene) if fair else None


def _mirrored(table: Columns, scene: Scene, agent: str | None) -> Way | None:
    """Both angles counted clockwise, as in a scene that is mirrored; None where they aren't both measured."""
    if not all(len(finite(table, name)) for name in ANGLES):
        return None
    read = table | {name: -table[name] for name in ANGLES}
    return Way((Reading("aod_rad", "mirrored"),), read, explain(read, scene, agent))


def _bearings(table: Columns, scene: Scene, agent: str | None) -> Way | None:
    """Both angles as compass bearings; None where they aren't both measured.

    One after the other they may fit as something else: departures from an anchor that faces north are then
    counted clockwise, and arrivals agree with a heading that turns as the agent passes by.
    """
    if not all(len(finite(table, name)) for name in ANGLES):
        return None
    north = 0.5 * np.pi
    leaving = north - table["aod_rad"] - scene.anchor_orientations[table["anchor"]]
    read = table | {"aod_rad": wrap(leaving), "aoa_rad": wrap(north - table["aoa_rad"])}
    both = tuple(Reading(name, "compass") for name in ANGLES)
    return Way(both, read, explain(read, scene, agent, True))


def rival_of_start(table: Columns, scene: Scene, agent: str | None, plain: Sight) -> Way:
    """The one column whose other reading fits from the told start clearly better than the table as it stands.

    For tables that fit well as they stand, as if the agent had begun elsewhere. As it stands, if none does.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    plain : Sight
        What is explained as it stands.
    """
    least = max(plain.evidence, 0.0) + CERTAIN
    ways = [way for way in _each_alone(table, scene, agent) if way.sight.evidence > least]
    fair = [way for way in ways if way.sight.explained >= max(EXPLAINED, least_share(scene))]
    return _with_rivals(fair, scene) if fair else Way((), table, plain)


def _each_alone(table: Columns, scene: Scene, agent: str | None) -> list[Way]:
    """The whole table with one column read otherwise, for all readings that there are."""
    found = []
    for name in ("distance_m", *ANGLES):
        if not len(finite(table, name)):
            continue
        for kind, reading in readings(name, scene, table).items():
            read = table | {name: reading(table[name], table["anchor"])}
            if kind == "swapped":
                read["aoa_rad"] = table["aod_rad"]
            sight = explain(read, scene, agent, (name, kind) in IN_WORLD)
            as_if = name == "aoa_rad" and kind == "world frame"
            if not (as_if and _straight_along_x(sight, table, scene, agent)):
                found.append(Way((Reading(name, kind),), read, sight))
    return found


def _with_rivals(fair: list[Way], scene: Scene) -> Way:
    """The best of ways that read one column each, with those that explain nearly as much."""
    best = max(fair, key=lambda way: way.sight.evidence)
    least = max(ALIKE * best.sight.explained, least_share(scene))
    column, alike = best.read[0].column, dict[str, float]()
    for way in sorted(fair, key=lambda way: -way.sight.evidence):
        near = way.sight.evidence > best.sight.evidence - MOST_BEHIND
        if way is not best and near and way.sight.explained >= least:
            (one,) = way.read
            advice = advice_on(one.column, one.kind)
            alike[advice if one.column == column else f"{one.column}: {advice}"] = way.sight.explained
    return Way((Reading(column, best.read[0].kind, alike),), best.table, best.sight)


def _world_frame(table: Columns, scene: Scene, agent: str | None, plain: Sight) -> Way | None:
    """Arrivals in the world's frame: they fit nearly as well where the heading hardly moves."""
    if not len(finite(table, "aoa_rad")):
        return None
    sight = explain(table, scene, agent, True)
    if sight.evidence <= max(plain.evidence + ENOUGH, ENOUGH) or _straight_along_x(
        sight, table, scene, agent
    ):
        return None
    return Way((Reading("aoa_rad", "world frame"),), table, sight)


def _straight_along_x(sight: Sight, table: Columns, scene: Scene, agent: str | None) -> bool:
    """Whether the agent only goes ahead along x: relative to a heading of 0 is the same as in the world."""
    if agent is not None:
        body = scene.agent(agent)
        if abs(wrap(np.radians(body.start_heading_deg))) >= np.radians(body.prior.heading_deg + 10):
            return False
    if turning_rad(sight.position_m) < STRAIGHT_RAD:
        return True
    steps = min(SMOOTHED, max(len(sight.position_m), 1))
    smooth = np.array([np.convolve(one, np.full(steps, 1 / steps), "valid") for one in sight.position_m.T]).T
    if turning_rad(smooth, LEG_M) >= STRAIGHT_RAD:
        return False
    # it may only seem to turn, where places are told to decimetres; unless little else explains the table
    return sight.evidence < explain(table, scene, agent, thorough=True).evidence + CERTAIN


def _one_by_one(table: Columns, scene: Scene, agent: str | None) -> Way:
    """Columns questioned one after the other, each with those before it read rightly."""
    trusted: Columns = {name: table[name] for name in ("step", "anchor", *OPTIONAL) if name in table}
    rest, read, sight = dict(table), list[Reading](), None
    for name in ("distance_m", *ANGLES):
        if not len(finite(rest, name)):
            continue
        sight = plain = explain(trusted | {name: rest[name]}, scene, agent)
        others = dict[str, tuple[Array, Sight]]()
        if plain.explained < EXPLAINED:
            for kind, reading in readings(name, scene, rest).items():
                world = (name, kind) in IN_WORLD
                values = reading(rest[name], table["anchor"])
                other = explain(trusted | {name: values}, scene, agent, world)
                gained = other.explained >= plain.explained + GAINED or world
                if gained and other.evidence > max(plain.evidence + ENOUGH, ENOUGH):
                    others[kind] = values, other
        elif name == "aoa_rad" and (way := _world_frame(trusted | {name: rest[name]}, scene, agent, plain)):
            others["world frame"] = rest[name], way.sight
        values = rest[name]
        if others:
            kind = max(others, key=lambda kind: others[kind][1].evidence)
            values, sight = others[kind]
            read.append(Reading(name, kind))
            if kind == "swapped":
                rest["aoa_rad"] = table["aod_rad"]
        trusted[name] = values
    if sight is None:
        return Way((), table, explain(table, scene, agent))
    return Way(tuple(read), table | trusted, sight)
