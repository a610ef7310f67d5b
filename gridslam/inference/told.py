"""What the anchors' measurements said of their rays in one step, kept for coefficients and cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.evaluation import Pairs
from gridslam.inference.heard import Heard
from gridslam.inference.rays import Rays

Array = NDArray[np.float64]


class Part(NamedTuple):
    """What one anchor's measurements said.

    Attributes
    ----------
    heard : Heard
    rays : Rays
    distance, chance, worth : (L,)
        See `Told`.
    pairs : Pairs
    share : (K,)
        Probability of each pair's association.
    """

    heard: Heard
    rays: Rays
    distance: Array
    chance: Array
    worth: Array
    pairs: Pairs
    share: Array


@dataclass(frozen=True)
class Told:
    """Rays of all anchors, and their associations.

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
    def by(cls, parts: Sequence[Part]) -> Told:
        """Join what all anchors said."""
        before = np.cumsum([0, *(len(part.rays) for part in parts)]).tolist()
        rays = Rays.stack([part.rays for part in parts])
        share = np.concatenate([part.share for part in parts])
        path = np.concatenate(
            [part.pairs.path + start for part, start in zip(parts, before[:-1], strict=True)]
        )
        amplitude = np.concatenate([part.heard.table[part.pairs.measurement, 6] for part in parts])
        return cls(
            rays,
            np.concatenate([part.distance for part in parts]),
            np.concatenate([part.chance for part in parts]),
            np.concatenate([part.worth for part in parts]),
            np.bincount(path, share, len(rays)).astype(np.float64, copy=False),
            path,
            np.array([amplitude, share]),
        )
