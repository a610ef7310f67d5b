"""Cures that concern several columns or anchors (names, turns, offsets, heights), and which one wins."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from gridslam.checks.anchors.forgotten_heights import forgotten_heights
from gridslam.checks.anchors.range_fit import RangeFit, fits, without_twins
from gridslam.checks.anchors.turned_anchors import (
    Turn,
    beyond_told,
    by_chance,
    names_words,
    nearly,
    turned_sights,
    words,
)
from gridslam.checks.scene.allowed_for import error_allowed
from gridslam.checks.scene.range_errors import LEAST_HEIGHT_M, LEAST_RISE_M, RangeError
from gridslam.checks.scene.range_words import error_words
from gridslam.checks.sights.fit import least_share, settled
from gridslam.checks.sights.line_of_sight_filter import CROWD, Sight, explain
from gridslam.checks.tables.unit_hypotheses import ANGLES, Suspicion, finite
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

EXPLAINED = 0.85
"""Share of scans with a line of sight above which a column isn't questioned further."""
CERTAIN, PROBABLE, CLEAR = 30.0, 15.0, 5.0
"""Log likelihood ratios in nats, over the table as it stands and over a rival, that a cure must reach;
an error in the distances is told as probable from `PROBABLE` on."""
ALIKE = 0.95
"""Share of what a cure explains from which on another one explains as much."""
MOST_BEHIND = 60.0
"""Log likelihood ratio in nats up to which an offset is told of behind another reading."""
FAIR_CROWD = 16
"""Times as many particles as usual that an offset alone is judged by: with fewer, luck is worth 30 nats."""
MOST_MISFIT = 4.0
"""Misfit per degree of freedom above which even the best error in the distances explains nothing."""
MOST_MISFIT_HEIGHT = 6.0
"""Such a misfit of a height of all anchors, beside which others explain as much: one of several causes."""
STRAIGHT_RAD = np.radians(30)
"""Change of course below which a way is straight."""
MOST_PERMUTED = 4
"""Anchors up to which all orders of their names are tried, not only exchanges of two."""


@dataclass(frozen=True)
class Cure:
    """A way to read the table that fits.

    Attributes
    ----------
    suspicion : Suspicion or None
        None of what the scene allows for, see `gridslam.checks.scene.allowed_for`.
    table : dict of (K,) arrays
        As it should have been.
    sight : Sight
        What the line of sight explains then.
    """

    suspicion: Suspicion | None
    table: Columns
    sight: Sight


def range_errors(scene: Scene) -> list[RangeError]:
    """Offsets and heights of all anchors at once and of each of them; the agent's, where heights tell it."""
    every = tuple(range(len(scene.anchors)))
    groups = [every, *((number,) for number in every if len(every) > 1)]
    errors = [RangeError(kind, group) for group in groups for kind in ("offset", "slant")]
    # of anchors that are all as high it is the same as their own height
    told = scene.has_heights and np.ptp(scene.heights(None)) > LEAST_RISE_M
    errors += [RangeError("rise", every)] if told else []
    high = scene.has_heights and np.abs(scene.heights(None)).max() >= LEAST_HEIGHT_M
    return [*errors, RangeError("plan", every)] if high else errors


def whole_cure(table: Columns, scene: Scene, agent: str | None, sofar: Sight, plain: Sight) -> Cure | None:
    """The best cure by names or distances of a table whose lines of sight don't fit.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    sofar, plain : Sight
        What is explained with the columns read in the best other way, and as they stand.

    Returns
    -------
    Cure or None
        None if none of them makes the table fit, clearly better than reading its columns otherwise does.
    """
    needed = max(sofar.evidence + CLEAR, plain.evidence + CERTAIN, CERTAIN)
    best: Cure | None = None
    for order in orders(len(scene.anchors)):
        renamed = table | {"anchor": np.array(order)[table["anchor"]]}
        sight = explain(renamed, scene, agent)
        if sight.explained >= least_share(scene) and sight.evidence > needed:
            needed = sight.evidence + CLEAR
            best = Cure(_names(order, scene, sight, plain, _angles(table)), renamed, sight)
    # directions in the world are turns, too, each by the anchor's orientation: the simpler cure comes first
    turned = turn_cure(table, scene, agent, plain, needed + CERTAIN)
    if turned is not None:
        best, needed = turned, turned.sight.evidence + CLEAR
    if not both_measured(table):
        return best
    # finds the lines of sight alone: the particles may miss the right error, least squares name it afterwards
    seen = [explain(table, scene, agent, error=error) for error in range_errors(scene)]
    top = max(seen, key=lambda sight: sight.evidence)
    if top.evidence <= max(needed, explain(table, scene, agent, crowd=CROWD).evidence + CERTAIN):
        return best  # more particles find more by themselves
    if top.explained < least_share(scene):  # walls may hide anchors from some particles, but not from others
        error = range_errors(scene)[seen.index(top)]
        top = settled(table, scene, agent, error=error)
        if top.explained < least_share(scene):
            return best
    return range_cure(table, scene, agent, top) or best


