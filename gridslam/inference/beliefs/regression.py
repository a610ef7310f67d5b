"""What stands beside a joint belief, correlated with it: how it follows when that is updated, (M575)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief, solved
from gridslam.inference.beliefs.layout import HEADING
from gridslam.world.geometry import wrap

Rows = NDArray[np.intp]


class Beside(NamedTuple):
    """A Gaussian of K numbers beside a joint belief of N: mean, covariance, covariance with the belief."""

    mean: Array
    covariance: Array
    cross: Array


def following(one: Beside, before: Belief, after: Belief, rows: tuple[Rows, Rows] | None = None) -> Beside:
    """What stands beside a joint belief, once that has become `after`, by whatever it was updated with.

    With G = cross cov(before)^-1, means move by G times what the belief's moved by, covariances by
    G (change of the belief's) G^T; what is new in it is independent of them, given the rest.

    Parameters
    ----------
    rows : ((R,), (R,)), optional
        Entries of `before` that are in `after` still, and where. Default: all, at the same places.
    """
    own, there = rows if rows is not None else (np.arange(len(before.mean)),) * 2
    known = before.covariance[np.ix_(own, own)]
    gain = solved(known, one.cross[:, own].T).T
    shift = after.mean[there] - before.mean[own]
    turning = (own == HEADING) | ((own >= before.layout.head) & ((own - before.layout.head) % 2 == 0))
    shift[turning] = wrap(shift[turning])
    covariance = one.covariance + gain @ (after.covariance[np.ix_(there, there)] - known) @ gain.T
    return Beside(one.mean + gain @ shift, 0.5 * (covariance + covariance.T), gain @ after.covariance[there])
