"""Covariances, and sums of information, that others hand over: whether they can be any."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError

SLACK = 1e-6
"""By which a correlation may be off."""
ROUNDING = 1e-9
"""The same of information, which differences of far larger numbers go into, by the largest number in it."""


def require_covariance(covariance: NDArray[Any], where: str) -> None:
    """Refuse a matrix that is no covariance; what is known for sure is correlated with nothing.

    Raises
    ------
    InputError
        Not square, not finite, not symmetric, or not positive (semidefinite).
    """
    if covariance.ndim != 2 or covariance.shape[0] != covariance.shape[1]:
        raise InputError(where, f"shape {covariance.shape}", "a square")
    if not np.isfinite(covariance).all():
        raise InputError(where, "NaN or infinity", "finite numbers")
    if not np.allclose(covariance, covariance.T, rtol=SLACK, atol=1e-12):
        raise InputError(where, "not symmetric", "a covariance")
    spread = np.diagonal(covariance) != 0
    known, covariance = covariance[~spread], covariance[np.ix_(spread, spread)]
    scale = np.sqrt(np.maximum(np.diagonal(covariance), 0))
    if known.any() or (scale == 0).any():
        raise InputError(where, "not positive definite", "a covariance")
    if np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min(initial=0) < -SLACK:
        raise InputError(where, "not positive definite", "a covariance")


def is_information(sums: NDArray[Any]) -> bool:
    """Whether all of these matrices (..., N, N) can be inverse covariances, or sums of squares.

    They are finite, symmetric and positive semidefinite, but for rounding.
    """
    if not np.isfinite(sums).all():
        return False
    slack = ROUNDING * np.abs(sums).max((-2, -1), initial=0)
    alike = np.abs(sums - sums.swapaxes(-2, -1)).max((-2, -1), initial=0) <= slack
    return bool(alike.all() and (np.linalg.eigvalsh(sums).min(-1, initial=0) >= -slack).all())
