"""Setting clocks: what all agents heard, as evidence about each open one's offset; docs/model.md, (M103)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.state.clock_search import CELL_M
from gridslam.world.geometry import wrap

Array = NDArray[np.float64]
TURN_DENSITY = 1 / (2 * np.pi)
UNMEASURED = 2 * np.pi
"""Variance of an angle of residual 0 whose normal density is that of any angle at all."""


def clock_evidence(
    predicted: Array, spread: Array, chance: Array, measured: Array, std: Array, clutter: float, centre: Array
) -> Array:
    """Log evidence of one agent's measurements about the offset of one anchor's clock.

    Over its paths l and the measurements m, ``sum_l log(1 - c_l + sum_m c_l N(angles of m) N(distance of m;
    d_l + beta | angles) / (mu f))``, with c the probability that path l is there and detected. The angles
    recognise the path; what they say of the pose is taken into its length.

    Parameters
    ----------
    predicted : (L, 3)
        Distance (m, without the anchor's clock), AoD and AoA (rad) of the anchor's paths.
    spread : (L, 3, 3)
        Their covariance by the belief, without that clock.
    chance : (L,)
        c.
    measured : (M, 3)
        NaN where not measured.
    std : (L, M, 3)
        Deviations, if path l caused m.
    clutter : float
        mu f: density of clutter over distance and both angles, 1 / (m rad^2).
    centre : (C,) m
        Offsets beta.

    Returns
    -------
    (C,)
    """
    total = np.zeros(len(centre))
    heard = np.flatnonzero(np.isfinite(measured[:, 0]))
    for value, own, c, deviation in zip(predicted, spread, chance, std, strict=True):
        if not c:
            continue
        residual = measured[heard] - value
        residual[:, 1:] = wrap(residual[:, 1:])
        joint = np.broadcast_to(own, (len(heard), 3, 3)).copy()
        joint += np.square(deviation[heard])[:, :, None] * np.eye(3)
        for angle in (1, 2):
            missing = ~(np.isfinite(measured[heard, angle]) & np.isfinite(deviation[heard, angle]))
            joint[missing, angle], joint[missing, :, angle] = 0.0, 0.0
            joint[missing, angle, angle], residual[missing, angle] = UNMEASURED, 0.0
        inverse = np.linalg.inv(joint[:, 1:, 1:])
        cross = np.einsum("mi,mij->mj", joint[:, 0, 1:], inverse)
        shift = (cross * residual[:, 1:]).sum(1)
        variance = joint[:, 0, 0] - (cross * joint[:, 0, 1:]).sum(1) + CELL_M**2 / 12
        exponent = np.einsum("mi,mij,mj->m", residual[:, 1:], inverse, residual[:, 1:])
        weight = TURN_DENSITY * np.sqrt(np.linalg.det(inverse)) * np.exp(-0.5 * exponent)
        far = centre[:, None] - (residual[:, 0] - shift)
        density = np.exp(-0.5 * far**2 / variance) / np.sqrt(2 * np.pi * variance)
        total += np.log(1 - c + c * (density @ weight) / clutter)
    return total
