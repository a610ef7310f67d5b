"""What looks wrong with a table against the scene: every cure there is, and the one that explains most."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gridslam.checks.anchors.misplaced import with_places
from gridslam.checks.anchors.offsets import offset_alone, offset_beside
from gridslam.checks.anchors.rivals import (
    ALIKE,
    CERTAIN,
    EXPLAINED,
    MOST_BEHIND,
    Cure,
    both_measured,
    fitting_cure,
    whole_cure,
)
from gridslam.checks.columns import elevations, time_units
from gridslam.checks.columns.gain_jumps import gain_jump
from gridslam.checks.columns.loudness import loudness
from gridslam.checks.sights.fit import least_share, tells_place
from gridslam.checks.sights.handovers import Ties
from gridslam.checks.sights.line_of_sight_filter import Sight, explain
from gridslam.checks.starts.followed import followed, upheld
from gridslam.checks.starts.start_search import (
    ELSEWHERE,
    MANY_STARTS,
    RIVAL,
    goes_ahead,
    one_in_sight,
    other_start,
)
from gridslam.checks.starts.still_headings import with_frame
from gridslam.checks.tables.unit_hypotheses import ANGLES, Suspicion, finite, told_after
from gridslam.checks.verdicts import by_handovers
from gridslam.checks.verdicts.column_readings import likeliest_way, rival_of_start
from gridslam.checks.verdicts.reflections_instead import (
    are_faint_and_hidden,
    takes_reflections,
    through_walls,
)
from gridslam.checks.verdicts.second_device import second_device
from gridslam.world.columns import VALUES, Columns
from gridslam.world.scene import Scene

AHEAD = 0.7
"""Cosine between course and heading from which on an agent moves ahead, or backwards if negative."""


@dataclass(frozen=True, eq=False)
class Account:
    """What a table is taken for.

    Attributes
    ----------
    found : list of Suspicion
        What is wrong with it; empty: nothing.
    read : dict of (K,) arrays
        With its columns read as the suspicions say.
    cured : dict of (K,) arrays
        The same without errors of distances and turns of anchors, those that the scene allows for included.
    sight : Sight
        What is explained then.
    """

    found: list[Suspicion]
    read: Columns
    cured: Columns
    sight: Sight

    @classmethod
    def of(cls, found: list[Suspicion], read: Columns, sight: Sight) -> Account:
        """Without errors beside how its columns are read."""
        return cls(found, read, read, sight)

    @property
    def kinds(self) -> set[str]:
        """Kinds of what is wrong."""
        return {item.kind for item in self.found}


@dataclass(frozen=True, eq=False)
class Case:
    """A table that is held against a scene.

    Attributes
    ----------
    asis : dict of (K,) arrays
        As it stands, in the order of steps.
    scene : Scene
    agent : str or None
        Whose it is.
    plain : Sight
        What is explained straight on from the told start.
    """

    asis: Columns
    scene: Scene
    agent: str | None
    plain: Sight

    def nothing_wrong(self) -> Account:
        """The table as it stands, the agent followed again."""
        return Account.of([], self.asis, followed(self.asis, self.scene, self.agent, self.plain))

    def unless_refuted(self, account: Account) -> Account:
        """The account, if neither what anchors tell by themselves nor what comes first speaks against it."""
        asis, scene, agent = self.asis, self.scene, self.agent
        refuted = bool(account.found) and (
            by_handovers.refuted(account.found, asis, scene, agent)
            or takes_reflections(asis, self.nothing_wrong().sight, account.sight)
            or through_walls(asis, account.sight, scene)
        )
        return self.nothing_wrong() if refuted else account


def against_scene(table: Columns, scene: Scene, agent: str | None, known: set[str]) -> list[Suspicion]:
    """What the lines of sight to the scene's anchors show of a table.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    scene : Scene
    agent : str or None
        Whose it is.
    known : set of str
        Columns of which something is known to be wrong already.
    """
    order = np.argsort(table["step"], kind="stable")
    asis = {name: values[order] for name, values in table.items()}
    if not any(len(finite(asis, name)) for name in VALUES if name != "amplitude"):
        return []
    case = Case(asis, scene, agent, explain(asis, scene, agent))
    account = case.unless_refuted(_best_cure(case))
    account = _with_finer_errors(case, account)
    account = case.unless_refuted(_with_offset_or_places(case, account))
    named = by_handovers.named(account.found, asis, scene, agent)
    account = replace(account, found=with_frame(named, account.read, account.sight, scene))
    ties = Ties.of(asis, scene, agent) if scene.walls else None
    if are_faint_and_hidden(account.found, asis, account.sight, scene, agent, ties):
        account = case.nothing_wrong()
    account = replace(account, found=[*account.found, *_by_times_and_elevations(case, account, ties)])
    found = account.found + ([] if "amplitude" in known else _by_amplitudes(case, account))
    if not found and account.sight.explained >= least_share(scene):
        return second_device(asis, scene, agent, account.sight)
    return found


def _best_cure(case: Case) -> Account:
    """The cure that explains most, unless the agent had only got lost in the table as it stands."""
    asis, scene, agent, plain = case.asis, case.scene, case.agent, case.plain
    best = _best_reading(case)
    if plain.explained < EXPLAINED and both_measured(asis):
        # half a turn of the heading is the same as arrivals read backwards: evidence can't decide
        behind = MOST_BEHIND if best.kinds == {"backwards"} else RIVAL
        elsewhere = other_start(asis, scene, agent, plain, best.sight, behind)
        best = best if elsewhere is None else _with_start(case, best, elsewhere)
    if best.kinds & ELSEWHERE or not (best.found or plain.explained < EXPLAINED):
        return best
    held = upheld(asis, best.read, best.found, scene, agent, plain)
    return best if held is None else Account.of([], asis, held)


def _best_reading(case: Case) -> Account:
    """Columns read otherwise; or names, turns or distances, if these explain more where little fits."""
    asis, scene, agent, plain = case.asis, case.scene, case.agent, case.plain
    way = likeliest_way(asis, scene, agent, plain)
    best = Account.of(way.suspicions(asis, scene, agent), way.table, way.sight)
    if plain.explained >= EXPLAINED:
        return best
    if not best.found:
        best = Account.of([], asis, plain)
    cure = whole_cure(asis, scene, agent, best.sight, plain)
    return best if cure is None else Account.of(_told(cure), cure.table, cure.sight)


def _told(cure: Cure) -> list[Suspicion]:
    """What is said of a cure: nothing, if the scene allows for it."""
    return [] if cure.suspicion is None else [cure.suspicion]


def _with_finer_errors(case: Case, account: Account) -> Account:
    """Errors of distances or turns of anchors of a table that fits all the same, or else another start."""
    scene, sight = case.scene, account.sight
    fits = sight.explained >= (EXPLAINED if scene.walls else least_share(scene))
    spoilt = {"distance_m", "anchor"} & {item.column for item in account.found}
    if not fits or account.kinds & ELSEWHERE or spoilt:
        return account
    cure = _finer_cure(case, account)
    if cure is not None:
        found = [*account.found, *(_doubted(item, sight) for item in _told(cure))]
        return replace(account, found=found, cured=cure.table, sight=cure.sight)
    if account.found or not both_measured(case.asis):
        return account
    # from a wrong heading the right one is found, some steps later
    return replace(_start_or_column(case, sight), cured=account.cured)


def _finer_cure(case: Case, account: Account) -> Cure | None:
    """A cure by distances or turns; of turns only what following the agent again doesn't explain as well."""
    scene, agent, sight = case.scene, case.agent, account.sight
    cure = fitting_cure(account.read, scene, agent, sight)
    if cure is None and not account.found and one_in_sight(sight) and both_measured(case.asis):
        cure = offset_alone(case.asis, scene, agent, sight)
    if cure is None or cure.suspicion is None or cure.suspicion.kind != "turned":
        return cure
    held = upheld(account.read, cure.table, [cure.suspicion], scene, agent, sight, CERTAIN)
    return cure if held is None else None


