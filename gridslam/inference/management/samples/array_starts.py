"""Where an agent with an array starts, if its prior is wide: the one pose that explains a snapshot's paths.

The search is that of grid SLAM, docs/model.md, section 14, over paths that samples hold. Nothing weighs
several worlds of samples against each other: until one pose alone is left, the start isn't found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from gridslam.inference.beliefs.streams import ARRAY_START
from gridslam.inference.health.monitor import AFRESH
from gridslam.inference.management.branching import branches_of
from gridslam.inference.management.mixture import CAP
from gridslam.inference.management.poses.pose_recovery import is_vague
from gridslam.inference.management.poses.pose_search import Modes, find_modes
from gridslam.inference.management.samples.array_challenge import Start, challenged, doubted, followed
from gridslam.inference.management.samples.array_health import lines_of_sight, with_elements
from gridslam.inference.management.samples.paths_alone import ARRIVING_RAD, alone
from gridslam.inference.management.sight_looks import crossed, distances_doubted, sighted
from gridslam.inference.management.start_search import PATIENCE, still_searching
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.messages.motion import predict
from gridslam.inference.messages.samples.measured_heading import measure_heading
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

Step = Callable[[State, SignalScan, SignalModel, Workspace], tuple[State, StepInfo]]
EVERY = 5
"""Once patience is over, each so many scans are searched, as it takes its time."""


def begun(state: State) -> Population[State]:
    """The belief before the first step; where its pose is vague, it is searched for at first."""
    return Population.of(state, searching=is_vague(state.belief, arrives=True))


def advance_population(
    population: Population[State], scan: SignalScan, model: SignalModel, work: Workspace, start: Start,
    step: Step,
) -> tuple[Population[State], StepInfo]:  # fmt: skip
    """One step: of the state, once the start is found; until then the prior moves on and maps nothing.

    Parameters
    ----------
    start : callable
        Makes the state before the first step from a model.
    step : callable
        Takes one step of a method: state, scan, model and workspace to the new state and what happened.
    """
    if not population.searching:
        population = challenged(population, scan, start, model, work)
        sights = lines_of_sight(population.best, scan, model, work)
        ranges = crossed(population, *sights, model) if sights else population.ranges
        state, info = step(population.best, scan, model, work)
        watch = followed(population.watch, state, info, model)
        population = replace(population, states=(state,), watch=watch, ranges=ranges)
        info = doubted(with_elements(info, state), watch)
        if watch.against() or state.monitor.since < AFRESH:  # who may be elsewhere can't accuse anchors
            return population, info
        if sights:
            population = sighted(population, *sights, model)
        return population, distances_doubted(info, population, ranges, model)
    work.begin()
    prior = predict(population.best, scan.time_s, len(scan), model)
    audible, waited = bool(scan.heard.any()), population.waited
    due = audible and (waited < PATIENCE or waited % EVERY == 0)
    found = _found(prior, scan, model, work) if due else None
    if found is None:
        return still_searching(population, prior, audible, model, work)
    state, info = step(found, scan, model, work)
    return replace(population, states=(state,), searching=False), info


def _found(prior: State, scan: SignalScan, model: SignalModel, work: Workspace) -> State | None:
    """The state at the one pose within the prior that explains a scan, if there is no other."""
    likelihood = alone(prior, scan, model, work)
    stream = [work.seed, prior.step, ARRAY_START]
    told = measure_heading(prior, scan, model, ARRIVING_RAD)
    modes = find_modes(likelihood, told.belief, model.grid, CAP, stream)
    if not is_clear(modes):
        return None
    return branches_of(prior, modes, float(model.start_variance[2]))[0]


def is_clear(modes: Modes) -> bool:
    """Whether one pose explains a scan so well that no other comes near."""
    return modes.complete and len(modes) == 1
