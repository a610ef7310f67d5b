"""What the anchors' measurements said of their rays in one step, kept for coefficients and cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.heard import Heard
from gridslam.inference.rays import Rays

Array = NDArray[np.float64]
FAINT = 1e-3
"""Probability of an association below which it says nothing about coefficients."""


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
    path : (K,) int
        Path of each association that comes with an amplitude.
    amplitude, weight : (K,)
        Measured amplitude and probability of each.
    """

    rays: Rays
    distance: Array
    chance: Array
    worth: Array
    share: Array
    path: NDArray[np.intp]
    amplitude: Array
    weight: Array

    @classmethod
    def of(
        cls, heard: Heard, rays: Rays, distance: Array, chance: Array, worth: Array, responsible: Array
    ) -> Told:
        """What one anchor's measurements said; `responsible` is (L, M)."""
        path, measurement = np.nonzero((responsible > FAINT) & ~np.isnan(heard.amplitude))
        return cls(
            rays, distance, chance, worth, responsible.sum(1), path, heard.amplitude[measurement],
            responsible[path, measurement],
        )  # fmt: skip

    @classmethod
    def stack(cls, parts: Sequence[Told]) -> Told:
        """Join what several anchors said."""
        before = np.cumsum([0, *(len(part.rays) for part in parts)])
        joined = {
            f.name: np.concatenate([getattr(part, f.name) for part in parts])
            for f in fields(cls)
            if f.name not in ("rays", "path")
        }
        path = np.concatenate([part.path + start for part, start in zip(parts, before[:-1], strict=True)])
        return cls(rays=Rays.stack([part.rays for part in parts]), path=path, **joined)
