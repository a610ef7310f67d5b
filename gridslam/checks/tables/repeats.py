"""Rows of a table that are written twice: each counts as a path of its own, so that filters are too sure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gridslam.world.columns import VALUES

LEAST_ROWS, LEAST_SHARE = 3, 0.01
"""Rows, and share of them, that must be repeats for anything to be said."""
LEAST_SHARE_OF_ONE = 0.2
"""Share of the rows that must be repeats where most hold one number alone: rounded, it repeats by chance."""


def repeats_line(columns: Mapping[str, NDArray], agent: NDArray | None = None) -> str | None:
    """What to say of a table in which rows are written twice; None of others.

    Parameters
    ----------
    columns : mapping of (K,) arrays
        Step and anchor, and what was measured; NaN where not.
    agent : (K,) int, optional
        Whose the rows are, of several devices.
    """
    count = len(columns["step"])
    repeated = count - _different([*columns.values(), *([] if agent is None else [agent])])
    measured = [np.isfinite(columns[name]) for name in VALUES if name in columns]
    alone = not measured or np.median(np.sum(measured, axis=0)) < 2
    if repeated < max(LEAST_ROWS, (LEAST_SHARE_OF_ONE if alone else LEAST_SHARE) * count):
        return None
    return (
        f"{repeated} of {count} rows repeat another one, every number alike: each counts as a path "
        "of its own, so that filters are too sure; write each row once"
    )


def _different(columns: list[NDArray]) -> int:
    """How many rows of columns (K,) differ from each other; NaN is like NaN."""
    rows = np.stack([np.asarray(values, dtype=np.float64) for values in columns], axis=1) + 0.0
    rows = np.ascontiguousarray(np.where(np.isnan(rows), np.nan, rows))  # one pattern of bits
    return len(np.unique(rows.view(np.dtype((np.void, rows.shape[1] * 8)))))
