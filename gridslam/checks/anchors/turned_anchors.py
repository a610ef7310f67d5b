"""Anchors that stand otherwise than the scene says: turned by some angle, or with angles counted clockwise.

Lines of sight are followed without the angles in question; where they put the agent, these angles tell
how the anchor stands.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gridslam.arrays import Array
from gridslam.checks.scene.allowed_for import turn_allowed
from gridslam.checks.scene.views import in_view
from gridslam.checks.sights.line_of_sight_filter import Sight, explain
from gridslam.checks.tables.unit_hypotheses import finite
from gridslam.world.columns import Columns
from gridslam.world.geometry import wrap
from gridslam.world.scene import Scene

LEAST_RAD = np.radians(8.0)
"""Smaller turns aren't told of: a filter finds them, and anchors are often mounted so roughly."""
LEAST_SEEN = 8
"""Lines of sight of an anchor by which its turn is told, at least."""
NEAR_RAD = np.radians(12.0)
"""Angles count for a turn if they are nearer to it than this."""
AGREEING = 0.6
"""Share of an anchor's lines of sight that must."""
UNSEEN, MORE = 0.1, 0.1
"""Share of lines of sight below which an anchor may be hidden all the time; and share of all scans that its
turn must explain more then, in a scene without walls."""


@dataclass(frozen=True)
class Turn:
    """How an anchor stands otherwise.

    Attributes
    ----------
    anchor : int
        Index into the scene's.
    turn_rad : float
        True orientation minus the scene's.
    mirrored : bool
        Whether its angles are counted clockwise.
    """

    anchor: int
    turn_rad: float
    mirrored: bool

    def words(self, scene: Scene) -> str:
        """What is wrong, and what would be right."""
        name = scene.anchor_names[self.anchor]
        if self.mirrored:
            return f"angles of anchor {name} are counted clockwise; angles are counter-clockwise"
        stated = float(np.degrees(scene.anchor_orientations[self.anchor]))
        right = float(np.degrees(wrap(np.radians(stated) + self.turn_rad)))
        return (
            f"anchor {name} is turned by {np.degrees(self.turn_rad):.0f} degrees: its orientation_deg of "
            f"{stated:g} should be about {right:.0f}"
        )


def turned_tables(
    table: Columns, scene: Scene, agent: str | None
) -> Iterator[tuple[tuple[Turn, ...], Columns]]:
    """Ways in which anchors may stand, with the table as it should have been: each alone, then all.

    Turns come by the way's beginning first, then by all of it.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    """
    every = tuple(number for number in range(len(scene.anchors)) if _measured(table, number))
    if not len(finite(table, "distance_m")):
        return
    for group in [*((number,) for number in every), *([every] if len(every) > 1 else [])]:
        asked = np.isin(table["anchor"], group)
        sight = explain(table | {"aod_rad": np.where(asked, np.nan, table["aod_rad"])}, scene, agent)
        sets = [tuple(Turn(number, 0.0, True) for number in group)]
        for first in (LEAST_SEEN, None):
            each = (_turn(table, sight, scene, number, first) for number in group)
            sets.append(tuple(one for one in each if one is not None))
        for turns in sets:
            if len(turns) >= min(len(group), 2):  # one alone has had its turn
                yield turns, cured(table, turns)


def turned_sights(
    table: Columns, scene: Scene, agent: str | None
) -> Iterator[tuple[Sight, tuple[Turn, ...], Columns]]:
    """Ways in which anchors may stand, as of `turned_tables`, that their lines of sight bear out.

    Each with what is explained of the table as it should have been, and that table.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    """
    for turns, read in turned_tables(table, scene, agent):
        sight = explain(read, scene, agent)
        if _borne_out(sight, turns, read, scene):
            yield sight, turns, read


def cured(table: Columns, turns: tuple[Turn, ...]) -> Columns:
    """The table as anchors that stand as the scene says would have measured it.

    Parameters
    ----------
    table : dict of (K,) arrays
        With `anchor` and `aod_rad`.
    """
    angle = table["aod_rad"].copy()
    for one in turns:
        own = table["anchor"] == one.anchor
        raw = -angle[own] if one.mirrored else angle[own]
        angle[own] = wrap(raw + one.turn_rad)
    return table | {"aod_rad": angle}


