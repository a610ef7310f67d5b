"""Which measurements may bear surfaces, and which births they call for: one gate for all systems on paths.

Shut out are measurements that a gate here knows the cause of, or can't tell it from a double bounce: those of
anchors whose clock tells nothing, lines of sight, and, where clocks are unknown, what a corner explains as
well. While the position is vague, `put_off_double_bounces` shuts out more, after the update of the pose.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.beliefs.particles import Cloud
from gridslam.inference.messages.birth_proposals import propose_births
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.network.double_births import without_double_bounces
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.messages.sight_births import leave_sights
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.radio import RadioModel


def admitted_births(
    state: State, scan: AnchorScan, cloud: Cloud, paths: PredictedPaths, ratios: LikelihoodRatios,
    radio: RadioModel, model: FilterModel, senders: NDArray[np.int32] | None = None, *, work: Workspace,
) -> tuple[Births, LikelihoodRatios]:  # fmt: skip
    """The births that `propose_births` proposes, without those that the gates shut out.

    Parameters
    ----------
    scan : AnchorScan
        M measurements, of one anchor or of all.
    cloud : Cloud
        The particles that the ratios were evaluated at.
    paths : PredictedPaths
        The L paths that the ratios (L, M) are of.
    radio : RadioModel
        As the anchor's radio seems to be.
    senders : (A,) int32, optional
        Anchors whose measurements may bear surfaces; default: all.

    Returns
    -------
    (births, ratios)
        ratios: with the sums of the births into the association. What a line of sight bore is out of them;
        what a double bounce may have, isn't: something unknown sent it.

    Raises
    ------
    ValueError
        Surfaces or anchors that don't belong together.
    """
    births, ratios = propose_births(state, scan, cloud, ratios, radio, model, senders, work=work)
    births, ratios = leave_sights(births, state, scan, paths, ratios, radio)
    births = without_double_bounces(births, state, scan, cloud, ratios, radio, model, senders, work=work)
    return births, ratios
