"""What the anchors' measurements said of their rays in one step, kept for coefficients and cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.evaluation import Pairs
from gridslam.inference.heard import Heard
from gridslam.inference.rays import Rays

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Told:
    """Rays of one or more anchors, and their associations.

    Attributes
    ----------
    rays : Rays
    distance : (L,) m
    chance : (L,)
        Probability that the path is there to be heard.
    worth : (L,)
        Mean of ``sum_m nu_m g_m + 1 - p_d``.
    share : (L,)
        Probability that the path caused a measurement.
    path : (K,) int32
        Path of each association.
    said : (2, K)
        Measured amplitude, negative for none, and probability of each.
    """

    rays: Rays
    distance: Array
    chance: Array
    worth: Array
    share: Array
    path: NDArray[np.int32]
    said: Array

    @classmethod
    def of(
        cls,
        heard: Heard,
        rays: Rays,
        distance: Array,
        chance: Array,
        worth: Array,
        pairs: Pairs,
        share: Array,
    ) -> Told:
        """What one anchor's measurements said; `share` (K,) is the probability of each pair."""
        said = np.stack([heard.table[pairs.measurement, 6], share])
        total = np.bincount(pairs.path, share, len(rays)).astype(np.float64)
        return cls(rays, distance, chance, worth, total, pairs.path, said)

    @classmethod
    def stack(cls, parts: Sequence[Told]) -> Told:
        """Join what several anchors said."""
        before = np.cumsum([0, *(len(part.rays) for part in parts)]).tolist()
        return cls(
            Rays.stack([part.rays for part in parts]),
            np.concatenate([part.distance for part in parts]),
            np.concatenate([part.chance for part in parts]),
            np.concatenate([part.worth for part in parts]),
            np.concatenate([part.share for part in parts]),
            np.concatenate([part.path + start for part, start in zip(parts, before[:-1], strict=True)]),
            np.concatenate([part.said for part in parts], 1),
        )
