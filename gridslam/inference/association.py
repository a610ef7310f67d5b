"""Loopy belief propagation for data association (Williams and Lau 2014, with the new-feature column)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def associate(
    beta: Array, missed: Array, new: Array, rounds: int = 100, tolerance: float = 1e-6
) -> tuple[Array, Array]:
    """Messages of the association graph (paper 002, supporting document).

    Parameters
    ----------
    beta : (L, M)
        Message of every path for "caused measurement m".
    missed : (L,) > 0
        Message of every path for "caused none".
    new : (M,) > 0
        xi_m, message of every measurement for "caused by no legacy path" (1 + birth).

    Returns
    -------
    (nu, claimed)
        nu (L, M): message from measurement m to path l, scaled so that "no measurement" is 1;
        claimed (M,): sum of what the paths send to m, with which new existence is xi / (xi + claimed).
    """
    paths, heard = beta.shape
    nu = np.broadcast_to(1 / new, (paths, heard)).copy()
    claim = np.zeros_like(nu)
    for _ in range(rounds if paths and heard else 0):
        weight = beta * nu
        others = np.maximum(weight.sum(1, keepdims=True) - weight, 0.0)
        claim = beta / (missed[:, None] + others)
        rest = np.maximum(claim.sum(0, keepdims=True) - claim, 0.0)
        fresh = 1 / (new + rest)
        change = np.abs(fresh - nu).max()
        nu = fresh
        if change < tolerance:
            break
    return nu, claim.sum(0)
