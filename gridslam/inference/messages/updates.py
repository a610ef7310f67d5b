"""Data association of what an anchor heard, and the updates that follow from it; owner of their kernel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.messages.association import ROUNDS, associate
from gridslam.inference.messages.likelihood_ratios import Evaluation
from gridslam.inference.messages.prediction import Prediction
from gridslam.inference.state.anchor_measurements import Heard
from gridslam.inference.state.belief import Belief
from gridslam.inference.state.calibration import Watch
from gridslam.inference.state.path_messages import Notes
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.surface_bank import Bank
from gridslam.kernels.primitives import tables

Array = NDArray[np.float64]


def update(
    belief: Belief, bank: Bank, sight: Array, rays: Rays, predicted: Prediction, heard: Heard,
    said: Evaluation, given: tuple[Array, Array] | None, watch: Watch, radio: Array, anchors: Array,
    notes: Notes,
) -> None:  # fmt: skip
    """Associate; correct agent and surfaces and update what exists, in place; note how well it all fits.

    The joint belief is corrected by every path in turn, surest first, moment-matched over its association.
    Each path is linearised where the ones before it have led: the sure ones carry the unsure.

    Parameters
    ----------
    sight : (J,)
        Existence of every anchor's line of sight, updated in place like the bank's rays.
    said : Evaluation
        With its `new` filled in; its messages are filled in here.
    given : (nu, claimed), optional
        Messages out of an association done otherwise, as of `association.associate`.
    radio : (11,)
        `SignalModel.radio` of the anchor, as told.
    anchors : (J, 3)
        x, y (m) and orientation (rad).
    notes : Notes
        To which what the measurements said is appended.
    """
    if runtime.start() == "gpu" and given is None:
        given = associate(said.beta, said.missed, said.new)  # a device may bound how long one launch loops
    from gridslam.kernels.messages.updates import update as launch

    rays.check(len(bank), len(sight))
    rays.check(len(bank), len(anchors))
    if not 0 <= heard.anchor < len(watch.fits):
        raise ValueError("there is no such anchor")
    pairs, mean, covariance = said.pairs, belief.mean, belief.covariance
    share, rounds = runtime.scratch(f"share {heard.anchor}", (len(pairs.index),)), ROUNDS
    if given is not None:
        (said.message[tables.NU], said.measured[tables.CLAIMED]), rounds = given, 0
    notes.reserve(len(rays), len(pairs), (len(bank), len(anchors)))
    launch(
        mean, covariance, rays.table, pairs.start, pairs.index, pairs.pair, said.odds, rounds, anchors,
        predicted.whole, heard.table, said.blocks, radio, heard.anchor,
        watch.taken,
        runtime.scratch("update", (len(mean), 6)), said.message, said.measured, bank.existence, sight,
        bank.single, bank.double, share, watch.fits, *notes.arrays,
    )  # fmt: skip
