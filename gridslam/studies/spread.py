"""How far the seeds of a study scatter: standard errors of what its runs amount to, and of differences.

The root mean square over R runs is a function of the runs' own mean squares, which are independent. Its
standard error follows from theirs to first order (the delta method), and so does that of the difference of
two methods on the same seeds, where what the seeds have in common cancels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gridslam.arrays import Array
from gridslam.studies.batches import Batch

NOTHING = float("nan")


class Difference(NamedTuple):
    """Root mean square of one method minus that of another, over the seeds that both have.

    Attributes
    ----------
    value, error : float
        In the unit of the errors; `error` is its standard error, NaN of fewer than two seeds.
    """

    value: float
    error: float


def squares(batch: Batch, name: str, steps: slice) -> Array:
    """Mean square of a field of `Batch.steps` over some steps of each run, (R,)."""
    return np.asarray((batch.steps[name][..., steps] ** 2).mean(-1))


def standard_error(square: Array) -> float:
    """Standard error of the root of the mean of mean squares (R,); NaN of fewer than two runs."""
    root = float(np.sqrt(square.mean())) if len(square) else NOTHING
    if len(square) < 2 or not root > 0:
        return NOTHING
    return _error(square / (2 * root))


def difference(batch: Batch, other: Batch, name: str, steps: slice) -> Difference:
    """How much larger a method's error is than another's on the same seeds."""
    own, theirs = (dict(zip(_seeds(one), squares(one, name, steps), strict=True)) for one in (batch, other))
    both = [seed for seed in own if seed in theirs]
    if not both:
        return Difference(NOTHING, NOTHING)
    ours, others = (np.array([one[seed] for seed in both]) for one in (own, theirs))
    roots = [float(np.sqrt(one.mean())) for one in (ours, others)]
    value = roots[0] - roots[1]
    if len(both) < 2 or not min(roots) > 0:
        return Difference(value, NOTHING)
    return Difference(value, _error(ours / (2 * roots[0]) - others / (2 * roots[1])))


def _seeds(batch: Batch) -> list[int]:
    return [record["key"]["seed"] for record in batch.records]


def _error(values: Array) -> float:
    """Standard error of a mean."""
    return float(values.std(ddof=1) / np.sqrt(len(values)))