def fitting_cure(table: Columns, scene: Scene, agent: str | None, sight: Sight) -> Cure | None:
    """The cure of a table whose lines of sight fit, though they could better: by distances or turns.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    sight : Sight
        What is explained as it stands.
    """
    return range_cure(table, scene, agent, sight) or turn_cure(table, scene, agent, sight, 0.0)


def turn_cure(table: Columns, scene: Scene, agent: str | None, plain: Sight, needed: float) -> Cure | None:
    """Anchors that stand otherwise than the scene says, if that explains clearly more.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    plain : Sight
        What is explained as the table stands.
    needed : float
        Log evidence that must be reached.
    """
    found = [one for one in turned_sights(table, scene, agent) if one[0].explained >= least_share(scene)]
    if not found:
        return None
    top = max(sight.evidence for sight, _, _ in found)
    alike = [one for one in found if one[0].evidence > top - CERTAIN]
    told = [one for one in alike if not beyond_told(one[1], one[0], table, scene)]
    alike = told or alike  # what the scene allows for comes first
    fewest = min(len(turns) for _, turns, _ in alike)
    ways = dict[tuple, tuple[Sight, tuple[Turn, ...], Columns]]()
    for one in (one for one in alike if len(one[1]) == fewest):
        key = tuple((turn.anchor, turn.mirrored) for turn in one[1])
        if key not in ways or (one[0].evidence > ways[key][0].evidence and nearly(one[1], ways[key][1])):
            ways[key] = one
    (sight, turns, read), *others = sorted(ways.values(), key=lambda one: -one[0].evidence)
    gain = sight.evidence - plain.evidence
    if gain < CERTAIN or sight.evidence < needed or by_chance(turns, plain, sight, scene):
        return None
    if told:
        return Cure(None, read, sight)
    each = [beyond_told(way, one, table, scene) for one, way, _ in ((sight, turns, read), *others)]
    text = "; or ".join(words(one, scene) for one in each)
    reason = (
        f"line of sight in {sight.explained:.0%} of {sight.judged}, {plain.explained:.0%} as it stands; "
        f"log likelihood ratio {gain:.0f}"
    )
    return Cure(Suspicion("aod_rad", "turned", text, not others, reason), read, sight)


@dataclass(frozen=True)
class _Ranked:
    """Which error in the distances leaves least, and what leaves about as little.

    Attributes
    ----------
    plain, best : RangeFit
        No error, and the likeliest one.
    alike : list of RangeFit
        Others that explain as much.
    common : bool
        Whether the likeliest is a height of all anchors, told though several others explain as much.
    """

    plain: RangeFit
    best: RangeFit
    alike: list[RangeFit]
    common: bool

    @classmethod
    def of(cls, found: list[RangeFit], scene: Scene) -> _Ranked:
        """Of what `fits` finds, no error first."""
        plain, ranked = found[0], sorted(without_twins(found[1:]), key=lambda fit: fit.misfit)
        best, alike = ranked[0], [fit for fit in ranked[1:] if ranked[0].gain(fit) < CLEAR]
        common = None if _named_beside(best, alike) else _common_height([best, *alike], plain, scene)
        if common is None:
            return cls(plain, best, alike, False)
        return cls(plain, common, [fit for fit in (best, *alike) if fit is not common], True)

    @property
    def explains(self) -> bool:
        """Whether the likeliest leaves little enough, and few enough others explain as much to be named."""
        most = MOST_MISFIT_HEIGHT if self.common else MOST_MISFIT
        named = self.common or _named_beside(self.best, self.alike)
        return self.best.misfit <= most * self.best.count and named

    def words(self, error: RangeError, scene: Scene, agent: str | None) -> str:
        """What is said of the likeliest error, and of others that explain as much."""
        text = error_words(error, self.best.size_m, scene, agent)
        for fit in self.alike:
            assert fit.error is not None
            other = error_words(fit.error, fit.size_m, scene, agent)
            text += f"; or {other}: too few anchors at once to tell which"
        return text


