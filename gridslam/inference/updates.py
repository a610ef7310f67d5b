"""Data association of what an anchor heard, and the updates that follow from it; owner of their kernel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.association import ROUNDS, associate
from gridslam.inference.belief import Belief
from gridslam.inference.evaluation import Evaluation, Pairs
from gridslam.inference.heard import Heard
from gridslam.inference.prediction import Prediction
from gridslam.inference.rays import Rays
from gridslam.inference.surfaces import Bank
from gridslam.inference.watch import Watch

Array = NDArray[np.float64]


def update(
    belief: Belief, bank: Bank, sight: Array, rays: Rays, predicted: Prediction, pairs: Pairs, heard: Heard,
    said: Evaluation, new: Array, given: tuple[Array, Array] | None, watch: Watch, radio: Array,
) -> tuple[Belief, Array, Array, Array, Array]:  # fmt: skip
    """Associate; correct agent and surfaces; update, in place, what exists; note how well it all fits.

    The joint belief is corrected by every path in turn, surest first, moment-matched over its association.
    Each path is linearised where the ones before it have led: the sure ones carry the unsure.

    Parameters
    ----------
    sight : (J,)
        Existence of every anchor's line of sight, updated in place like the bank's rays.
    new : (M,)
        Message of every measurement into the association for "caused by no legacy path".
    given : (nu, claimed), optional
        Messages out of an association done otherwise, as of `association.associate`.
    radio : (11,)
        `SignalModel.radio` of the anchor, as told.

    Returns
    -------
    (belief, share, responsible, worth, claimed)
        share (K,): probability of each pair; responsible (L, M): the same, by path and measurement;
        worth (L,): mean of ``sum_m nu_m g_m + 1 - p_d``; claimed (M,): what paths claim of measurements.
    """
    if runtime.start() == "gpu" and given is None:
        given = associate(said.beta, said.missed, new)  # a device may bound how long one launch loops
    from gridslam.kernels.updates import update as launch

    rays.check(len(bank), len(sight))
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    bank.existence = bank.existence.copy()  # estimates keep what it was
    share, worth = np.empty(len(pairs)), np.empty((3, len(rays)))
    message, claimed, rounds = np.empty((3, *said.beta.shape)), np.empty(len(heard)), ROUNDS
    if given is not None:
        (message[1], claimed), rounds = given, 0
    launch(
        mean, covariance, rays.table, pairs.start, pairs.index, pairs.pair, said.prior, said.odds, said.ratio,
        said.beta, new, rounds, heard.spot, predicted.whole, heard.table, said.blocks, radio,
        float(watch.taken[heard.anchor]), runtime.scratch("update", (len(mean), 6)), message, claimed,
        bank.existence, sight, bank.single, bank.double, share, worth, watch.fits[heard.anchor],
    )  # fmt: skip
    return Belief(mean, covariance), share, message[2], worth[0], claimed
