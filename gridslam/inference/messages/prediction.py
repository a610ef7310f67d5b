"""Predicted paths, linearised at the mean of the belief, and their existence one step ahead; owner of that
kernel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.state.particles import Draft, Recipe, Sampling
from gridslam.inference.state.rays import P_APPEAR, P_STAY, Rays, listed_at_most
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.world.filter_model import FilterModel

Array = NDArray[np.float64]
EVERY_ANCHOR = -1
AS_THEY_ARE = 1.0, 0.0
"""Probabilities that a ray stays, and that one appears, within no time."""


@dataclass(frozen=True)
class Prediction:
    """Predicted parameters of paths at the mean of the belief.

    Attributes
    ----------
    whole : (L, 13)
        All of the following, as the kernel leaves them.
    """

    whole: Array

    @property
    def value(self) -> Array:
        """Distance with clocks (m), AoD and AoA relative to anchor and heading (rad), (L, 3)."""
        return self.whole[:, :3]

    @property
    def spread(self) -> Array:
        """Covariance from the belief alone, (L, 3, 3)."""
        return self.whole[:, 3:12].reshape(-1, 3, 3)

    @property
    def length(self) -> Array:
        """How long the paths are, m, (L,)."""
        return self.whole[:, 12]


class PathBuffers(NamedTuple):
    """Reusable buffers for the paths that a kernel lists.

    Attributes
    ----------
    table, existence, surfaces, predicted : (most, 4), (most,), (most,), (most, 13)
        Paths, existence of ray and of surfaces, and prediction.
    found : (1,) int32
        How many there are.
    """

    table: NDArray[np.int32]
    existence: Array
    surfaces: Array
    predicted: Array
    found: NDArray[np.int32]

    @classmethod
    def of(cls, most: int) -> Self:
        """Room for so many."""
        table, found = np.empty((most, 4), np.int32), np.empty(1, np.int32)
        return cls(table, np.empty(most), np.empty(most), np.empty((most, 13)), found)


@dataclass(frozen=True)
class PathQuery:
    """Arguments of a kernel that lists and predicts paths and draws samples.

    Attributes
    ----------
    before : tuple
        Its first arguments, up to the points of the samples.
    sampling : Sampling
    buffers : PathBuffers
    among : (int, int)
        How many surfaces and anchors there are.
    recipe : Recipe
        How to draw the particles; filled in by the kernel.
    """

    before: tuple[Any, ...]
    sampling: Sampling
    buffers: PathBuffers
    among: tuple[int, int]
    recipe: Recipe

    @classmethod
    def of(
        cls, state: State, anchor: int, model: FilterModel, samples: int, number: int, work: Workspace,
        change: tuple[float, float] = (P_STAY, P_APPEAR),
    ) -> Self:  # fmt: skip
        """Arguments for all listed paths of `anchor`; the next query of that anchor reuses the buffers.

        Parameters
        ----------
        samples, number : int
            How many exact samples are drawn, and by which points; see `Particles.samples`.
        change : (float, float)
            Probabilities that a ray stays, and that one appears.
        """
        bank, belief, anchors = state.surfaces, state.belief, model.anchors
        surfaces, places = len(bank), len(anchors)
        bank.check(belief, places, len(state.los))
        if anchor >= places:
            raise ValueError("there is no such anchor")
        most = (places if anchor == EVERY_ANCHOR else 1) * listed_at_most(surfaces, model.max_bounces)
        buffers = work.buffers(PathBuffers.of, anchor, most)
        draft = work.buffers(Draft.of, anchor, belief.layout, samples)
        sampling = work.particles.samples(belief, number, draft)
        count, bandwidth = work.particles.ask(belief)
        before = (
            anchor, model.max_bounces, *change, belief.mean, belief.covariance, belief.layout.head, anchors,
            bank.existence, bank.owner, state.los, bank.single, bank.double, _share(bandwidth),
            sampling.points, sampling.first,
        )  # fmt: skip
        recipe = Recipe(belief.layout, draft.root, draft.base, sampling.points, count, bandwidth)
        return cls(before, sampling, buffers, (surfaces, places), recipe)

    def attempts(self) -> Iterator[tuple[Any, ...]]:
        """The kernel's arguments; if it finds the covariance singular, once more otherwise."""
        for way in self.sampling.attempts():
            yield (*self.before, *way, *self.buffers)

    def paths(self) -> PredictedPaths:
        """The listed and predicted paths."""
        count = int(self.buffers.found[0])
        found = self.buffers
        rays = Rays(found.table[:count], found.existence[:count], found.surfaces[:count], self.among)
        return PredictedPaths(rays, Prediction(found.predicted[:count]), self.recipe)


@dataclass(frozen=True)
class PredictedPaths:
    """Paths of one anchor, or of all, as they are predicted.

    Attributes
    ----------
    rays : Rays
        L of them, with their existence one step ahead.
    prediction : Prediction
    recipe : Recipe
        How to draw the particles at which they are evaluated.
    """

    rays: Rays
    prediction: Prediction
    recipe: Recipe

    def __len__(self) -> int:
        return len(self.rays)


@timed("evaluation")
def predict_paths(state: State, anchor: int, model: FilterModel, *, work: Workspace) -> PredictedPaths:
    """All listed paths of `anchor`, one step ahead; the next query of that anchor reuses the arrays."""
    return _listed(PathQuery.of(state, anchor, model, 0, 0, work))


def paths_now(state: State, model: FilterModel, *, work: Workspace) -> Rays:
    """All listed paths of all anchors, anchor by anchor, with their present existence."""
    return _listed(PathQuery.of(state, EVERY_ANCHOR, model, 0, 0, work, AS_THEY_ARE)).rays


def _listed(query: PathQuery) -> PredictedPaths:
    runtime.start()
    from gridslam.kernels.propagation.rays import list_paths

    for arguments in query.attempts():
        list_paths(*arguments)
    return query.paths()


@lru_cache(16)
def _share(bandwidth: float) -> float:
    """Share of the covariance's root that particles are drawn with."""
    return math.sqrt(1 - bandwidth)
