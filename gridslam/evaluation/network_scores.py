"""How good a network's clocks and labels are, by what can be observed.

Offsets of clocks have a common part that no measurement tells of (docs/model.md, (M101)). So they are
judged by pairs (apparent biases), and with that part removed, unless a reference clock says what it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

SYNCHRONISED_S = 3e-9
"""Error, common part removed (without a reference), within which a clock counts as set."""


def apparent_biases(offset: Array, anchors: int) -> Array:
    """Differences between the anchors' and the agents' offsets.

    Parameters
    ----------
    offset : (..., J + I)
        Of the anchors, then of the agents.
    anchors : int
        J.

    Returns
    -------
    (..., I, J)
    """
    return np.asarray(offset[..., None, :anchors] - offset[..., anchors:, None])


def without_common(error: Array) -> Array:
    """Errors of offsets (..., D) without what all of them have in common."""
    return np.asarray(error - error.mean(-1, keepdims=True))


def told_errors(error: Array, device: Sequence[str], reference: str | None) -> Array:
    """Errors of devices' offsets (..., D) that measurements tell: to a reference's, or `without_common`."""
    if reference is None:
        return without_common(error)
    return np.asarray(error - error[..., [list(device).index(reference)]])


def steps_to_synchronise(error_s: Array, limit_s: float = SYNCHRONISED_S) -> list[int | None]:
    """First step from which on each clock stays within the limit; None for one that ends beyond.

    Parameters
    ----------
    error_s : (N, D) s
        Estimated minus true offsets, of `told_errors`.
    """
    wrong = np.abs(error_s) > limit_s
    steps = [np.flatnonzero(column) for column in wrong.T]
    last = [int(own[-1]) + 1 if len(own) else 0 for own in steps]
    return [None if step == len(wrong) else step for step in last]


def label_errors(given: NDArray[np.intp], source: NDArray[np.intp]) -> tuple[int, int]:
    """How many measurements of true paths were given another anchor than theirs, and how many were given one.

    Parameters
    ----------
    given, source : (K,) int
        Anchor that a filter took a measurement to come from, and the true one; -1 for none.
    """
    judged = (given >= 0) & (source >= 0)
    return int((given != source)[judged].sum()), int(judged.sum())
