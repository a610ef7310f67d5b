"""Correction of agent and surfaces by what one anchor's measurements said of its paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.belief import Belief, update
from gridslam.inference.evaluation import Pairs, gaussian_ratios, residuals
from gridslam.inference.heard import Heard
from gridslam.inference.rays import Rays, predict_paths

Array = NDArray[np.float64]


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
    weight = beta * nu
    missed = np.maximum(1 - chance * detection, 1e-9)
    total = weight.sum(1) / (weight.sum(1) + missed)
    responsible = np.zeros_like(weight)
    for row in np.argsort(-total, kind="stable"):
        if total[row] < 1e-3:
            break
        chosen = pairs.of(row)
        now = predict_paths(rays, np.array([row]), belief, heard.place, heard.facing)
        residual = residuals(pairs, chosen, now.value[0], heard)
        measurement = pairs.measurement[chosen]
        share = chance[row] * nu[row, measurement] * gaussian_ratios(pairs, chosen, residual, now.spread[0])
        share = share / (share.sum() + missed[row])
        responsible[row, measurement] = share
        kept = share > 1e-6
        belief = update(belief, now.jacobian[0], residual[kept], pairs.variance[chosen][kept], share[kept])
    return belief, responsible
