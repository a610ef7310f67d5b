"""Paths as predicted, linearised at the mean of the belief, and their existence one step ahead; owner of that
kernel. Agent and surfaces are predicted in `motion`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Self

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.beliefs.particles import Recipe, Sampling, draft_of
from gridslam.inference.state.rays import P_APPEAR, P_STAY, Rays, listed_at_most
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels import STATE_GIVEN
from gridslam.kernels.primitives import blocks
from gridslam.kernels.primitives.blocks import ROOTED, Draft, Links, Listed, Query
from gridslam.kernels.primitives.tables import COVARIANCE, LENGTH, PREDICTED, UNCLEAR
from gridslam.world.filter_model import FilterModel

ListArguments = tuple[Query, blocks.Belief, Array, Links, Draft, Listed]
"""Of a kernel that lists paths."""
EVERY_ANCHOR = -1
AS_THEY_ARE = 1.0, 0.0
"""Probabilities that a ray stays, and that one appears, within no time."""


@dataclass(frozen=True)
class Prediction:
    """Predicted parameters of paths at the mean of the belief.

    Attributes
    ----------
    whole : (L, 15)
        All of the following, as the kernel leaves them.
    """

    whole: Array

    @property
    def value(self) -> Array:
        """Distance with clocks (m), AoD and AoA relative to anchor and heading (rad), (L, 3)."""
        return self.whole[:, :COVARIANCE]

    @property
    def spread(self) -> Array:
        """Covariance from the belief alone, (L, 3, 3)."""
        return self.whole[:, COVARIANCE:LENGTH].reshape(-1, 3, 3)

    @property
    def length(self) -> Array:
        """How long the paths are, m, (L,)."""
        return self.whole[:, LENGTH]

    @property
    def length_std(self) -> Array:
        """Deviation of that, m, (L,)."""
        return np.asarray(np.sqrt(self.whole[:, UNCLEAR]))


def listed_buffers(most: int) -> Listed:
    """Reusable buffers for so many paths that a kernel lists."""
    table, found = np.empty((most, 4), np.int32), np.empty(1, np.int32)
    return Listed(table, np.empty(most), np.empty(most), np.empty((most, PREDICTED)), found)


def query_of(
    asked: Query, only: int, bounces: int, sampling: Sampling, change: tuple[float, float], share: float,
    senders: int = 1,
) -> Query:  # fmt: skip
    """Which paths a kernel lists and how, and what it draws; what of it is at hand is told at each launch.

    Parameters
    ----------
    asked : Query
        Filled in, since new arrays would have to be handed over at every launch.
    """
    asked.choice[:] = only, bounces, sampling.head, sampling.first, 0, senders
    asked.weight[:] = *change, share
    return asked


def query_buffers() -> Query:
    """Reusable buffers for a query."""
    return Query(np.empty(6, np.int32), np.empty(3))


def links_of(bank: SurfaceBank, los: Array) -> Links:
    """Existence of surfaces and rays, as kernels take it."""
    return Links(bank.existence, bank.owner, los, bank.single, bank.double)


@dataclass(frozen=True)
class PathQuery:
    """Arguments of a kernel that lists and predicts paths and draws samples.

    Attributes
    ----------
    query : Query
    belief : Belief
    places : (J, 6)
        x, y (m), orientation (rad) and height above the agent (m) of the anchors.
    links : Links
    sampling : Sampling
    buffers : Listed
    among : (int, int)
        How many surfaces and anchors there are.
    recipe : Recipe or None
        How to draw the particles, if any are; filled in by the kernel.
    """

    query: Query
    belief: blocks.Belief
    places: Array
    links: Links
    sampling: Sampling
    buffers: Listed
    among: tuple[int, int]
    recipe: Recipe | None

    @classmethod
    def of(
        cls, state: State, anchor: int, model: FilterModel, samples: int, number: int, work: Workspace,
        change: tuple[float, float] = (P_STAY, P_APPEAR),
    ) -> Self:  # fmt: skip
        """Arguments for all listed paths of `anchor` and its images; its next query reuses the buffers.

        Parameters
        ----------
        samples, number : int
            How many exact samples are drawn, and by which points; see `Particles.samples`.
        change : (float, float)
            Probabilities that a ray stays, and that one appears.
        """
        bank, belief, anchors = state.surfaces, state.belief, model.places
        surfaces, places = len(bank), len(anchors)
        bank.check(belief, places, len(state.los))
        if anchor >= model.senders:
            raise ValueError("there is no such anchor")
        listed = places if anchor == EVERY_ANCHOR else places // model.senders
        most = listed * listed_at_most(surfaces, model.max_bounces)
        buffers = work.buffers(listed_buffers, anchor, most)
        draft = work.buffers(draft_of, anchor, belief.layout, samples)
        sampling = work.particles.samples(belief, number, draft)
        count, bandwidth = work.particles.ask(belief)
        asked = work.buffers(query_buffers, anchor)
        query = query_of(asked, anchor, model.max_bounces, sampling, change, _share(bandwidth), model.senders)
        own, links = blocks.Belief(belief.mean, belief.covariance), links_of(bank, state.los)
        recipe = Recipe(belief.layout, draft.root, draft.base, sampling.points, count, bandwidth)
        return cls(query, own, anchors, links, sampling, buffers, (surfaces, places), recipe)

    def attempts(self) -> Iterator[ListArguments]:
        """The kernel's arguments; if it finds the covariance singular, once more otherwise."""
        for rooted, draft in self.sampling.attempts():
            self.query.choice[ROOTED] = rooted
            yield self.query, self.belief, self.places, self.links, draft, self.buffers

    def bare(self) -> ListArguments:
        """The kernel's arguments if nothing is to be drawn: it takes no root of the covariance."""
        self.query.choice[ROOTED] = STATE_GIVEN
        return self.query, self.belief, self.places, self.links, self.sampling.draft, self.buffers

    def paths(self, work: Workspace) -> PredictedPaths:
        """The listed and predicted paths, once the kernel has run."""
        count, (path, existence, surfaces, predicted, _) = int(self.buffers.found[0]), self.buffers
        assert self.recipe is not None
        rays = Rays(work.first_rows(path, count), existence[:count], surfaces[:count], self.among)
        return PredictedPaths(rays, Prediction(work.first_rows(predicted, count)), self.recipe)


