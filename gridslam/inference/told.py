"""What the anchors' measurements said of their rays in one step, kept for coefficients and cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.evaluation import Evaluation
from gridslam.inference.heard import Heard
from gridslam.inference.rays import Rays
from gridslam.kernels import tables

Array = NDArray[np.float64]


class Part(NamedTuple):
    """What one anchor's measurements said.

    Attributes
    ----------
    heard : Heard
    rays : Rays
    distance : (L,) m
    said : Evaluation
    share : (K,)
        Probability of each pair's association.
    """

    heard: Heard
    rays: Rays
    distance: Array
    said: Evaluation
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
        """Join what all anchors said; its rays last until the next time."""
        before, path, amplitude = 0, [], []
        for part in parts:
            pairs = part.said.pairs
            path.append(pairs.path + before)
            amplitude.append(part.heard.table[pairs.measurement, 6])
            before += len(part.rays)
        odds = np.concatenate([part.said.odds for part in parts], 1)
        rays = Rays.stack([part.rays for part in parts])
        table = runtime.scratch("told rays", rays.table.shape, np.int32)
        table[:] = rays.table
        paths, share = np.concatenate(path), np.concatenate([part.share for part in parts])
        return cls(
            replace(rays, table=table),
            np.concatenate([part.distance for part in parts]),
            odds[tables.CHANCE],
            odds[tables.WORTH],
            np.bincount(paths, share, before).astype(np.float64, copy=False),
            paths,
            np.array([np.concatenate(amplitude), share]),
        )
