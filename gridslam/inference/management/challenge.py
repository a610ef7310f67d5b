"""Challengers: what a fresh start makes of the latest scan, against what the present hypotheses make of it.

docs/model.md, section 14. What is concluded of the comparison is `gridslam.inference.health.doubt`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import OF_POSE, POSE
from gridslam.inference.beliefs.streams import CHALLENGE, LEAD
from gridslam.inference.health.doubt import ONE_ALONE, Doubt
from gridslam.inference.health.monitor import SILENT, SWAMPED
from gridslam.inference.management.branching import branches_of
from gridslam.inference.management.free_turn import ANY
from gridslam.inference.management.mixture import together
from gridslam.inference.management.poses.one_mirror import added_by_mirror, shown_by_mirror
from gridslam.inference.management.poses.pose_fix import Sources, known_sources
from gridslam.inference.management.poses.pose_recovery import crowd, freed, leap
from gridslam.inference.management.poses.pose_score import PoseLikelihood
from gridslam.inference.management.poses.pose_search import (
    POSES_BY_MAP,
    Modes,
    find_modes,
    line_of_sight_poses,
    near,
)
from gridslam.inference.management.sole_sight import for_sights
from gridslam.inference.messages.motion import predict_agent
from gridslam.inference.scans.anchor_measurements import AnchorScan, SplitScan, split_by_anchor
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel, fixed
from gridslam.world.geometry import wrap
from gridslam.world.scan import Scan

EVERY = 10
"""Steps from one comparison to the next."""
HANDICAP, CHALLENGERS, POSES, LISTED = 7.0, 3, 60_000, 20
"""Log weight of challengers below the best, how many, uniform poses scored for them, modes listed at most."""
ROUNDS, DRAWN, COPIES = 2, 100, 3
"""Rounds of a comparison, poses drawn in each, and per measurement that may be a line of sight."""
WITHOUT_AMPLITUDE = 0.6
"""Of a loud measurement, what one without amplitude counts for that isn't clutter."""
FIRST_STEPS = 60
"""Steps at which a start is rather told wrong than mirrored, where no heading tells the two apart."""
HERE_M, HERE_RAD, HERE, HERE_SQUARED = 0.1, 0.1, fixed(np.array([0.03, 0.03, 0.02])), 9.0
"""What is nearer to where the agent is believed to be is no other place, nor is what is so few squared
deviations from there, with such ones (m, m, rad) added to their covariance."""
TRIAL = 20
"""Steps that a challenger of a place that is called wrong has to map what is heard."""


def pose_likelihood(
    scans: Sequence[AnchorScan], state: State, model: FilterModel, known: Sequence[Sources] | None = None
) -> PoseLikelihood:
    """A scan to score poses by, with the radio as the state has learned it, and a map where it is given."""
    radios = [state.calibration.tuned(model.radio, scan.anchor) for scan in scans]
    return PoseLikelihood.of(scans, radios, model, known)


class Comparison(NamedTuple):
    """Scores of poses by one scan alone, nats.

    Attributes
    ----------
    best : float
        Of about the best pose.
    here : float
        Of the best about where the agent is believed to be.
    mirrored : float
        What one mirror may add to a line of sight's part in the best.
    """

    best: float
    here: float
    mirrored: float = 0.0


def compare_poses(
    likelihood: PoseLikelihood, believed: Array, covariance: Array, draw: np.random.Generator
) -> Comparison:
    """What one scan alone says of the believed pose (3,), and of others: lines of sight are tried.

    What is within the covariance (3, 3) of the believed pose is no other one, whatever heading it has if the
    scan tells none. The covariance may be singular, and negative by what rounding leaves of a vague one.
    """
    known, facing = covariance / np.outer(HERE, HERE), None
    if not likelihood.tells_heading:
        known[2], known[:, 2], facing = 0.0, 0.0, float(believed[2])
    variance, axes = np.linalg.eigh(known)
    variance = np.maximum(variance, 0.0)
    asked = (line_of_sight_poses(terms, draw, COPIES, 24, facing) for terms in likelihood.terms)
    near_by = believed + HERE * (np.sqrt(variance) * draw.standard_normal((DRAWN, 3)) @ axes.T)
    poses = np.concatenate([believed[None], near_by, *asked])
    log = likelihood.score(poses, 2.0)
    first = int(log.argmax())
    likeliest, top = poses[int(log[: 1 + DRAWN].argmax())], poses[first]
    refined_poses, scores = refined(likelihood, np.array([likeliest, top]), draw)
    here, there = scores.tolist()
    best = max(here, there)
    gap = top - believed
    gap[2] = wrap(gap[2])
    # where a scan is exact a few millimetres decide, which looks about the believed pose miss
    beside = first <= DRAWN or (np.hypot(*gap[:2]) < HERE_M and abs(gap[2]) < HERE_RAD)
    if beside or np.sum((gap / HERE @ axes) ** 2 / (1 + variance)) < HERE_SQUARED:
        return Comparison(best, best)
    other = refined_poses[1]
    each = np.array([terms.score(other[None], 1.0)[0] for terms in likelihood.terms])
    anchors = np.array([terms.position for terms in likelihood.terms])
    shown = shown_by_mirror(anchors, believed, other, arrives=likelihood.tells_heading)
    return Comparison(best, here, added_by_mirror(each, shown))


