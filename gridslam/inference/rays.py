"""Rays: every path that a set of surfaces could make to one anchor, and its existence over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.surfaces import Bank

Array = NDArray[np.float64]
P_STAY, P_APPEAR = 0.95, 0.005
"""A ray that exists stays so for a step; one that doesn't appears (model.md, section 2.6 (a))."""


@dataclass(frozen=True)
class Rays:
    """Paths of one anchor: line of sight first, then single, then double bounces.

    Attributes
    ----------
    anchor : (L,) int
    bounces, last, first : (L,) int
        Number of bounces; surfaces hit last and first (-1 for none).
    existence : (L,) float64
        Predicted existence q' of the ray alone.
    surfaces : (L,) float64
        Product of the existences of the surfaces involved.
    """

    anchor: NDArray[np.intp]
    bounces: NDArray[np.intp]
    last: NDArray[np.intp]
    first: NDArray[np.intp]
    existence: Array
    surfaces: Array

    def __len__(self) -> int:
        return len(self.bounces)

    @cached_property
    def table(self) -> NDArray[np.int32]:
        """Bounces, last and first surface, and anchor of every ray, as kernels take them, (L, 4)."""
        table = np.empty((len(self), 4), np.int32)
        table[:, 0], table[:, 1], table[:, 2] = self.bounces, self.last, self.first
        table[:, 3] = self.anchor
        return table

    def check(self, surfaces: int, anchors: int) -> None:
        """Refuse rays of a surface or anchor that isn't there: a kernel would read past its arrays."""
        if self._highest[0] >= surfaces:
            raise ValueError("a ray names a surface that doesn't exist")
        if self._highest[1] >= anchors:
            raise ValueError("a ray names an anchor that doesn't exist")

    @cached_property
    def _highest(self) -> tuple[int, int]:
        """Largest number of a surface and of an anchor."""
        most = self.table.max(0, initial=-1)
        return int(max(most[1], most[2])), int(most[3])

    @classmethod
    def stack(cls, tables: Sequence[Rays]) -> Rays:
        """Join the rays of several anchors."""
        return cls(*(np.concatenate([getattr(t, f.name) for t in tables]) for f in fields(cls)))

    def take(self, rows: NDArray[np.intp]) -> Rays:
        """Some of the rays."""
        return Rays(*(getattr(self, f.name)[rows] for f in fields(self)))


def rays_of(bank: Bank, sight: Array, anchor: int, most_bounces: int) -> Rays:
    """All paths worth a look from `anchor`, with their existence predicted one step ahead.

    Parameters
    ----------
    sight : (J,)
        Existence of every anchor's line of sight.
    """
    own = np.flatnonzero((bank.owner == -1) | (bank.owner == anchor))
    strong = np.flatnonzero(bank.existence > 0.3)
    last, first = (a.ravel() for a in np.meshgrid(strong, strong, indexing="ij"))
    other = last != first
    last, first = last[other], first[other]
    if most_bounces < 2:
        last = first = last[:0]
    bounces = np.repeat([0, 1, 2], [1, len(own), len(last)])
    memory = np.concatenate([[sight[anchor]], bank.single[anchor, own], bank.double[anchor, last, first]])
    settled = P_APPEAR / (1 - P_STAY + P_APPEAR)
    memory = settled + (memory - settled) * (P_STAY - P_APPEAR)
    product = np.concatenate([[1.0], bank.existence[own], bank.existence[last] * bank.existence[first]])
    return Rays(
        np.full(len(bounces), anchor),
        bounces,
        np.concatenate([[-1], own, last]).astype(np.intp),
        np.concatenate([[-1], own, first]).astype(np.intp),
        memory,
        product,
    )


def rays_now(bank: Bank, sight: Array, most_bounces: int) -> Rays:
    """All paths worth a look from any anchor, anchor by anchor, with their existence as it is now."""
    anchors = np.arange(len(sight))
    anchor, own = np.nonzero((bank.owner == -1) | (bank.owner == anchors[:, None]))
    strong = bank.existence > 0.3
    pairs = strong[:, None] & strong & ~np.eye(len(bank), dtype=bool) & (most_bounces > 1)
    among, last, first = np.nonzero(np.broadcast_to(pairs, bank.double.shape))
    none = np.full(len(anchors), -1)
    table = Rays(
        np.concatenate([anchors, anchor, among]),
        np.repeat([0, 1, 2], [len(anchors), len(own), len(last)]),
        np.concatenate([none, own, last]),
        np.concatenate([none, own, first]),
        np.concatenate([sight, bank.single[anchor, own], bank.double[among, last, first]]),
        np.concatenate(
            [np.ones(len(anchors)), bank.existence[own], bank.existence[last] * bank.existence[first]]
        ),
    )
    return table.take(np.argsort(table.anchor, kind="stable"))


def short_rays(bank: Bank, sight: Array) -> Rays:
    """Lines of sight and single bounces of all anchors, as they are now."""
    anchors, count = bank.single.shape
    anchor, surface = np.repeat(np.arange(anchors), count + 1), np.tile(np.arange(-1, count), anchors)
    chance = np.concatenate([[1.0], bank.existence])[surface + 1]
    owner = np.concatenate([[-1], bank.owner])[surface + 1]
    existence = np.concatenate([sight[:, None], bank.single], 1).ravel()
    own = (owner == -1) | (owner == anchor)
    return Rays(anchor, (surface >= 0).astype(np.intp), surface, surface, existence, chance * own)


def remember(bank: Bank, sight: Array, rays: Rays, anchor: int, worth: Array, validity: Array) -> None:
    """Update the rays' existence by what their measurements said (model.md, section 2.6 (a)).

    Parameters
    ----------
    sight : (J,)
        Existence of every anchor's line of sight, updated in place like the bank's rays.
    worth : (L,)
        Mean of ``sum_m nu_m g_m + 1 - p_d`` of every path.
    validity : (L,)
        V: a ray that the grid blocks is not judged by its silence.
    """
    chance = rays.surfaces * validity
    ahead = chance * worth + 1 - chance
    after = rays.existence * ahead / (rays.existence * ahead + 1 - rays.existence)
    sight[anchor] = after[0]
    single, double = rays.bounces == 1, rays.bounces == 2
    bank.single[anchor, rays.last[single]] = after[single]
    bank.double[anchor, rays.last[double], rays.first[double]] = after[double]