def _with_offset_or_places(case: Case, account: Account) -> Account:
    """An offset of all distances beside what is wrong, and anchors elsewhere beside it or instead."""
    asis, scene, agent = case.asis, case.scene, case.agent
    found = offset_beside(account.found, asis, account.read, scene, agent, account.sight)
    return replace(account, found=with_places(found, asis, scene, agent, account.cured))


def _by_times_and_elevations(case: Case, account: Account, ties: Ties | None) -> list[Suspicion]:
    """What lines of sight show of times, and of elevations."""
    asis, sight = case.asis, account.sight
    step_m = np.inf if case.agent is None else case.scene.agent(case.agent).step_m
    times = time_units.slow_times(asis, sight, ties, step_m) + time_units.fast_times(asis, sight)
    return times + elevations.suspicions(account.read | asis, sight, case.scene, case.agent)


def _by_amplitudes(case: Case, account: Account) -> list[Suspicion]:
    """What lines of sight show of amplitudes, if enough of them are known to be lines of sight."""
    asis, scene, sight = case.asis, case.scene, account.sight
    measured = len(finite(asis, "distance_m")) and len(finite(asis, "amplitude"))
    # what isn't a line of sight tells nothing of the level, and where little fits it is none
    lost = "start" in account.kinds and one_in_sight(sight)
    if not measured or sight.explained < least_share(scene) or lost:
        return []
    angles = any(len(finite(asis, name)) for name in ANGLES)
    if angles and not account.found and (jumped := gain_jump(asis, scene, case.agent)):
        return jumped
    placed = angles and (bool(scene.walls) or tells_place(asis))
    loud = loudness(asis["amplitude"], sight, scene, placed)
    if "slant" not in account.kinds:
        return loud
    # where the scene lacks heights, amplitudes go by the length that is measured
    ways = replace(sight, distance_m=asis["distance_m"][sight.row])
    others = {item.kind for item in loudness(asis["amplitude"], ways, scene, placed)}
    return [item for item in loud if item.kind in others]


