"""Paths that no surface explains, gathered for whoever goes on from the map; docs/model.md, (M432). Ours.

Methods that map by surfaces have no use for them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.messages.faint_births import OF_POSE, POSE, unclaimed
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.anchor_measurements import AnchorScan, own_deviations, whole_of
from gridslam.inference.state.state import State
from gridslam.inference.state.unexplained import Unexplained
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel


def none_yet(model: FilterModel) -> Unexplained | None:
    """Before the first step; None where heights bend what a length says."""
    return None if model.anchor_heights.any() else Unexplained.none()


def gather_unexplained(
    state: State, scans: Sequence[AnchorScan], exchanges: Sequence[Exchange], model: FilterModel, *,
    work: Workspace,
) -> State:  # fmt: skip
    """The state with the step's measurements that were probably no known path's, nor bore a surface.

    Kept are those of distance, angle of arrival and amplitude.
    """
    known, scan = state.unexplained, whole_of(scans)
    if known is None or not len(scan):
        return state
    heard = (scan.table[:, [3, 5]] >= 0).all(1) & (scan.amplitude > 0)
    (rows,) = (heard & unclaimed(exchanges)).nonzero()
    if not len(rows):
        return state
    own, belief = work.once(own_deviations, scans, model.radio), state.belief
    several, columns = (len(rows), 1), np.array([0, 2])
    found = Unexplained(
        scan.label[rows].astype(np.int64), np.full(len(rows), state.step), scan.value[rows][:, columns],
        own[rows][:, columns], scan.amplitude[rows], np.tile(belief.mean[POSE], several),
        np.tile(belief.covariance[OF_POSE], (*several, 1)),
    )  # fmt: skip
    return replace(state, unexplained=known.joined(found))
