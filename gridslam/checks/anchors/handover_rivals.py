"""What explains handovers better than the scene does: names, offsets, anchors turned or elsewhere.

Where the agent is known by other anchors, rows of the anchor in question vote for how it stands; each way
that many vote for is then tried on the whole table.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.anchors.rivals import CERTAIN, PROBABLE, STRAIGHT_RAD, orders
from gridslam.checks.anchors.turned_anchors import LEAST_RAD, Turn, names_words
from gridslam.checks.scene.allowed_for import error_allowed, shift_allowed, turn_allowed
from gridslam.checks.scene.range_errors import RangeError
from gridslam.checks.scene.range_words import error_words
from gridslam.checks.sights.handovers import LEAST_SIGHTS, Beginning, Handovers, Ties, beginning, first_steps
from gridslam.checks.sights.line_of_sight_filter import turning_rad
from gridslam.checks.sights.own_poses import OwnPoses, Stand, continued, poses
from gridslam.checks.tables.unit_hypotheses import ADVICE, ANGLES, Suspicion
from gridslam.world.columns import Columns
from gridslam.world.geometry import slant, wrap
from gridslam.world.scene import Scene

BESIDE, SIMPLER = 10.0, 10.0
"""Log likelihood ratio in nats within which two explanations are named beside each other; by which one that
takes two numbers has to explain more."""
LEAST_PAIRS, AGREEING = 4, 0.6
"""Handovers of the anchors in question by which something is told, and share of them that must agree."""
SOUND, SOUND_MISFIT = 0.8, 0.75
"""Share of an anchor's handovers that agree, and their mean misfit, with which nothing is asked."""
ALWAYS, NEAR_RAD, LEG_M = 0.97, np.radians(10.0), 1.0
"""Mean resultant length of a heading that never changes; how near it is to north's or east's; legs by which
a way's turns are seen."""
VOTES, MOST_TRIED = 3, 3
"""Rows that must vote for a way to stand; ways that are tried of an anchor."""
TURN_BIN_RAD, PLACE_BIN_M = np.radians(6.0), 0.4
LEAST_SHIFT_M, MOST_SHIFT_M = 0.4, 5.0
"""Ways by which an anchor that stands elsewhere is off, and lengths by which its distances are."""
ALIKE_M, ALIKE_RAD = 0.5, np.radians(15.0)
"""Difference of lengths, of headings, up to which a row can be of the place in question."""


@dataclass(frozen=True, eq=False)
class Rival:
    """A way in which a table and a scene may have been meant.

    Attributes
    ----------
    column, kind, text : str
    anchors : tuple of int
        That it concerns.
    seen : OwnPoses
        Where they put the agent then.
    told : bool
        Whether the scene's deviations of anchors allow for it.
    """

    column: str
    kind: str
    text: str
    anchors: tuple[int, ...]
    seen: OwnPoses
    told: bool = False


def handover_rival(table: Columns, scene: Scene, agent: str | None) -> Suspicion | None:
    """What explains handovers and the told start clearly better than the scene does; None if nothing.

    In scenes with walls alone: without, reflections' places pass for the agent's.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    """
    ties = Ties.of(table, scene, agent) if scene.walls and len(scene.anchors) > 1 else None
    if ties is None or is_sound(ties, scene, agent):
        return None
    every = explanations(table, scene, agent, ties)
    found = [one for one in every if one.gain - one.handicap >= PROBABLE]
    if not found:
        return None
    best, *others = found
    beside = [one.rival for one in others if one.score > best.score - BESIDE * (1 + 2 * best.is_akin(one))]
    if any(rival.told for rival in (best.rival, *beside)):
        return None
    text = "; or ".join(dict.fromkeys([best.rival.text, *(rival.text for rival in beside)]))
    reason = (
        "lines of sight of two anchors within three steps put the agent in one place "
        f"{_agreeing(best.handed)} times, {_agreeing(ties.handovers)} as it stands; "
        f"log likelihood ratio {best.gain:.0f}"
    )
    sure = not beside and best.gain >= CERTAIN
    return Suspicion(best.rival.column, best.rival.kind, text, sure, reason)


@dataclass(frozen=True, eq=False)
class Explanation:
    """A rival, its handovers, and what these gain over the table and scene as they stand, nats."""

    gain: float
    rival: Rival
    handed: Handovers

    def is_akin(self, other: Explanation) -> bool:
        """Whether one is an offset, the other a place of the same anchor: places are blunt along the line."""
        kinds = {self.rival.kind, other.rival.kind}
        return kinds == {"offset", "place"} and self.rival.anchors == other.rival.anchors

    @property
    def handicap(self) -> float:
        """Another place takes two numbers, all else one."""
        return SIMPLER if self.rival.kind == "place" else 0.0

    @property
    def score(self) -> float:
        """With as many lines of sight as rows leave: of two ways the one that hides more of them is worse."""
        return self.gain + float(np.log(2)) * sum(map(len, self.rival.seen.sights)) - self.handicap