def range_cure(table: Columns, scene: Scene, agent: str | None, sight: Sight) -> Cure | None:
    """The error in the distances that the lines of sight found so far ask for, if one does clearly.

    Lines of sight may fit in spite of it: the agent is then thought to be elsewhere.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    sight : Sight
        The lines of sight that were found, whatever their distances.
    """
    found = fits(table, sight, scene, range_errors(scene), agent) if both_measured(table) else []
    if not found:
        return None
    ranked = _Ranked.of(found, scene)
    plain, best, error = ranked.plain, ranked.best, ranked.best.error
    if error is None or abs(best.size_m) < error.least_m or best.gain(plain) < PROBABLE:
        return None
    heights = forgotten_heights(table, scene, sight, best)
    if heights is not None:
        suspicion, level = heights
        return Cure(suspicion, level, settled(level, scene, agent))
    if not ranked.explains:
        return None
    whole = _without(error, best.size_m, table, scene, agent)
    after, before = settled(whole, scene, agent), settled(table, scene, agent)
    if after.explained < least_share(scene) or after.evidence < before.evidence + CLEAR:
        return None
    far = sight.distance_m[np.isin(table["anchor"][sight.row], error.anchors)]
    if error_allowed(error, best.size_m, scene, agent, float(np.median(far)) if len(far) else np.inf):
        return Cure(None, whole, after)
    reason = (
        f"line of sight in {after.explained:.0%} of {after.judged}, {before.explained:.0%} as it "
        f"stands; misfit of these {plain.misfit / max(best.misfit, 1e-9):.1f} times as large without it; "
        f"log likelihood ratio {best.gain(plain):.0f}"
    )
    sure = not ranked.alike and best.gain(plain) >= CERTAIN
    text = ranked.words(error, scene, agent)
    return Cure(Suspicion("distance_m", error.kind, text, sure, reason), whole, after)


def _without(error: RangeError, size_m: float, table: Columns, scene: Scene, agent: str | None) -> Columns:
    """The table as it would have been without an error in its distances."""
    distance, spoilt = table["distance_m"], np.isin(table["anchor"], error.anchors)
    with np.errstate(invalid="ignore"):
        cured = error.cured(distance, size_m, scene.heights(agent)[table["anchor"]])
    return table | {"distance_m": np.where(spoilt, cured, distance)}


def _common_height(alike: list[RangeFit], plain: RangeFit, scene: Scene) -> RangeFit | None:
    """The height of all anchors among what explains about as much, if the scene has none and it is sure."""
    for fit in alike if not scene.has_heights else ():
        error = fit.error
        if error is not None and error.kind == "slant" and len(error.anchors) == len(scene.anchors):
            return fit if fit.size_m >= error.least_m and fit.gain(plain) >= CERTAIN else None
    return None


def _named_beside(best: RangeFit, alike: list[RangeFit]) -> bool:
    """Whether what fits as well as the best is nothing, or the other kind of error of the same anchors."""
    if not alike:
        return True
    same = best.error, alike[0].error
    return (
        len(alike) == 1
        and same[0] is not None
        and same[1] is not None
        and same[0].anchors == same[1].anchors
        and abs(alike[0].size_m) >= same[1].least_m
    )


def both_measured(table: Columns) -> bool:
    """Whether there are distances, and angles to tell their errors from another place of the agent.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    """
    return bool(len(finite(table, "distance_m"))) and _angles(table)


def _angles(table: Columns) -> bool:
    return any(len(finite(table, name)) for name in ANGLES)


def orders(count: int) -> Iterator[tuple[int, ...]]:
    """Orders of the anchors other than their own, first where fewest move; of many, with two exchanged."""
    own = tuple(range(count))
    if count <= MOST_PERMUTED:
        yield from sorted(permutations(own), key=lambda order: sum(a != b for a, b in enumerate(order)))[1:]
        return
    for one, other in combinations(own, 2):
        order = list(own)
        order[one], order[other] = other, one
        yield tuple(order)


def _names(order: tuple[int, ...], scene: Scene, sight: Sight, plain: Sight, told: bool) -> Suspicion:
    """Names that are exchanged: certain only if angles beside distances tell where the agent is."""
    reason = (
        f"line of sight in {sight.explained:.0%} of {sight.judged}, {plain.explained:.0%} as it stands; "
        f"log likelihood ratio {sight.evidence - plain.evidence:.0f}"
    )
    gain = sight.evidence - plain.evidence
    reason += "" if told else "; distances alone don't tell it for certain"
    return Suspicion("anchor", "names", names_words(order, scene), told and gain > CERTAIN, reason)
