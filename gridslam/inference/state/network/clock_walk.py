"""How far clocks walk, as it is learned: filters side by side with a walk each; docs/model.md, (M331)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

SHARES: Array = np.append(0.0, np.geomspace(1e-4, 1.0, 9))
"""Of the variance that the scene tells: none, and walks of a hundredth of its own up to its own."""
STILL = 0.03
"""Probability beforehand that clocks stand still; else any walk up to the one told is as likely."""
PRIOR: Array = np.append(STILL, (1 - STILL) * np.sqrt(SHARES[1:]) / np.sqrt(SHARES[1:]).sum())
"""Of the shares: each stands for as much of the walks as it is apart from the next."""
WAYS = 3
"""Anchors' clocks among themselves, agents' among themselves, and those against these."""
ALIKE: Array = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1]], np.float64
)
"""Groups of ways in which clocks may walk by the same."""
GROUPINGS: Array = np.array(
    [
        [1, 1, 1, 0, 0, 0, 0],
        [0, 0, 1, 1, 0, 0, 0],
        [0, 1, 0, 0, 1, 0, 0],
        [1, 0, 0, 0, 0, 1, 0],
        [0, 0, 0, 0, 0, 0, 1],
    ],
    np.float64,
)
"""Of which groups all three ways can consist; each is as likely beforehand."""


@dataclass(frozen=True, eq=False)
class ClockWalk:
    """Filters of D clocks in three ways of walking, with G walks each.

    Attributes
    ----------
    log : (3, G)
        Log likelihood of each walk, 0 for the best.
    mean : (3, G, D) m
        Of the clocks, in the part of them that is the way's.
    variance : (3, G) m^2
        In each of the way's directions.
    free : (D,) bool
        Which clocks these are about.
    time_s : float
    """

    log: Array
    mean: Array
    variance: Array
    free: NDArray[np.bool_]
    time_s: float

    @property
    def weight(self) -> Array:
        """Probability of each walk, (3, G).

        Ways in which clocks walk by the same are judged together; whether they do is judged, too.
        """
        log = ALIKE @ self.log
        best = log.max(1, keepdims=True)
        each = np.exp(log - best) * PRIOR
        whole = each.sum(1, keepdims=True)
        grouping = GROUPINGS @ (best + np.log(whole))[:, 0]
        chance = np.exp(grouping - grouping.max())
        of_groups = chance @ GROUPINGS / chance.sum()
        return np.asarray((ALIKE * of_groups[:, None]).T @ (each / whole))

    @property
    def share(self) -> Array:
        """Share of the variance that the scene tells by which clocks walk in each way, the mean, (3,).

        Of a way in which nothing was weighed yet, as of agents that are heard in turns, it is all of it.
        """
        return np.where(self.log.any(1), self.weight @ SHARES, 1.0)


def ways_of(anchors: int, free: NDArray[np.bool_], common: bool) -> Array:
    """Projections onto the ways in which some of the clocks can walk, (3, D, D); 0 for a way that they can't.

    Whatever walks treat anchors alike and agents alike are sums of these three, and of what all clocks
    have in common.

    Parameters
    ----------
    anchors : int
        J, whose clocks stand first.
    free : (D,) bool
    common : bool
        Whether the last is to hold what they all have in common.
    """
    return _ways_of(anchors, tuple(free.tolist()), common)


@lru_cache(64)
def _ways_of(anchors: int, free: tuple[bool, ...], common: bool) -> Array:
    there = np.array(free)
    of_anchors = np.arange(len(free)) < anchors
    sides = np.stack([there & of_anchors, there & ~of_anchors])
    means = sides / np.sqrt(np.maximum(sides.sum(1, keepdims=True), 1))  # in which all of a side walk alike
    among = [
        np.diag(side.astype(float)) - np.outer(mean, mean) for side, mean in zip(sides, means, strict=True)
    ]
    against = means.T @ means
    if not common:
        everyone = there / np.sqrt(max(int(there.sum()), 1))
        against = against - np.outer(everyone, everyone)
    ways = np.stack([*among, against])
    ways.setflags(write=False)
    return ways
