"""How far clocks walk, as it is learned: filters side by side with a walk each; docs/model.md, (M331)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

SHARES: Array = np.geomspace(1e-4, 1.0, 9)
"""Of the variance that the scene tells: a walk of a hundredth of its own, up to its own."""
WAYS = 3
"""Anchors' clocks among themselves, agents' among themselves, and those against these."""


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
    def share(self) -> Array:
        """Share of the variance that the scene tells by which clocks walk in each way, the mean, (3,).

        Walks up to the one that is told are all as likely beforehand. Of a way in which nothing was weighed
        yet, as of agents that are heard in turns, it is all of it.
        """
        weight = np.exp(self.log) * np.sqrt(SHARES)
        return np.where(self.log.any(1), weight @ SHARES / weight.sum(1), 1.0)


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
