"""Paths that a scan of arrays holds as if nothing were known of them, to score poses by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.management.poses.pose_fix import known_sources
from gridslam.inference.management.poses.pose_score import AnchorTerms, PoseLikelihood
from gridslam.inference.messages.samples.array_births import peaks_of
from gridslam.inference.messages.samples.array_likelihood import ArrayBand
from gridslam.inference.messages.samples.array_paths import start_noise, without_factors
from gridslam.inference.messages.samples.array_search import find_paths
from gridslam.inference.messages.samples.state_mode import PathsPrior
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.geometry import wrap
from gridslam.world.radio import RadioModel
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

ARRIVING_RAD = 0.05
"""Deviation that a measured heading has in a search at least: arrivals put poses no nearer."""


@dataclass(frozen=True, eq=False)
class HeadedPoseLikelihood(PoseLikelihood):
    """A scan with a heading that was measured beside it, with a deviation (rad)."""

    heading_rad: float
    std_rad: float

    def score(self, poses: Array, widen: float = 1.0) -> Array:
        """As of `PoseLikelihood`, with what the heading says against each pose."""
        news = wrap(poses[:, 2] - self.heading_rad) / (widen * self.std_rad)
        return super().score(poses, widen) - 0.5 * np.square(news)


def alone(state: State, scan: SignalScan, model: SignalModel, work: Workspace) -> PoseLikelihood:
    """The paths of all anchors that were heard; not the heading."""
    peaks = work.once(peaks_alone, state, scan, model, work)
    return PoseLikelihood(tuple(AnchorTerms.of(own, radio, model.birth_rate) for own, radio in peaks))


def headed(likelihood: PoseLikelihood, scan: SignalScan, model: SignalModel) -> PoseLikelihood:
    """The likelihood of poses with the scan's heading, where it holds one."""
    if scan.heading_rad is None:
        return likelihood
    std = max(model.waveform.heading_std_rad, ARRIVING_RAD)
    return HeadedPoseLikelihood(likelihood.terms, scan.heading_rad, std)


def mapped(
    likelihood: PoseLikelihood, scan: SignalScan, state: State, model: SignalModel, *, work: Workspace
) -> PoseLikelihood:
    """The likelihood of poses with the single bounces over the surfaces that a state knows."""
    known = known_sources(state, model, work=work)
    heard = np.flatnonzero(scan.heard).tolist()
    rows = zip(likelihood.terms, heard, strict=True)
    return replace(likelihood, terms=tuple(replace(terms, known=known[anchor]) for terms, anchor in rows))


def peaks_alone(
    state: State, scan: SignalScan, model: SignalModel, work: Workspace
) -> tuple[tuple[AnchorScan, RadioModel], ...]:
    """Paths of every anchor that was heard, as if nothing were known, and a radio that detects such peaks."""
    return tuple(_peaks(state, anchor, scan, model, work) for anchor in np.flatnonzero(scan.heard).tolist())


def _peaks(
    state: State, anchor: int, scan: SignalScan, model: SignalModel, work: Workspace
) -> tuple[AnchorScan, RadioModel]:
    state = start_noise(state, anchor, scan, model)
    assert state.noise is not None
    band: ArrayBand = work.buffers(ArrayBand.of, anchor, model.waveform, anchor)
    none = Rays.of(anchor, 0, -1, -1, np.zeros(0), np.zeros(0)).table
    nothing = PathsPrior(state.belief, model.anchors[anchor], none, np.zeros(0), np.zeros((0, 3)))
    samples, _ = without_factors(state, scan.samples[anchor], anchor)
    new = find_paths(band, samples, nothing, float(state.noise[anchor]), np.zeros(0)).new
    return peaks_of(new, anchor, band, state.calibration.tuned(model.radio, anchor), model)