@dataclass(frozen=True)
class PredictedPaths:
    """Paths of one anchor, or of all, as they are predicted.

    Attributes
    ----------
    rays : Rays
        L of them, with their existence one step ahead.
    prediction : Prediction
    recipe : Recipe
        How to draw the particles at which they are evaluated; without meaning if none are.
    """

    rays: Rays
    prediction: Prediction
    recipe: Recipe

    def __len__(self) -> int:
        return len(self.rays)


@timed("evaluation")
def predict_paths(state: State, anchor: int, model: FilterModel, *, work: Workspace) -> PredictedPaths:
    """All listed paths of `anchor`, one step ahead, (M20), (M21); its next query reuses the arrays."""
    return _listed(PathQuery.of(state, anchor, model, 0, 0, work), work)


@timed("evaluation")
def predict_every_path(state: State, model: FilterModel, *, work: Workspace) -> PredictedPaths:
    """As `predict_paths` of all anchors, if no particles are drawn: the covariance may be singular."""
    return _listed(PathQuery.of(state, EVERY_ANCHOR, model, 0, 0, work), work, drawn=False)


def paths_now(state: State, model: FilterModel, *, work: Workspace) -> Rays:
    """All listed paths of all anchors, anchor by anchor, with their present existence."""
    query = PathQuery.of(state, EVERY_ANCHOR, model, 0, 0, work, AS_THEY_ARE)
    return _listed(query, work, drawn=False).rays


def _listed(query: PathQuery, work: Workspace, drawn: bool = True) -> PredictedPaths:
    list_paths = listing()
    for arguments in query.attempts() if drawn else [query.bare()]:
        list_paths(*arguments)
    return query.paths(work)


@lru_cache(16)
def _share(bandwidth: float) -> float:
    """Share of the covariance's root that particles are drawn with."""
    return math.sqrt(1 - bandwidth)


@runtime.once_started
def listing() -> Any:
    """The kernel that lists and predicts paths."""
    from gridslam.kernels.propagation.rays import list_paths

    return list_paths
