"""Correction of agent and surfaces by what an anchor heard of its paths; owner of that kernel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.belief import Belief
from gridslam.inference.evaluation import Pairs
from gridslam.inference.heard import Heard
from gridslam.inference.rays import Rays

Array = NDArray[np.float64]
UNHEARD, UNMOVED = 1e-3, 1e-6
"""Probabilities below which a path is left out, and below which an association moves nothing."""


def correct(
    belief: Belief, rays: Rays, chance: Array, detection: Array, beta: Array, nu: Array, pairs: Pairs,
    heard: Heard,
) -> tuple[Belief, Array]:  # fmt: skip
    """Update the joint belief by every path in turn, surest first, moment-matched over its association.

    Each path is linearised where the ones before it have led: the sure ones carry the unsure.

    Parameters
    ----------
    chance : (L,)
        Probability that the path is there.
    detection : (L,)
        Its probability of being detected then.
    beta, nu : (L, M)
        Messages into and out of the association.

    Returns
    -------
    (belief, responsible)
        responsible (L, M): probability that the path caused the measurement.
    """
    runtime.start()
    from gridslam.kernels.gaussian import correct as launch

    rays.check(len(belief.lines), heard.anchor + 1)
    weight = (beta * nu).sum(1)
    missed = np.maximum(1 - chance * detection, 1e-9)
    total = weight / (weight + missed)
    order = np.argsort(-total, kind="stable")
    order = order[total[order] >= UNHEARD]
    responsible = np.zeros_like(beta)
    if not len(order):
        return belief, responsible
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    pairs.pair[:, 7] = nu[pairs.path, pairs.measurement]
    share = np.zeros(len(pairs))
    launch(
        mean,
        covariance,
        rays.table,
        pairs.start,
        order.astype(np.int32),
        np.stack([chance, missed]),
        pairs.pair,
        np.array([*heard.place, heard.facing]),
        UNMOVED,
        np.empty((len(mean), 6)),
        share,
    )
    responsible[pairs.path, pairs.measurement] = share
    return Belief(mean, covariance), responsible