def beyond_told(turns: tuple[Turn, ...], sight: Sight, table: Columns, scene: Scene) -> tuple[Turn, ...]:
    """Those of some turns that the scene's deviations of anchors don't allow for.

    Parameters
    ----------
    sight : Sight
        What is explained with the turns: how far away the agent is.
    table : dict of (K,) arrays
        In the order of the sight's rows.
    """
    heard = table["anchor"][sight.row]
    return tuple(
        turn
        for turn in turns
        if turn.mirrored
        or not turn_allowed(turn.turn_rad, turn.anchor, sight.distance_m[heard == turn.anchor], scene)
    )


def by_chance(turns: tuple[Turn, ...], plain: Sight, sight: Sight, scene: Scene) -> bool:
    """Whether anchors may be hidden, and turns explain little more: some turn fits what a wall reflects.

    Parameters
    ----------
    plain, sight : Sight
        What is explained without the turns, and with them.
    """
    unseen = all(plain.shares[turn.anchor] < UNSEEN for turn in turns)
    return unseen and not scene.walls and sight.explained < plain.explained + MORE


def nearly(turns: tuple[Turn, ...], others: tuple[Turn, ...]) -> bool:
    """Whether the same anchors are turned by nearly as much."""
    return all(abs(wrap(a.turn_rad - b.turn_rad)) < NEAR_RAD for a, b in zip(turns, others, strict=True))


def words(turns: tuple[Turn, ...], scene: Scene) -> str:
    """All of it in a line."""
    return "; ".join(one.words(scene) for one in turns)


def names_words(order: tuple[int, ...], scene: Scene) -> str:
    """Which names are exchanged, by which of the scene's anchors each of the table's is."""
    names = scene.anchor_names
    moved = [f"{names[i]} is the scene's {names[n]}" for i, n in enumerate(order) if i != n]
    return f"names exchanged: {', '.join(moved)}; or the table is another scene's"


def _measured(table: Columns, anchor: int) -> bool:
    """Whether enough angles of departure of an anchor are there."""
    if "aod_rad" not in table:
        return False
    return bool(np.isfinite(table["aod_rad"][table["anchor"] == anchor]).sum() >= LEAST_SEEN)


def _turn(table: Columns, sight: Sight, scene: Scene, anchor: int, first: int | None) -> Turn | None:
    """The turn that most of an anchor's first lines of sight agree on; None if too few do, or a small one.

    Where no other anchor is heard, the agent may drift around this one: the start is what is known best.
    """
    rows = sight.row[sight.sure]
    rows = rows[(table["anchor"][rows] == anchor) & np.isfinite(table["aod_rad"][rows])][:first]
    if len(rows) < LEAST_SEEN:
        return None
    steps = np.unique(table["step"][sight.row])
    away = sight.position_m[np.searchsorted(steps, table["step"][rows])] - scene.anchor_positions[anchor]
    expected = np.arctan2(away[:, 1], away[:, 0]) - scene.anchor_orientations[anchor]
    turn, share = _common(np.asarray(wrap(expected - table["aod_rad"][rows])))
    return Turn(anchor, turn, False) if share >= AGREEING and abs(turn) >= LEAST_RAD else None


def _borne_out(sight: Sight, turns: tuple[Turn, ...], table: Columns, scene: Scene) -> bool:
    """Whether each turned anchor has lines of sight, and walls don't hide it at most of them.

    What reflects the signals of an anchor that is hidden all the time fits some turn of it, or its angles
    counted the other way.

    Parameters
    ----------
    sight : Sight
        What is explained with the turns.
    table : dict of (K,) arrays
        As they say that it should have been.
    """
    rows = sight.row[sight.sure]
    number = np.searchsorted(np.unique(table["step"][sight.row]), table["step"][rows])
    anchor = table["anchor"][rows]
    clear = in_view(scene.anchor_positions[anchor], sight.position_m[number], scene.segments())
    own = [clear[anchor == turn.anchor] for turn in turns]
    return all(len(one) >= LEAST_SEEN and one.mean() >= 0.5 for one in own)


def _common(angle: Array) -> tuple[float, float]:
    """The angle that most of some (N,) are near to, and the share of them that are."""
    near = np.abs(wrap(angle[:, None] - angle)) < NEAR_RAD
    own = angle[near[near.sum(1).argmax()]]
    middle = float(np.angle(np.exp(1j * own).mean()))
    return middle, float((np.abs(wrap(angle - middle)) < NEAR_RAD).mean())
