"""Whether an agent of a network hears what no anchor can have sent to where it is believed to be: (M532)."""

from __future__ import annotations

from dataclasses import replace

from gridslam.inference.health import reasons
from gridslam.inference.health.early_watch import EARLY, KEEP, no_anchors
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.scans.anchor_measurements import whole_scan
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.scan import Scan


def watched_sights(
    part: State, info: StepInfo, scan: Scan, model: FilterModel, *, work: Workspace
) -> tuple[State, StepInfo]:
    """An agent's part after its turn, with the share of its latest steps that contradict it, and its health.

    Where heights have deviations nothing is looked for.
    """
    early = part.monitor.early
    if len(scan) and not part.belief.rises:
        heard = work.once(whole_scan, scan, model)
        now = no_anchors(heard, part.belief, model, part.calibration.tuned(model.radio, 0))
        early = KEEP * early + (1 - KEEP) * now
    if early > EARLY:
        info = info.doubted(reasons.early(early))
    if early != part.monitor.early:
        part = replace(part, monitor=replace(part.monitor, early=early))
    return part, info
