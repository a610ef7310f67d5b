"""Rays: every path that a set of surfaces could make to one anchor, and its existence over time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arrays import Array

Whole = NDArray[np.int32]
P_STAY, P_APPEAR = 0.95, 0.005
"""A ray that exists stays so for a step; one that doesn't appears (docs/model.md, (M20))."""


def listed_at_most(surfaces: int, bounces: int) -> int:
    """How many paths of one anchor there can be: line of sight, single and double bounces."""
    return 1 + surfaces * (surfaces if bounces > 1 else 1)


@dataclass(frozen=True)
class Rays:
    """Paths, anchor by anchor: line of sight first, then single, then double bounces.

    Attributes
    ----------
    table : (L, 4) int32
        Number of bounces, surfaces hit last and first (-1 for none), and anchor, as kernels take them.
    existence : (L,) float64
        Predicted existence q' of the ray alone.
    surfaces : (L,) float64
        Product of the existences of the surfaces involved.
    among : (int, int), optional
        How many surfaces and anchors the table was made of, if that is known: it names no other ones.
    """

    table: Whole
    existence: Array
    surfaces: Array
    among: tuple[int, int] | None = None

    def __len__(self) -> int:
        return len(self.table)

    @classmethod
    def of(
        cls, anchor: ArrayLike, bounces: ArrayLike, last: ArrayLike, first: ArrayLike, existence: Array,
        surfaces: Array,
    ) -> Rays:  # fmt: skip
        """Rays from columns of the table, (L,) each or one number for all."""
        table = np.empty((len(existence), 4), np.int32)
        table[:, 0], table[:, 1], table[:, 2], table[:, 3] = bounces, last, first, anchor
        return cls(table, existence, surfaces)

    @property
    def bounces(self) -> Whole:
        """Number of bounces, (L,)."""
        return self.table[:, 0]

    @property
    def last(self) -> Whole:
        """Surface hit last, -1 for none, (L,)."""
        return self.table[:, 1]

    @property
    def first(self) -> Whole:
        """Surface hit first, -1 for none, (L,)."""
        return self.table[:, 2]

    @property
    def anchor(self) -> Whole:
        """Anchor, (L,)."""
        return self.table[:, 3]

    def check(self, surfaces: int, anchors: int | None = None) -> None:
        """Refuse rays of a surface or anchor that isn't there: a kernel would read past its arrays.

        Parameters
        ----------
        surfaces, anchors : int
            How many there are; of anchors, None for a kernel that looks at none.
        """
        most_surfaces, most_anchors = self.among or self._named
        if most_surfaces > surfaces:
            raise ValueError("a ray names a surface that doesn't exist")
        if anchors is not None and most_anchors > anchors:
            raise ValueError("a ray names an anchor that doesn't exist")

    @cached_property
    def _named(self) -> tuple[int, int]:
        """How many surfaces and anchors there must be at least."""
        most = self.table.max(0, initial=-1)
        return int(max(most[1], most[2])) + 1, int(most[3]) + 1
