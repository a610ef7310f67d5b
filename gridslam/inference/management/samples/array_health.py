"""What samples of arrays say of anchors and antennas, for health; docs/model.md, (M262), (M510), (M565)."""

from __future__ import annotations

from gridslam.arrays import Array, replace
from gridslam.inference.management.samples.array_challenge import EVERY
from gridslam.inference.management.samples.paths_alone import peaks_alone
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.deviations import own_deviations
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

OFTEN, FIRST = 3, 30
"""Steps from one look at lines of sight to the next at first, before much is mapped, and for how many steps;
from then on they are looked for where places are compared, which takes most of the time."""


def lines_of_sight(
    state: State, scan: SignalScan, model: SignalModel, work: Workspace
) -> tuple[list[AnchorScan], Array] | None:
    """Paths as if nothing were known, anchor by anchor, and deviations (M, 3); None between looks."""
    every = OFTEN if state.step < FIRST else EVERY
    if not scan.heard.any() or state.step % every:
        return None
    scans = [peaks for peaks, _ in work.once(peaks_alone, state, scan, model, work)]
    return scans, own_deviations(scans, model.radio)


def with_elements(info: StepInfo, state: State) -> StepInfo:
    """What happened at a step, with how far antenna elements are from what the recording says of them."""
    size = state.factors.size if state.factors else 0.0
    return replace(info, health=replace(info.health, elements=size)) if size else info