def explanations(table: Columns, scene: Scene, agent: str | None, ties: Ties) -> list[Explanation]:
    """Rivals that most of the handovers of the anchors in question agree with, the best first.

    None that leaves a told start which fits: a scene that looks the same from its other end, with a wall too
    few, would be turned by that.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    ties : Ties
        Of the table as it stands.
    """
    plain = evidence(ties.handovers, ties.start, scene, agent)
    found = []
    for rival in _rivals(first_steps(table), scene, agent, ties):
        handed = Handovers.of(rival.seen, scene, agent)
        own = handed.ratio[np.isin(handed.anchors, rival.anchors).any(1)]
        start = beginning(rival.seen, scene, agent)
        gain = evidence(handed, start, scene, agent) - plain
        leaves = fits_start(ties.start, scene, agent) and not fits_start(start, scene, agent)
        if len(own) >= LEAST_PAIRS and (own > 0).mean() >= AGREEING and not leaves:
            found.append(Explanation(gain, rival, handed))
    return sorted(found, key=lambda one: -one.score)


def is_sound(ties: Ties, scene: Scene, agent: str | None) -> bool:
    """Whether nothing is left to explain: each anchor's handovers fit, and the start does, if it's told."""
    handed = ties.handovers
    if ties.start is not None and not fits_start(ties.start, scene, agent):
        return False
    for number in np.unique(ties.seen.anchor):
        own = (handed.anchors == number).any(1)
        good = own & (handed.ratio > 0)
        if len(ties.seen.sights[number]) < LEAST_SIGHTS or good.sum() < max(SOUND * own.sum(), LEAST_PAIRS):
            return False
        if handed.misfit[good].mean() >= SOUND_MISFIT:
            return False
    return True


def evidence(handed: Handovers, start: Beginning | None, scene: Scene, agent: str | None) -> float:
    """Of handovers and the told start, nats."""
    if start is None or agent is None:
        return handed.evidence
    return handed.evidence + start.ratio(scene, agent)


def at_odds(handed: Handovers) -> bool:
    """Whether anchors put the agent in different places, so that none of them tells where it began."""
    return len(handed.ratio) >= LEAST_PAIRS and bool((handed.ratio > 0).mean() < AGREEING)


def fits_start(start: Beginning | None, scene: Scene, agent: str | None) -> bool:
    """Whether the first poses are rather those of the told start than any others; not, if there are none."""
    return start is not None and agent is not None and start.ratio(scene, agent) > 0


def _agreeing(handed: Handovers) -> str:
    return f"{int((handed.ratio > 0).sum())} of {len(handed.ratio)}"


def _rivals(table: Columns, scene: Scene, agent: str | None, ties: Ties) -> Iterator[Rival]:
    stand = Stand.of(scene, agent)
    kept = continued(table, scene, agent, stand)
    every = tuple(range(len(scene.anchors)))
    for order in orders(len(every)):
        moved = tuple(i for i, n in enumerate(order) if i != n)
        text = names_words(order, scene)
        yield Rival("anchor", "names", text, moved, poses(table, scene, stand.renamed(order), kept))
    for columns in (("aoa_rad",), ("aod_rad",), ANGLES):
        if set(columns) <= table.keys():
            seen = poses(table | {name: -table[name] for name in columns}, scene, stand, kept)
            compass = _compass(seen) if columns == ("aoa_rad",) else None
            both = f"{ADVICE['flipped']}; so are those of aoa_rad" if columns == ANGLES else ADVICE["flipped"]
            yield Rival(columns[0], "flipped", compass or both, every, seen)
    for number in every:
        mirrored = table | {"aod_rad": np.where(table["anchor"] == number, -1, 1) * table["aod_rad"]}
        text = Turn(number, 0.0, True).words(scene)
        yield Rival("aod_rad", "turned", text, (number,), poses(mirrored, scene, stand, kept))
        own, there = _seen_by_others(table, ties, number, kept)
        if not len(own):
            continue
        away = ties.seen.place[own] - stand.position[number]
        for turn in _turns(ties.seen, stand, number, own, there):
            text = Turn(number, turn, False).words(scene)
            seen = poses(table, scene, stand.turned(number, turn), kept)
            told = turn_allowed(turn, number, np.hypot(*away.T), scene)
            yield Rival("aod_rad", "turned", text, (number,), seen, told)
        for offset in _offsets(ties.seen, stand, number, own, there):
            error = RangeError("offset", (number,))
            text, told = error_words(error, offset, scene, agent), error_allowed(error, offset, scene, agent)
            length = np.maximum(table["distance_m"] - offset * (table["anchor"] == number), 0.0)
            seen = poses(table | {"distance_m": length}, scene, stand, kept)
            yield Rival("distance_m", "offset", text, (number,), seen, told)
        for shift in _shifts(ties.seen, own, there):
            x, y = stand.position[number] + shift
            where = f"anchor {scene.anchor_names[number]} stands near ({x:.1f}, {y:.1f})"
            text = f"{where}, not where the scene says"
            seen = poses(table, scene, stand.moved(number, shift), kept)
            yield Rival("anchor", "place", text, (number,), seen, shift_allowed(shift, number, scene))


