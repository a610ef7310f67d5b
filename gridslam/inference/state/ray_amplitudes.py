"""Amplitudes of rays as a value: a histogram per ray, and the length of its path at the last update."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.state.rays import Rays

Key = tuple[int, int, int]
"""Anchor, and identities of the surfaces that a ray meets last and first (-1 for none)."""


@dataclass(frozen=True, eq=False)
class RayAmplitudes:
    """Amplitude beliefs of all rays.

    Attributes
    ----------
    known : mapping of (int, int, int) to ((K,) float64, float)
        By anchor, and the identities of the surfaces met last and first: probability of every node, and
        length of the path (m). Never changed in place.
    """

    known: Mapping[Key, tuple[Array, float]] = field(default_factory=dict)

    def having(self, changes: Mapping[Key, tuple[Array, float]]) -> RayAmplitudes:
        """The amplitudes with some of the beliefs replaced or added."""
        return RayAmplitudes({**self.known, **changes}) if changes else self

    def among(self, alive: NDArray[np.int64]) -> RayAmplitudes:
        """The amplitudes without the rays of surfaces that are no more."""
        living = {-1, *alive.tolist()}
        gone = [key for key in self.known if key[1] not in living or key[2] not in living]
        if not gone:
            return self
        return RayAmplitudes({key: value for key, value in self.known.items() if key not in set(gone)})

    @staticmethod
    def keys(rays: Rays, identity: NDArray[np.int64]) -> list[Key]:
        """Keys of rays over surfaces of these identities."""
        named = np.append(identity, -1)
        return list(
            zip(rays.anchor.tolist(), named[rays.last].tolist(), named[rays.first].tolist(), strict=True)
        )
