"""A step of several hypotheses: each is stepped in turn by its system, and weighed by its evidence.

docs/model.md, section 14. One hypothesis is stepped as if there were no others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace as changed
from functools import partial

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.streams import START_SEARCH
from gridslam.inference.health import reasons
from gridslam.inference.health.doubt import Doubt, places
from gridslam.inference.health.range_watch import RangeWatch
from gridslam.inference.management.branching import (
    LEAST_WIDTH_M,
    TOO_WIDE,
    WIDEST_M,
    branches_of,
    conditioned,
    linear_width,
    split,
    widest,
)
from gridslam.inference.management.challenge import (
    HANDICAP,
    challenged,
    on_trial,
    pose_likelihood,
    watched,
)
from gridslam.inference.management.free_turn import off_ring
from gridslam.inference.management.jolts import Step, stepped
from gridslam.inference.management.mixture import CAP, reduce, together
from gridslam.inference.management.poses.pose_fix import known_sources
from gridslam.inference.management.poses.pose_recovery import crowd, is_vague
from gridslam.inference.management.poses.pose_search import POSES_BY_MAP, Modes, find_modes
from gridslam.inference.management.sight_looks import crossed, distances_doubted, sighted
from gridslam.inference.management.start_search import PATIENCE, still_searching
from gridslam.inference.management.step_info import StepInfo, comparable
from gridslam.inference.management.unknown_gain import with_likeliest_gain
from gridslam.inference.messages.anchor_frames import as_believed
from gridslam.inference.messages.motion import predict
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.scans.deviations import own_deviations
from gridslam.inference.state.population import NONE, Population
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.scan import Scan

Start = Callable[[FilterModel], State]
PARTICLES = 512
"""Drawn for each of several hypotheses, at most: particles hardly matter, and one by one they cost time."""
LOOK_EVERY, LOOK_OFTEN = 3, 30
"""Steps from one look at whether lines of sight cross to the next: what they tell is the same at all; and the
first ones, all of which are looked at: what is wrong is to be named before much is mapped."""


def begun(state: State, model: FilterModel) -> Population[State]:
    """The hypotheses before the first step: one; where its pose is vague, it is searched for at first."""
    searching = (
        tells_poses(model)
        and not len(state.surfaces)
        and is_vague(state.belief, "aoa" in model.radio.measures)
    )
    return Population.of(state, searching=searching)


def tells_poses(model: FilterModel) -> bool:
    """Whether the radio measures what poses, or places at least, can be told by."""
    return "distance" in model.radio.measures and bool({"aod", "aoa"} & set(model.radio.measures))


def advance_population(
    population: Population[State], scan: Scan, model: FilterModel, work: Workspace, start: Start, step: Step
) -> tuple[Population[State], StepInfo]:
    """One step of all hypotheses.

    Parameters
    ----------
    start, step : callable
        The system's: its state before the first step, and a step of one state.

    Returns
    -------
    (population, info)
        info: of the likeliest hypothesis, with the health of all.
    """
    ranges = _ranges(population, scan, model, work)
    believed = as_believed(model, population.best)
    population, info = _advanced(population, scan, believed, work, start, step)
    population = _sighted(population, scan, as_believed(model, population.best), work)
    info = distances_doubted(info, population, ranges, model)
    best = population.best
    best = replace(best, monitor=best.monitor.judged(info.health.ok))
    return changed(population, states=(best, *population.states[1:]), ranges=ranges), info


def _sighted(
    population: Population[State], scan: Scan, model: FilterModel, work: Workspace
) -> Population[State]:
    """The population with what lines of sight say of their anchors, and turns that they tell beyond doubt."""
    state = population.best
    if state.monitor.distrusted:
        return population if population.sights is None else changed(population, sights=None)
    known = len(population) == 1 and not population.searching
    looks = (state.step - 1) % LOOK_EVERY == 0  # at the scans that crossings are looked for in
    if not (known and looks and model.radio.departs and len(scan)):
        return population
    scans = work.once(split_by_anchor, scan, model)
    return sighted(population, scans, work.once(own_deviations, scans, model.radio), model)


def _ranges(population: Population[State], scan: Scan, model: FilterModel, work: Workspace) -> RangeWatch:
    """What lines of sight that cross say of the distances, whoever follows them."""
    if population.ranges and population.best.step >= LOOK_OFTEN and population.best.step % LOOK_EVERY:
        return population.ranges
    scans = work.once(split_by_anchor, scan, model)
    return crossed(population, scans, work.once(own_deviations, scans, model.radio), model)


def _advanced(
    population: Population[State], scan: Scan, model: FilterModel, work: Workspace, start: Start, step: Step
) -> tuple[Population[State], StepInfo]:
    """One step of all hypotheses, as `advance_population` but for its look at the distances."""
    if population.searching:
        modes, prior = _search(population, scan, model, work)
        waited = population.waited + (len(scan) > 0)
        if modes is None or not (modes.complete or waited >= PATIENCE):
            return still_searching(population, prior, len(scan) > 0, model, work)
        population = _started(replace(population.best, belief=prior.belief), modes, model)
    if population.watch.doubtful:
        population = challenged(population, scan, start(model), model, work)
    work.recovers = True
    population = _listed(population, scan, model, work)
    population = _split(population, scan, model)
    return _stepped(population, scan, model, work, step)


def _search(
    population: Population[State], scan: Scan, model: FilterModel, work: Workspace
) -> tuple[Modes | None, State]:
    """All poses that explain a scan, if anything was heard, and the prior at its time."""
    work.begin()
    prior = predict(population.best, scan.time_s, len(scan), model)
    if not len(scan):
        return None, prior
    scans = work.once(split_by_anchor, scan, model)
    stream = [work.seed, prior.step, START_SEARCH]
    return find_modes(pose_likelihood(scans, prior, model), prior.belief, model.grid, CAP, stream), prior


def _started(state: State, modes: Modes, model: FilterModel) -> Population[State]:
    """A population of the modes that were listed."""
    states = branches_of(state, modes, float(model.start_variance[2]))
    turnable = model.senders == 1 and not model.radio.departs
    watch = Doubt(unproven=not modes.complete, turnable=turnable)
    return Population.of(state).having(states, modes.log_prior, since=0, watch=watch)


def _listed(
    population: Population[State], scan: Scan, model: FilterModel, work: Workspace
) -> Population[State]:
    """The population with poses listed by scan and map, if there is one hypothesis and its pose is vague.

    The vague belief stays beside them, at even odds, and is followed as it is.
    """
    belief = off_ring(population.best, model)
    if len(population) > 1 or not is_vague(belief, arrives=True) or not tells_poses(model):
        return population
    scans = work.once(split_by_anchor, scan, model)
    if not is_vague(belief, scans.arrives):
        return population
    if crowd(scans):  # so much clutter looks like new walls from anywhere; known ones alone tell more
        return population
    work.recovers = False
    if not len(scan):
        return population
    state = population.best
    prior = predict(state, scan.time_s, len(scan), model)
    known = known_sources(prior, model, work=work)
    stream = [work.seed, state.step, START_SEARCH]
    likelihood = pose_likelihood(scans, prior, model, known)
    modes = find_modes(likelihood, prior.belief, model.grid, CAP - 1, stream, POSES_BY_MAP)
    if not modes.complete:
        return population
    states = [
        replace(conditioned(prior, pose, covariance), time_s=None, surfaces=state.surfaces,
                calibration=state.calibration, monitor=state.monitor)
        for pose, covariance in zip(modes.pose, modes.covariance, strict=True)
    ]  # fmt: skip
    half = -float(np.log(2))
    log = np.append(modes.log_prior - np.logaddexp.reduce(modes.log_prior) + half, half)
    return population.having((*states, state), log, guard=len(states), since=0)


def _split(population: Population[State], scan: Scan, model: FilterModel) -> Population[State]:
    """The population with hypotheses split whose position is too wide to linearise what is heard about it."""
    narrow = TOO_WIDE * LEAST_WIDTH_M
    if not len(scan) or all(widest(state.belief) <= narrow for state in population.states):
        return population
    spread = [widest(off_ring(state, model)) for state in population.states]  # never wider
    if max(spread) <= narrow:
        return population
    width = linear_width(split_by_anchor(scan, model), model.radio)
    wide = [TOO_WIDE * width < s <= WIDEST_M and k != population.guard for k, s in enumerate(spread)]
    if not any(wide):
        return population
    room = (CAP - (len(population) - sum(wide)) - 1) // sum(wide)
    states, logs, guard = list[State](), list[float](), population.guard
    for k, (state, log, chosen) in enumerate(
        zip(population.states, population.log_weight, wide, strict=True)
    ):
        guard = len(states) if k == population.guard else guard
        parts: Sequence[tuple[Belief, float]] = split(state.belief, width, room) if chosen else []
        if len(parts) < 2:
            states.append(state)
            logs.append(log)
            continue
        states += [state.believing(part) for part, _ in parts]
        logs += [log + float(np.log(share)) for _, share in parts]
    if len(population) == 1 and len(states) > 1:  # the parent stays beside its parts, at even odds
        logs = [log - float(np.log(2)) for log in logs]
        states, logs, guard = [*states, population.best], [*logs, -float(np.log(2))], len(states)
    return population.having(states, logs, guard, since=0)


def _stepped(
    population: Population[State], scan: Scan, model: FilterModel, work: Workspace, step: Step
) -> tuple[Population[State], StepInfo]:
    """All hypotheses a step on, weighed by their evidence, the same ones merged and unlikely ones pruned."""
    since = population.since + 1
    after, infos = each_stepped(population, scan, model, work, step)
    if len(population) == 1:
        before, state, info = population.best, after[0], infos[0]
        population = changed(population, states=(state,), since=since, guard=NONE)
        if info.found_again:
            population = _doubted(population, info, before, scan, model, work, step)
        population = watched(population, lambda: comparable(info, state, model), scan, model, work)
        return population, _judged(population, info, model)
    evidence = [comparable(i, s, model) for i, s in zip(infos, after, strict=True)]
    log = np.array(population.log_weight) + evidence
    if population.watch.against():
        log = on_trial(log, after)
    likeliest = int(np.argmax(log))
    population = population.having(after, log, population.guard, since=since)
    population = watched(reduce(population, model), lambda: evidence[likeliest], scan, model, work)
    return population, _judged(population, infos[likeliest], model)


def each_stepped(
    population: Population[State], scan: Scan, model: FilterModel, work: Workspace, step: Step
) -> tuple[list[State], list[StepInfo]]:
    """Each hypothesis a step on, by itself: what comes of one doesn't depend on the others.

    But that all have the likeliest one's calibration, and that several draw fewer particles each than one.
    """
    step = partial(with_likeliest_gain, step=step)
    if len(population) == 1:
        work.particles.limit = None
        state, info = stepped(population.best, scan, model, work, step)
        return [state], [info]
    work.particles.limit = PARTICLES
    calibration, after, infos = population.best.calibration, list[State](), list[StepInfo]()
    for number, state in enumerate(population.states):
        work.recovers = number != population.guard
        state, info = stepped(replace(state, calibration=calibration), scan, model, work, step)
        after.append(state)
        infos.append(info)
    return after, infos


def _doubted(
    population: Population[State], info: StepInfo, before: State, scan: Scan, model: FilterModel,
    work: Workspace, step: Step,
) -> Population[State]:  # fmt: skip
    """One hypothesis that has jumped to where the map says it is, and beside it one that has not."""
    work.recovers = False
    there, (here, other) = population.best, step(before, scan, model, work)
    log = [comparable(info, there, model) - HANDICAP, comparable(other, here, model)]
    return reduce(population.having((there, here), log, guard=1, since=0), model)


def _judged(population: Population[State], info: StepInfo, model: FilterModel) -> StepInfo:
    """What happened at a step, with what there is to say of all hypotheses."""
    found = [info.health.why] if info.health.why else []
    several = places(
        population.log_weight, lambda rows: together([population.states[k].belief for k in rows])
    )
    if several > 1:
        found.append(reasons.several_places(several))
    found += population.watch.reasons()
    if not model.grid.holds(population.best.belief.mean[:2]):
        found.append(reasons.OFF_GRID)
    why = "; ".join(found)
    return info if why == info.health.why else replace(info, health=replace(info.health, ok=False, why=why))
