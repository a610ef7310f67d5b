"""One step of samples into whichever belief hybrid SLAM has: particles at the start, the joint one after."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.inference.beliefs.calibration import KEEP
from gridslam.inference.messages.features import sight
from gridslam.inference.messages.features.arrivals import DEVIATIONS, Arrivals
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.found_again import LEAP, LEAP_M, update_anywhere
from gridslam.inference.messages.features.joint_update import SIGHTED
from gridslam.inference.messages.features.particles_astray import carried_particles, follow_astray
from gridslam.inference.messages.features.path_products import LEAST_M
from gridslam.inference.messages.features.sight import Moments
from gridslam.inference.messages.features.silences import carried
from gridslam.inference.state.features.features import MOVING
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief
from gridslam.inference.workspace.workspace import StageClock, timed
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

START_STEPS = 10
"""For which particles look for the agent; then the joint belief goes through them again."""


class FeatureWork(StageClock):
    """What steps of hybrid SLAM and of its references share and no state holds.

    Parameters
    ----------
    front : Front
        Tables of the waveform.
    seed : int
    """

    def __init__(self, front: Front, seed: int) -> None:
        super().__init__()
        self.front = front
        self.seed = seed


@dataclass(frozen=True, eq=False)
class StepSamples:
    """Samples of one step as messages take them.

    Attributes
    ----------
    samples : (J, N, M) complex128
    heard : (J,) bool
    heading_rad : float
    """

    samples: NDArray[np.complex128]
    heard: NDArray[np.bool_]
    heading_rad: float


def step_samples(scan: SignalScan, model: SignalModel) -> StepSamples:
    """The samples of anchors of one element each.

    Raises
    ------
    InputError
        No heading, where an array needs one.
    """
    heading = scan.heading_rad
    if heading is None:
        if len(model.waveform.agent_element_m) > 1:
            raise InputError("signal: heading_rad", "none", "a heading, which the agent's array needs")
        heading = 0.0
    return StepSamples(scan.samples[:, 0], scan.heard, heading)


def predict_agent(
    state: HybridState, time_s: float, model: SignalModel, seed: int, bounded: bool = False
) -> HybridState:
    """The belief at the time of a scan, (M133); at the first step nothing has moved yet.

    Parameters
    ----------
    bounded : bool
        Whether particles stay in the region over a silence, (M571); those of references don't.
    """
    if state.time_s is None:
        return replace(state, time_s=time_s)
    seconds = time_s - state.time_s
    if state.particles is not None:
        state = carried_particles(state, seconds, model, seed, bounded)
        return replace(state, time_s=time_s)
    return replace(state, joint=carried(state.joint, seconds, model), time_s=time_s)


@timed("follow")
def follow_by_particles(
    state: HybridState, received: StepSamples, model: SignalModel, bounded: bool = False, *, work: FeatureWork
) -> tuple[HybridState, Moments]:
    """Particles of agent and noise after the samples, (M134)-(M136), see `sight.update_particles`."""
    front, seed, samples, heard = work.front, work.seed, received.samples, received.heard
    if state.joint.astray and heard.any():
        return follow_astray(state, samples, heard, received.heading_rad, model, seed)
    tables = [front.tables(z[None]) for z in samples]
    cloud = state.particles
    if cloud is None:
        state = replace(state, before=sight.rescaled(state.before, tables, heard))
        state = replace(state, joint=state.before)
        cloud = sight.start_particles(state.joint, tables, heard, model, seed)
    cloud, moments = sight.update_particles(
        cloud, state.joint, samples, tables, heard, received.heading_rad, front, model, seed, state.step,
        bounded, state.segment.latest(),
    )  # fmt: skip
    return replace(state, particles=cloud), moments


@timed("follow")
def follow_jointly(
    state: HybridState, received: StepSamples, model: SignalModel, *, work: FeatureWork
) -> tuple[HybridState, Moments]:
    """The joint belief after the samples, (M126) to (M131), beside paths that nobody knows yet, (M526).

    An agent astray is looked for in the whole region, (M572).
    """
    joint, evidence = update_anywhere(
        state.joint, received.samples, received.heard, received.heading_rad, model, state.step
    )
    moments = Moments(joint.mean[:MOVING], joint.agent_covariance, evidence, np.inf)
    return leapt(replace(state, joint=joint), state.joint, joint), moments


def leapt(state: HybridState, before: JointBelief, after: JointBelief, since: int = -1) -> HybridState:
    """The state with how far its agent was moved, if that was farther than it can have moved, (M529).

    Parameters
    ----------
    since : int
        Steps since then: -1 within a step that `count_step` hasn't counted yet.
    """
    shift = after.mean[:2] - before.mean[:2]
    squared = float(shift @ np.linalg.solve(before.agent_covariance[:2, :2], shift))
    far = float(np.hypot(*shift))
    if far < LEAP_M or squared < LEAP**2:
        return state
    return replace(state, leap_m=far, since_leap=since)


def remember(state: HybridState, received: StepSamples, moments: Moments) -> HybridState:
    """The segment with this step; an agent astray can't say from where it was heard, nor learn of it."""
    assert state.time_s is not None
    used = not state.joint.astray
    segment = state.segment.add(
        state.time_s, received.heading_rad, received.heard & used, received.samples, moments.mean,
        moments.log_evidence * used,
    )  # fmt: skip
    return replace(state, segment=segment)


def count_step(
    state: HybridState, received: StepSamples, moments: Moments, front: Front, model: SignalModel
) -> HybridState:
    """The state with one more step taken, and whether it contradicts where the agent is believed to be.

    It does if anything arrives before a line of sight as short as the agent's deviations allow, (M451).
    Where no line of sight is seen, it tells nothing else.
    """
    silent = 0 if received.heard.any() else state.silent + 1
    belief = state.joint if state.particles is None else state.particles
    sights = received.heard & (belief.existence > SIGHTED) & (not state.joint.astray)
    seen, early = bool(sights.any()), False
    for j in np.flatnonzero(received.heard):
        way = moments.mean[:2] - model.anchors[j, :2]
        far = float(np.hypot(*way))
        spread = float(np.sqrt(way @ moments.covariance[:2, :2] @ way)) / max(far, LEAST_M)
        early |= Arrivals.of(received.samples[j], front).before(far - DEVIATIONS * spread)
    share = state.early + (1 - KEEP) * (early - state.early) * (early or seen)
    unseen = state.unseen if len(state.unseen) else np.zeros(len(sights), np.int64)
    return replace(
        state, step=state.step + 1, silent=silent, early=share, sights=state.sights + seen,
        sighted=sights + (state.sighted if len(state.sighted) else 0), since_leap=state.since_leap + 1,
        unseen=np.where(sights, np.minimum(unseen, 0), unseen + 1),
    )  # fmt: skip
