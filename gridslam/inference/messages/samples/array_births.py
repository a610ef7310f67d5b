"""New surfaces by paths that a snapshot of arrays holds and no known path explains; docs/model.md, (M154)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.beliefs.particles import Cloud
from gridslam.inference.beliefs.streams import ARRAY_BIRTHS
from gridslam.inference.messages.birth_proposals import SAMPLES, propose_births
from gridslam.inference.messages.births import add_chosen
from gridslam.inference.messages.double_bounces import put_off_double_bounces
from gridslam.inference.messages.faint_births import KNOWN
from gridslam.inference.messages.samples.array_likelihood import ArrayBand
from gridslam.inference.messages.samples.array_paths import Snapshot, SnapshotLikelihood
from gridslam.inference.messages.samples.array_search import FALSE_PEAKS, NewPaths, peak_power
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives.tables import MEASURED_ROWS
from gridslam.world.radio import RadioModel
from gridslam.world.signal_model import SignalModel


@dataclass(frozen=True)
class NothingClaimed:
    """New paths that no known one claims; see `birth_proposals.Measured`."""

    measured: Array


def add_new_surfaces(
    state: State, snapshot: Snapshot, likelihood: SnapshotLikelihood, model: SignalModel, *, work: Workspace
) -> tuple[State, AnchorScan]:
    """Surfaces behind the new paths, as if these were measurements with the deviations that they have.

    Returns
    -------
    (state, left)
        left: the new paths that bore none.
    """
    new, anchor = likelihood.found.new, snapshot.anchor
    peaks, radio = peaks_of(new, anchor, snapshot.band, snapshot.radio, model)
    if not len(new):
        return state, peaks
    draw = np.random.default_rng([work.seed, ARRAY_BIRTHS, state.step, anchor])
    cloud = _cloud(state.belief, draw.standard_normal((len(state.belief.mean), SAMPLES)))
    nothing = NothingClaimed(np.zeros((MEASURED_ROWS, len(new))))
    births, _ = propose_births(state, peaks, cloud, nothing, radio, model, work=work)
    births = put_off_double_bounces(births, state, peaks, radio, model)  # (M516)
    state, born, _ = add_chosen(state, births, peaks, np.zeros(len(new)), radio, model)
    return state, peaks.take(np.setdiff1d(np.arange(len(new)), born[born[:, 1] > KNOWN, 0].astype(np.intp)))


def peaks_of(
    new: NewPaths, anchor: int, band: ArrayBand, radio: RadioModel, model: SignalModel
) -> tuple[AnchorScan, RadioModel]:
    """New paths as measurements with the deviations that they have, and a radio that detects such peaks.

    That noise makes such peaks is what they are judged against.
    """
    value, std = new.path.copy(), new.std.copy()
    if len(band.anchor) == 1:
        value[:, 1] = std[:, 1] = np.nan
    radio = replace(radio, threshold=float(np.sqrt(peak_power(band))), false_alarms=FALSE_PEAKS)
    x, y, orientation = model.anchors[anchor].tolist()
    peaks = AnchorScan.of(anchor, np.array([x, y]), orientation, value, std, new.amplitude, radio.threshold)
    return peaks, radio


def _cloud(belief: Belief, points: Array) -> Cloud:
    """Samples of a belief by normal points (n, P)."""
    drawn = belief.mean[:, None] + belief.root @ points
    state = np.empty((3 + 3 * len(belief.lines), points.shape[1]), np.float32)
    state[:2], state[2] = drawn[:2], drawn[HEADING]
    angles = drawn[belief.layout.angles]
    state[3::3], state[4::3], state[5::3] = np.cos(angles), np.sin(angles), drawn[belief.layout.offsets]
    return Cloud(runtime.resident(state), 0.0)
