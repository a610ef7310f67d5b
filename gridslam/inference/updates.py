"""Updates by what an anchor heard, once its measurements are associated; owner of that kernel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
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
    said: Evaluation, nu: Array, watch: Watch, radio: Array,
) -> tuple[Belief, Array, Array, Array]:  # fmt: skip
    """Correct agent and surfaces; update, in place, what exists; note how well it all fits.

    The joint belief is corrected by every path in turn, surest first, moment-matched over its association.
    Each path is linearised where the ones before it have led: the sure ones carry the unsure.

    Parameters
    ----------
    sight : (J,)
        Existence of every anchor's line of sight, updated in place like the bank's rays.
    nu : (L, M)
        Messages out of the association.
    radio : (11,)
        Row of `SignalModel.numbers` of the anchor, as told.

    Returns
    -------
    (belief, share, responsible, worth)
        share (K,): probability of each pair; responsible (L, M): the same, by path and measurement;
        worth (L,): mean of ``sum_m nu_m g_m + 1 - p_d``.
    """
    runtime.start()
    from gridslam.kernels.updates import update as launch

    rays.check(len(bank), len(sight))
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    bank.existence = bank.existence.copy()  # estimates keep what it was
    share, responsible, worth = np.empty(len(pairs)), np.empty(nu.shape), np.empty(len(rays))
    launch(
        mean, covariance, rays.table, pairs.start, pairs.index, pairs.pair, said.prior, said.odds, said.ratio,
        said.beta, nu, heard.spot, predicted.whole, heard.table, said.blocks,
        radio, float(watch.taken[heard.anchor]), np.empty((len(mean), 6)), np.empty(len(rays) + len(bank)),
        np.empty(len(rays), np.int32), bank.existence, sight, bank.single, bank.double, share,
        responsible, worth, watch.fits[heard.anchor],
    )  # fmt: skip
    return Belief(mean, covariance), share, responsible, worth
