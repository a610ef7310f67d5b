"""Exact data association, by dynamic programming over the sets of measurements that are taken.

Loopy belief propagation is sure too early of who caused which when two paths are nearly equally long: on
average it pushes their lengths apart by a third of the noise, step by step as long as they cross (two paths
half a deviation apart; see test_rings.py). With angles paths are hardly ever that close; with distances
alone they are all the time. The exact marginals push nothing, and few measurements make them cheap.
"""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.association import associate

MOST_CONTESTED = 12
"""Measurements that paths may claim, above which belief propagation is used instead."""
NEGLIGIBLE = 1e-6
"""A measurement that no path claims by more than this, over none, is left out."""


def associate_exactly(beta: Array, missed: Array, new: Array) -> tuple[Array, Array]:
    """As `association.associate`, but exact.

    Parameters
    ----------
    beta : (L, M)
        Message of every path for "caused measurement m".
    missed : (L,) > 0
        Message of every path for "caused none".
    new : (M,) > 0
        Message of every measurement for "caused by no legacy path".

    Returns
    -------
    (nu, claimed)
        nu (L, M): ``beta nu / (missed + sum beta nu)`` are the exact marginals; claimed (M,):
        ``new / (new + claimed)`` is the exact probability that no path caused m.
    """
    odds = beta / (missed[:, None] * new)
    contested = np.flatnonzero((odds > NEGLIGIBLE).any(0))
    count = len(contested)
    if count > MOST_CONTESTED:
        return associate(beta, missed, new)
    odds = odds[:, contested]
    nu, claimed = np.broadcast_to(1 / new, beta.shape).copy(), np.zeros(len(new))
    if not count:
        return nu, claimed
    # sets of taken measurements as bits; ahead[l] sums over the paths before l, behind[l] over the others
    bits, sets = 1 << np.arange(count), np.arange(1 << count)
    free = (sets[:, None] & bits) == 0
    grown = sets[:, None] | bits
    ahead, behind = np.zeros((len(odds) + 1, len(sets))), np.ones((len(odds) + 1, len(sets)))
    ahead[0, 0] = 1.0
    for path, row in enumerate(odds):
        ahead[path + 1] = ahead[path]
        for m in range(count):
            ahead[path + 1, grown[free[:, m], m]] += row[m] * ahead[path, free[:, m]]
    for path in range(len(odds) - 1, -1, -1):
        behind[path] = behind[path + 1] + (free * behind[path + 1][grown]) @ odds[path]
    without = (ahead[:-1] * behind[1:]).sum(1)
    taking = np.stack(
        [(ahead[:-1, free[:, m]] * behind[1:, grown[free[:, m], m]]).sum(1) for m in range(count)], 1
    )
    nu[:, contested] = taking / without[:, None] / new[contested]
    total = ahead[-1].sum()
    idle = (ahead[-1] @ free) / total
    claimed[contested] = new[contested] * (1 - idle) / np.maximum(idle, 1e-12)
    return nu, claimed