def _compass(seen: OwnPoses) -> str | None:
    """What arrivals are, if so read the agent faces north or east all the time, whichever way it goes.

    Bearings clockwise from north are 90 degrees less the direction: a heading of 90 degrees is left.
    """
    rows = np.sort(np.concatenate(seen.sights))
    middle = np.exp(1j * seen.facing[rows]).mean() if len(rows) else 0.0
    if abs(middle) < ALWAYS or turning_rad(seen.place[rows], LEG_M) < STRAIGHT_RAD:
        return None
    for name, heading in (("north (compass bearings)", 0.5 * np.pi), ("east", 0.0)):
        if abs(wrap(np.angle(middle) - heading)) < NEAR_RAD:
            own = "the angle from the agent's heading, counter-clockwise, belongs"
            return f"directions in the world, counted clockwise from {name}, where {own}"
    return None


def _seen_by_others(
    table: Columns, ties: Ties, anchor: int, kept: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows (V,) of an anchor, and of the same steps rows (V,) by which others tell where the agent is."""
    own = kept[table["anchor"][kept] == anchor]
    others = np.concatenate([rows for number, rows in enumerate(ties.seen.sights) if number != anchor])
    one, other = np.nonzero(table["step"][own][:, None] == table["step"][others])
    return own[one], others[other]


def _turns(
    seen: OwnPoses, stand: Stand, anchor: int, own: NDArray[np.intp], there: NDArray[np.intp]
) -> list[float]:
    """Turns of an anchor that many of its rows vote for, each by where others put the agent."""
    away, asis = seen.place[there] - stand.position[anchor], seen.place[own] - stand.position[anchor]
    turn = wrap(np.arctan2(away[:, 1], away[:, 0]) - np.arctan2(asis[:, 1], asis[:, 0]))
    facing = wrap(seen.facing[there] - seen.facing[own] - turn)
    alike = np.abs(np.hypot(*away.T) - np.hypot(*asis.T)) < ALIKE_M
    alike &= ~(np.abs(facing) > ALIKE_RAD)  # without AoA nothing is against it
    turn = turn[alike & (np.abs(turn) >= LEAST_RAD)]
    near = np.abs(wrap(turn[:, None] - turn)) < TURN_BIN_RAD
    return [float(np.angle(np.exp(1j * turn[one]).mean())) for one in _elected(near)]


def _offsets(
    seen: OwnPoses, stand: Stand, anchor: int, own: NDArray[np.intp], there: NDArray[np.intp]
) -> list[float]:
    """By how much lengths of an anchor are too long, as many of its rows vote for by where others put it."""
    away, shift = seen.place[own] - stand.position[anchor], seen.place[there] - seen.place[own]
    level = np.maximum(np.hypot(*away.T), 1e-3)
    along = (away * shift).sum(1) / level
    across = (away[:, 0] * shift[:, 1] - away[:, 1] * shift[:, 0]) / level
    height = stand.height[anchor]
    offset = slant(level, height) - slant(np.maximum(level + along, 0.0), height)
    alike = ~(np.abs(wrap(seen.facing[there] - seen.facing[own])) > ALIKE_RAD) & (np.abs(across) < ALIKE_M)
    alike &= (np.abs(offset) >= LEAST_SHIFT_M) & (np.abs(offset) <= MOST_SHIFT_M)
    offset = offset[alike]
    near = np.abs(offset[:, None] - offset) < PLACE_BIN_M
    return [float(offset[one].mean()) for one in _elected(near)]


def _shifts(seen: OwnPoses, own: NDArray[np.intp], there: NDArray[np.intp]) -> list[Array]:
    """Ways (2,) by which an anchor is off that many of its rows vote for."""
    shift = seen.place[there] - seen.place[own]
    far = np.hypot(*shift.T)
    alike = ~(np.abs(wrap(seen.facing[there] - seen.facing[own])) > ALIKE_RAD)
    shift = shift[alike & (far >= LEAST_SHIFT_M) & (far <= MOST_SHIFT_M)]
    near = np.linalg.norm(shift[:, None] - shift, axis=-1) < PLACE_BIN_M
    return [shift[one].mean(0) for one in _elected(near)]


def _elected(near: NDArray[np.bool_]) -> Iterator[NDArray[np.bool_]]:
    """The largest groups of votes (V, V) that are near to one of them."""
    left = np.ones(len(near), dtype=bool)
    for _ in range(MOST_TRIED):
        count = (near & left).sum(1)
        if not left.any() or count.max() < VOTES:
            return
        group = near[count.argmax()] & left
        yield group
        left &= ~near[group].any(0)