def refined(likelihood: PoseLikelihood, pose: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """About the best poses near each of some (K, 3), and their scores (K,)."""
    count, std = len(pose), np.array([0.08, 0.08, 0.04])
    drawn, scores = draw.standard_normal((count, ROUNDS, DRAWN, 3)), list[Array]()
    for k in range(ROUNDS):
        tried = pose[:, None] + std * drawn[:, k]
        tried[:, 0] = pose
        score = likelihood.score(tried.reshape(-1, 3)).reshape(count, DRAWN)
        pose, std = tried[np.arange(count), score.argmax(1)], 0.4 * std
        scores.append(score.max(1))
    return pose, np.max(scores, 0)


def watched(
    population: Population[State],
    evidence: Callable[[], float],
    scan: Scan,
    model: FilterModel,
    work: Workspace,
) -> Population[State]:
    """Hand a step's log evidence to the watch, every so often with that of a fresh start to compare.

    At every step while a start isn't borne out, the evidence is low, or the place is called wrong.
    """
    covariance = population.best.belief.covariance
    watch = population.watch.followed(float(covariance[0, 0] + covariance[1, 1]), len(population))
    if len(scan):
        watch = _compared(watch, population.best, evidence, scan, model, work)
    return population if watch is population.watch else replace(population, watch=watch)


def _compared(
    watch: Doubt, state: State, evidence: Callable[[], float], scan: Scan, model: FilterModel, work: Workspace
) -> Doubt:
    """The watch after a scan that holds something."""
    scans = work.once(split_by_anchor, scan, model)
    if crowd(scans) > SWAMPED:
        return watch
    loud, due = loud_of(scans, model), state.step % EVERY == 0
    compares = loud > 0 and (due or watch.is_urgent(evidence(), loud))
    if not (compares or watch.unproven):
        return watch
    draw = np.random.default_rng([work.seed, state.step, LEAD])
    belief, likelihood = state.belief, pose_likelihood(scans, state, model)
    found = compare_poses(likelihood, belief.mean[POSE], belief.covariance[OF_POSE], draw)
    if not scans.arrives and state.step <= FIRST_STEPS:  # a mirror may show all, and no wrong start be found
        found = found._replace(mirrored=0.0)
    if watch.unproven:
        watch = watch.tried(evidence() - found.best, loud, for_sights(state, scan, model, work))
    return watch.compared(evidence(), *found, loud, due) if compares else watch


def loud_of(scans: SplitScan, model: FilterModel) -> float:
    """How many loud measurements a scan is worth, for a comparison with a fresh start.

    Without amplitudes no measurement is louder than another: what is expected to be clutter isn't counted,
    and each of the others tells less than a loud one whose amplitude fits, too.
    """
    whole = scans.whole
    silent = np.isnan(whole.amplitude)
    if not silent.any():
        return float(np.count_nonzero(whole.loud))
    clutter = model.radio.false_alarms * np.count_nonzero([np.isnan(scan.amplitude).any() for scan in scans])
    return float(
        np.count_nonzero(whole.loud & ~silent)
        + WITHOUT_AMPLITUDE * max(np.count_nonzero(silent) - clutter, 0)
    )


def challenged(
    population: Population[State], scan: Scan, fresh: State, model: FilterModel, work: Workspace
) -> Population[State]:
    """While anything is doubtful, the population with poses elsewhere that explain one scan better.

    They are looked for every so often, at the first scan after a silence, and as soon as evidence speaks
    against all: by the scan alone as restarts, with nothing mapped, and by scan and map as relocations, with
    the best one's map.

    Parameters
    ----------
    fresh : State
        Before a first step.
    """
    state = population.best
    due = state.step % EVERY == 0 or state.monitor.silent >= SILENT or population.watch.raised
    if not population.watch.doubtful or not due or not len(scan):
        return population
    scans, stream = work.once(split_by_anchor, scan, model), [work.seed, state.step, CHALLENGE]
    if crowd(scans) > SWAMPED:
        return population
    alone = pose_likelihood(scans, state, model)
    modes = find_modes(alone, anywhere(state, model), model.grid, LISTED, stream, POSES)
    led = [_led(one, scan.time_s, model) for one in population.states]
    if population.watch.unproven and modes.complete and near(modes.pose, led[0].mean[POSE]).all():
        population = replace(population, watch=population.watch.proven())  # nothing fits elsewhere
    velocity = float(model.start_variance[2])
    blank = replace(
        fresh, calibration=state.calibration, monitor=state.monitor, step=state.step,
        next_identity=state.next_identity, turn_variance=None if state.turn_variance is None else ANY,
        turn_anchor=state.turn_anchor, sight_nats=state.sight_nats,
    )  # fmt: skip
    rivals = branches_of(blank, leading(modes, alone, led, population.watch), velocity)
    if len(state.surfaces):
        mapped = pose_likelihood(scans, state, model, known_sources(state, model, work=work))
        modes = find_modes(mapped, anywhere(state, model), model.grid, LISTED, stream, POSES_BY_MAP)
        rivals += branches_of(state, leading(modes, mapped, led, population.watch), velocity)
    here = together([*led, *(rival.belief for rival in rivals)])[len(led) :, : len(led)].any(1)
    rivals = [_leapt(rivals[k], population.states, scan, model) for k in np.flatnonzero(~here)]
    if not rivals:
        return population
    if population.watch.against():
        rivals = [replace(rival, monitor=replace(rival.monitor, trial=TRIAL)) for rival in rivals]
    log = [*population.log_weight, *[population.log_weight[0] - HANDICAP] * len(rivals)]
    return population.having([*population.states, *rivals], log, population.guard)


def on_trial(log_weight: Array, states: Sequence[State]) -> Array:
    """Log weights (K,), of which those of places on trial fall no further behind than they began; (M539).

    A place that is called wrong has had all the time to map what is heard there, wherever it is.
    """
    least = float(log_weight.max()) - HANDICAP
    trials = np.array([state.monitor.trial > 0 for state in states])
    return np.where(trials, np.maximum(log_weight, least), log_weight)


def _led(state: State, time_s: float, model: FilterModel) -> Belief:
    """The agent of a state, led to the time of a scan."""
    elapsed = 0.0 if state.time_s is None else time_s - state.time_s
    return predict_agent(state.belief, elapsed, model.settings)


def _leapt(rival: State, states: Sequence[State], scan: Scan, model: FilterModel) -> State:
    """A rival that says by how far no motion leads there from where the agent may have been."""
    settings, leaps = model.settings, list[float]()
    for state in states:
        elapsed = 0.0 if state.time_s is None else scan.time_s - state.time_s
        led = freed(predict_agent(state.belief, elapsed, settings), elapsed, settings.acceleration_mps2)
        leaps.append(leap(led, rival.belief.mean[POSE], rival.belief.covariance[OF_POSE]))
    return replace(rival, monitor=rival.monitor.leapt(min(leaps)))


def anywhere(state: State, model: FilterModel) -> Belief:
    """The state's belief with nothing known of the pose but the region."""
    side = np.array(model.grid.shape[::-1]) * model.grid.cell_m
    mean, spread = state.belief.mean.copy(), np.diag(np.full(len(state.belief.mean), 10.0))
    mean[:2], spread[[0, 1], [0, 1]] = model.middle, (0.5 * side) ** 2
    return replace(state.belief, mean=mean, covariance=spread)


def leading(modes: Modes, likelihood: PoseLikelihood, led: Sequence[Belief], watch: Doubt) -> Modes:
    """The few modes of a complete list that explain the scan better than all present hypotheses do.

    Once these are called wrong, all modes of an incomplete list that do so beyond what one measurement says.

    Parameters
    ----------
    led : sequence of Belief
        The agents of the hypotheses, led to the time of the scan.
    """
    gain = modes.score - float(likelihood.score(np.array([belief.mean[POSE] for belief in led])).max())
    if modes.complete:
        return modes.take(np.flatnonzero(gain > 0)[:CHALLENGERS])
    return modes.take(np.flatnonzero((gain > ONE_ALONE) & bool(watch.against())))
