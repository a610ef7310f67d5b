"""Whether samples of arrays fit another place better, and the agent moved there if that is the only one.

As of paths (`gridslam.inference.management.challenge`), over those that samples hold; docs/model.md, (M522).
No two worlds of samples are weighed against each other: either the place that is believed in is
called wrong and one pose alone explains a scan far better, or nothing changes but what health says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace as changed

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.layout import OF_POSE, POSE
from gridslam.inference.beliefs.streams import ARRAY_CHALLENGE, ARRAY_LEAD
from gridslam.inference.health.doubt import DOUBT_STEPS, ELSEWHERE, ONE_ALONE, Doubt
from gridslam.inference.management.branching import branches_of
from gridslam.inference.management.challenge import LISTED, POSES, anywhere, compare_poses, refined
from gridslam.inference.management.free_turn import ANY, with_turn
from gridslam.inference.management.poses.pose_fix import Fix
from gridslam.inference.management.poses.pose_recovery import TOO_FAR, blurred, moved
from gridslam.inference.management.poses.pose_score import PoseLikelihood
from gridslam.inference.management.poses.pose_search import Modes, find_modes
from gridslam.inference.management.samples.paths_alone import alone, headed, mapped
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.messages.mirrors import unweighed
from gridslam.inference.messages.motion import predict
from gridslam.inference.scans.anchor_measurements import LOUD
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels import CAUSED, LOUD_ONES, SUMS
from gridslam.world.geometry import wrap
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

Start = Callable[[SignalModel], State]
EVERY, OFTEN = 10, 2
"""Steps from one comparison to the next, and while anything is doubtful."""
FEWEST = 3
"""Loud paths of which most are new where the agent is lost, at least."""
SURELY = ELSEWHERE + ONE_ALONE
"""Nats by which another pose explains a scan better than the place that is believed in, by scan and map."""
KEEPS = 5.0
"""Nats by which the map explains a scan better there than new walls do, from which on it is kept."""


def challenged(
    population: Population[State], scan: SignalScan, start: Start, model: SignalModel, work: Workspace
) -> Population[State]:
    """The hypothesis before a scan, every so often compared with where the scan alone puts the agent.

    Parameters
    ----------
    start : callable
        The system's: its state before the first step.
    """
    state, watch = population.best, population.watch
    every = OFTEN if watch.doubtful else EVERY
    if not scan.heard.any() or state.step == 0 or state.step % every:
        return population
    work.begin()
    prior = predict(state, scan.time_s, len(scan), model)
    paths = headed(alone(state, scan, model, work), scan, model)
    if not any_loud(paths):
        return population
    over = mapped(paths, scan, prior, model, work=work)
    draw = np.random.default_rng([work.seed, state.step, ARRAY_LEAD])
    pose = prior.belief.mean[POSE]
    best, here, mirrored = compare_poses(paths, pose, prior.belief.covariance[OF_POSE], draw)
    here = max(here, float(refined(over, pose[None], draw)[1][0]))
    watch = watch.scored(best, here, mirrored)
    if watch.against():
        found = _found(paths, prior, best - here, model, work)
        if found is not None:
            moved_to = _moved(state, prior, found, paths, over, start(model), model)
            watch = Doubt(doubtful=DOUBT_STEPS)
            return changed(population, states=(moved_to,), watch=watch, sights=None)
    return changed(population, watch=watch)


def followed(watch: Doubt, state: State, info: StepInfo, model: SignalModel) -> Doubt:
    """The watch a step on: places are compared often while health isn't well or most that is loud is new.

    A place that is wrong soon has walls behind all that is heard, and then no scan tells it any more.
    """
    covariance = with_turn(state, model).belief.covariance
    after = watch.followed(float(covariance[0, 0] + covariance[1, 1]), 1)
    fits = np.array([exchange.fit[0] for exchange in info.exchanges]).reshape(-1, SUMS)
    explained, loud = fits[:, CAUSED].sum(), fits[:, LOUD_ONES].sum()
    if info.health.ok and (loud < FEWEST or explained >= 0.5 * loud):
        return after
    return replace(after, doubtful=max(after.doubtful, EVERY))


def doubted(info: StepInfo, watch: Doubt) -> StepInfo:
    """What happened at a step, with what speaks against the place."""
    for reason in watch.against():
        info = info.doubted(reason)
    return info


def any_loud(paths: PoseLikelihood) -> bool:
    """Whether any path is too loud for noise."""
    return any((terms.amplitude**2 > terms.radio.threshold**2 + LOUD).any() for terms in paths.terms)


def _found(
    paths: PoseLikelihood, prior: State, gain: float, model: SignalModel, work: Workspace
) -> Modes | None:
    """The one pose that explains a scan surely better, if there is no other."""
    if gain < SURELY:
        return None
    stream = [work.seed, prior.step, ARRAY_CHALLENGE]
    modes = find_modes(paths, anywhere(prior, model), model.grid, LISTED, stream, POSES)
    return modes if modes.complete and len(modes) == 1 else None


def _moved(
    state: State, prior: State, modes: Modes, paths: PoseLikelihood, over: PoseLikelihood, fresh: State,
    model: SignalModel,
) -> State:  # fmt: skip
    """The state before a scan with the agent at the one pose that explains it.

    Where the belief reaches, the map follows by its correlation; else it is kept if it explains the scan from
    there, and lost if not.
    """
    pose, covariance = modes.pose[0], modes.covariance[0]
    monitor = state.monitor.found_again()
    if _reaches(prior, pose, covariance):
        fix = Fix(pose, covariance, 0.0, 0.0)
        belief = moved(prior.belief, fix, float(model.start_variance[2]))
        there = unweighed(replace(prior.believing(belief), surfaces=state.surfaces))
        return replace(there, time_s=None, calibration=state.calibration, monitor=monitor)
    told = any(len(element) > 1 for element in model.waveform.anchor_element_m)  # by departures
    blank = replace(
        fresh, calibration=state.calibration, noise=state.noise, elements=state.elements, step=state.step,
        next_identity=state.next_identity, turn_variance=None if told or state.turn_variance is None else ANY,
        turn_anchor=state.turn_anchor, sight_nats=state.sight_nats,
    )  # fmt: skip
    kept = float(over.score(pose[None])[0] - paths.score(pose[None])[0]) > KEEPS
    velocity = float(model.start_variance[2])
    return replace(branches_of(unweighed(state) if kept else blank, modes, velocity)[0], monitor=monitor)


def _reaches(prior: State, pose: Array, covariance: Array) -> bool:
    """Whether a belief reaches a pose, so that it may be corrected by it."""
    gap = pose - prior.belief.mean[POSE]
    gap[2] = wrap(gap[2])
    own = prior.belief.covariance[OF_POSE] + blurred(covariance)
    return bool(gap @ np.linalg.solve(own, gap) < TOO_FAR**2)
