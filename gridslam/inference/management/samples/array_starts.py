"""Where an agent with an array starts, if its prior is wide: the one pose that explains a snapshot's paths.

The search is that of grid SLAM, docs/model.md, section 14, over paths that samples hold. Nothing weighs
several worlds of samples against each other: until one pose alone is left, the start isn't found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gridslam.inference.management.branching import branches_of
from gridslam.inference.management.mixture import CAP
from gridslam.inference.management.poses.pose_recovery import is_vague
from gridslam.inference.management.poses.pose_score import Snapshot, SnapshotTerms
from gridslam.inference.management.poses.pose_search import Modes, find_modes
from gridslam.inference.management.start_search import PATIENCE, still_searching
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.messages.motion import predict
from gridslam.inference.messages.samples.array_births import peaks_of
from gridslam.inference.messages.samples.array_likelihood import ArrayBand
from gridslam.inference.messages.samples.array_paths import start_noise
from gridslam.inference.messages.samples.array_search import find_paths
from gridslam.inference.messages.samples.measured_heading import measure_heading
from gridslam.inference.messages.samples.state_mode import PathsPrior
from gridslam.inference.state.population import Population
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

Step = Callable[[State, SignalScan, SignalModel, Workspace], tuple[State, StepInfo]]
PURPOSE = 6
"""Names the stream of random numbers that a search takes."""
EVERY = 5
"""Once patience is over, each so many scans are searched, as it takes its time."""
ARRIVING_RAD = 0.05
"""Deviation that a measured heading has in the search at least: arrivals put poses no nearer."""


def begun(state: State) -> Population[State]:
    """The belief before the first step; where its pose is vague, it is searched for at first."""
    return Population.of(state, searching=is_vague(state.belief))


def advance(
    population: Population[State], scan: SignalScan, model: SignalModel, work: Workspace, step: Step
) -> tuple[Population[State], StepInfo]:
    """One step: of the state, once the start is found; until then the prior moves on and maps nothing."""
    if not population.searching:
        state, info = step(population.best, scan, model, work)
        return replace(population, states=(state,)), info
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
    snapshot = Snapshot(tuple(
        _terms(prior, anchor, scan, model, work) for anchor in np.flatnonzero(scan.heard).tolist()
    ))  # fmt: skip
    stream = [work.seed, prior.step, PURPOSE]
    told = measure_heading(prior, scan, model, ARRIVING_RAD)
    modes = find_modes(snapshot, told.belief, model.grid, CAP, stream)
    if not is_clear(modes):
        return None
    return branches_of(prior, modes, float(model.start_variance[2]))[0]


def is_clear(modes: Modes) -> bool:
    """Whether one pose explains a scan so well that no other comes near."""
    return modes.complete and len(modes) == 1


def _terms(state: State, anchor: int, scan: SignalScan, model: SignalModel, work: Workspace) -> SnapshotTerms:
    """Paths of one anchor's snapshot, as if nothing were known, to score poses by."""
    state = start_noise(state, anchor, scan, model)
    assert state.noise is not None
    band: ArrayBand = work.buffers(ArrayBand.of, anchor, model.waveform, anchor)
    none = Rays.of(anchor, 0, -1, -1, np.zeros(0), np.zeros(0)).table
    nothing = PathsPrior(state.belief, model.anchors[anchor], none, np.zeros(0), np.zeros((0, 3)))
    new = find_paths(band, scan.samples[anchor], nothing, float(state.noise[anchor]), np.zeros(0)).new
    peaks, radio = peaks_of(new, anchor, band, state.calibration.tuned(model.radio, anchor), model)
    return SnapshotTerms.of(peaks, radio, model.birth_rate)
