"""Direct SLAM: agent and images of the anchors straight from sampled signals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gridslam.inference.management.image_merging import merge_images
from gridslam.inference.messages.distance_mode import Mode, PathPrior
from gridslam.inference.messages.image_births import NewPath, add_tentative, find_births
from gridslam.inference.messages.image_prediction import (
    AnchorPaths,
    predict_paths,
    predict_state,
    update_state,
)
from gridslam.inference.messages.image_rings import (
    forbid_own_place,
    join_straight_rings,
    learn_rings,
    prune,
)
from gridslam.inference.messages.path_levels import reclaim_line_of_sight, start_levels, update_levels
from gridslam.inference.messages.signal_likelihood import Band
from gridslam.inference.state.images import DirectState
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan


@dataclass(frozen=True, eq=False)
class AnchorInfo:
    """What happened with one anchor at a step.

    Attributes
    ----------
    paths : AnchorPaths
        As predicted.
    prior : PathPrior
        With the new paths that were taken in.
    mode : Mode
        Of all distances.
    new : list of NewPath
    """

    paths: AnchorPaths
    prior: PathPrior
    mode: Mode
    new: list[NewPath]


def start(model: SignalModel) -> DirectState:
    """The state before the first step: the agent's prior, and no images."""
    return DirectState.start(model.start_mean[:4], model.start_variance[:4], len(model.anchors))


def step(state: DirectState, scan: SignalScan, model: SignalModel) -> tuple[DirectState, list[AnchorInfo]]:
    """One step, as the list of its messages ([LiangDirect], section III; docs/model.md, section 12)."""
    band, infos = Band.of(model.waveform.offset_hz, model.waveform.pulse), list[AnchorInfo]()
    state = predict_state(state, scan.time_s, model)
    for anchor in np.flatnonzero(scan.heard).tolist():
        samples = scan.samples[anchor, 0, 0]
        state = start_levels(state, anchor, band, samples, model)
        noise = float(state.links.noise[anchor])
        paths = predict_paths(state, anchor, model)
        found = find_births(band, samples, paths.prior, noise, state.step)
        state = update_state(state, paths, found.mode)
        state = learn_rings(state, paths, found)
        state = update_levels(state, paths, found)
        state = reclaim_line_of_sight(state, paths, found.mode)
        state = add_tentative(state, anchor, found.new, model)
        infos.append(AnchorInfo(paths, found.prior, found.mode, found.new))
    state = forbid_own_place(state, model)
    state = merge_images(join_straight_rings(state))
    state = prune(state)
    return replace(state, step=state.step + 1), infos
