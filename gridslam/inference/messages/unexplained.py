"""Paths that no surface explains, gathered for whoever goes on from the map; docs/model.md, (M432). Ours.

Methods that map by surfaces have no use for them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import replace
from gridslam.inference.beliefs.layout import OF_POSE, POSE
from gridslam.inference.scans.anchor_measurements import AnchorScan, whole_of
from gridslam.inference.scans.deviations import own_deviations
from gridslam.inference.scans.unexplained import Unexplained
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel


def none_yet(model: FilterModel) -> Unexplained | None:
    """Before the first step; None where heights bend what a length says."""
    return None if model.anchor_heights.any() else Unexplained.none()


def gather_unexplained(
    state: State, scans: Sequence[AnchorScan], unclaimed_rows: NDArray[np.bool_], model: FilterModel, *,
    work: Workspace,
) -> State:  # fmt: skip
    """The state with the step's measurements that were probably no known path's, nor bore a surface.

    Kept are those of distance, angle of arrival and amplitude.

    Parameters
    ----------
    unclaimed_rows : (M,) bool
        What is `unclaimed`.
    """
    known, scan = state.unexplained, whole_of(scans)
    if known is None or not len(scan):
        return state
    (rows,) = (scan.arriving & unclaimed_rows).nonzero()
    if not len(rows):
        return state
    own, belief, several = work.once(own_deviations, scans, model.radio), state.belief, len(rows)
    found = Unexplained(
        scan.label[rows].astype(np.int64), np.full(several, state.step), scan.value[rows, ::2],
        own[rows, ::2], scan.amplitude[rows], np.repeat(belief.mean[None, POSE], several, 0),
        np.repeat(belief.covariance[OF_POSE][None], several, 0),
    )  # fmt: skip
    return replace(state, unexplained=known.joined(found))