def _doubted(suspicion: Suspicion, sight: Sight) -> Suspicion:
    """The suspicion of a turned anchor, as far as one anchor in sight tells it from other errors."""
    if suspicion.kind != "turned" or not one_in_sight(sight):
        return suspicion
    note = "one anchor in sight can't tell it from another start, or from an error in its distances"
    return replace(suspicion, certain=False, reason=f"{suspicion.reason}; {note}")


def _start_or_column(case: Case, plain: Sight) -> Account:
    """A column read otherwise that fits from the told start, another start, or both.

    Nothing if the table fits no better from elsewhere.

    Behind a wall the way's image, with arrivals counted the other way around, fits as well as the way itself.
    """
    asis, scene, agent = case.asis, case.scene, case.agent
    right = Account.of([], asis, plain)
    elsewhere = other_start(asis, scene, agent, plain, plain)
    if elsewhere is None:
        return right
    if elsewhere[0] is None or elsewhere[0].kind != "start":
        return _with_start(case, right, elsewhere)
    way = rival_of_start(asis, scene, agent, plain)
    found = way.suspicions(asis, scene, agent)
    if not found:
        return _with_start(case, right, elsewhere)
    # as many particles as begin anywhere, to be fair
    fair = explain(way.table, scene, agent, way.in_world, crowd=MANY_STARTS)
    start, sight = other_start(asis, scene, agent, plain, fair) or (None, fair)
    if start is None:
        return Account.of(found, way.table, way.sight)
    if fair.explained < ALIKE * sight.explained:
        return _with_start(case, right, (start, sight))
    both = [*(replace(item, certain=False) for item in found), told_after(start, found)]
    return Account.of([replace(item, certain=False) for item in both], way.table, way.sight)


def _with_start(case: Case, account: Account, elsewhere: tuple[Suspicion | None, Sight]) -> Account:
    """A start that explains as much as another cure, or more: beside it, or instead.

    A heading that is wrong by half a turn and arrivals read backwards are the same to every line of sight; an
    agent that moves ahead tells them apart.
    """
    start, other = elsewhere
    if start is None:
        return Account.of([], case.asis, other)
    instead = Account.of([start], case.asis, other)
    ahead = goes_ahead(other)
    if account.kinds == {"backwards"} and abs(ahead) > AHEAD:
        return instead if ahead > 0 else account
    if one_in_sight(other):
        note = f"{start.reason}; one anchor in sight can't tell it from an error in what that anchor measures"
        start = replace(start, certain=False, reason=note)
    if not account.found or start.certain:
        return replace(instead, found=[start])
    beside = [*(replace(item, certain=False) for item in account.found), told_after(start, account.found)]
    return replace(account, found=beside)
