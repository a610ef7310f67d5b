"""Predicted parameters of paths, linearised at the mean of the belief; owner of that kernel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.state.belief import Belief
from gridslam.inference.state.particles import Particles, Recipe, Sampling
from gridslam.inference.state.rays import P_APPEAR, P_STAY, Rays, listed_at_most
from gridslam.inference.state.surface_bank import Bank

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """Predicted parameters of paths at the mean of the belief.

    Attributes
    ----------
    whole : (L, 12)
        Both of the following, as the kernel leaves them.
    """

    whole: Array

    @property
    def value(self) -> Array:
        """Distance (m), AoD and AoA relative to anchor and heading (rad), (L, 3)."""
        return self.whole[:, :3]

    @property
    def spread(self) -> Array:
        """Covariance from the belief alone, (L, 3, 3)."""
        return self.whole[:, 3:].reshape(-1, 3, 3)


@dataclass(frozen=True)
class Ahead:
    """Paths that a kernel lists and predicts, and samples that it draws along with them.

    Attributes
    ----------
    before : tuple
        Its first arguments, up to the points of the samples.
    sampling : Sampling
    table, existence, surfaces, predicted : (most, 4), (most,), (most,), (most, 12)
        Where it leaves paths, existence of ray and surfaces, and prediction.
    found : (1,) int32
        How many there are.
    site : str
        Whose paths these are.
    among : (int, int)
        How many surfaces and anchors there are.
    """

    before: tuple[Any, ...]
    sampling: Sampling
    table: NDArray[np.int32]
    existence: Array
    surfaces: Array
    predicted: Array
    found: NDArray[np.int32]
    site: str
    among: tuple[int, int]

    @classmethod
    def of(
        cls, bank: Bank, sight: Array, belief: Belief, anchors: Array, anchor: int, most_bounces: int,
        change: tuple[float, float], kept: float, samples: Sampling,
    ) -> Ahead:  # fmt: skip
        """What to ask a kernel, to which all anchors are -1; what it tells lasts until the next question.

        Parameters
        ----------
        change : (float, float)
            Probabilities that a ray stays, and that one appears.
        kept : float
            Share of the covariance that particles won't be drawn with.
        samples : Sampling
            Drawn along with them.
        """
        count, places = len(bank), len(anchors)
        bank.check(belief, places, len(sight))
        if anchor >= places:
            raise ValueError("there is no such anchor")
        most, site = (places if anchor < 0 else 1) * listed_at_most(count, most_bounces), f"paths {anchor}"
        told = runtime.lasting(site, most, lambda: _room(most))
        before = (
            anchor, most_bounces, *change, belief.mean, belief.covariance, anchors, bank.existence,
            bank.owner, sight, bank.single, bank.double, _share(kept), samples.points,
            samples.first,
        )  # fmt: skip
        return cls(before, samples, *told, site, (count, places))

    def attempts(self) -> Iterator[tuple[Any, ...]]:
        """What a kernel is told; if it finds the covariance singular, once more otherwise."""
        for way in self.sampling.attempts():
            yield (*self.before, *way, self.table, self.existence, self.surfaces, self.predicted, self.found)

    def paths(self) -> tuple[Rays, Prediction]:
        """What was listed and predicted."""
        count = int(self.found[0])
        table, predicted = runtime.lasting(
            f"listed {self.site}",
            (id(self.table), count),
            lambda: (self.table[:count], self.predicted[:count]),
        )
        rays = Rays(table, self.existence[:count], self.surfaces[:count], self.among)
        return rays, Prediction(predicted)


def look_ahead(
    bank: Bank, sight: Array, belief: Belief, anchors: Array, anchor: int, most_bounces: int,
    particles: Particles, number: int, samples: int,
) -> tuple[Ahead, Recipe]:  # fmt: skip
    """What to ask for all paths worth a look from `anchor`, with their existence one step ahead.

    Parameters
    ----------
    sight : (J,)
        Existence of every anchor's line of sight.
    anchors : (J, 3)
        x, y (m) and orientation (rad).
    particles : Particles
        How to draw these comes along, true once a kernel was asked.
    number, samples : int
        Of some exact samples; see `Particles.samples`.
    """
    if anchor < 0:
        raise ValueError("there is no such anchor")
    count, kept = particles.ask(belief)
    change = P_STAY, P_APPEAR
    few = particles.samples(belief, number, samples, f"samples {anchor}")
    ahead = Ahead.of(bank, sight, belief, anchors, anchor, most_bounces, change, kept, few)
    return ahead, Recipe(few.draft.root, few.draft.base, few.points, count, kept)


def foresee(
    bank: Bank, sight: Array, belief: Belief, anchors: Array, anchor: int, most_bounces: int,
    particles: Particles,
) -> tuple[Rays, Prediction, Recipe]:  # fmt: skip
    """All paths worth a look from `anchor`, one step ahead, as they are predicted; particles' recipe.

    This asks what `look_ahead` puts, by a launch for nothing else. What is told lasts until the anchor's
    paths are foreseen again.
    """
    ahead, recipe = look_ahead(bank, sight, belief, anchors, anchor, most_bounces, particles, 0, 0)
    return *_foreseen(ahead), recipe


def paths_now(
    bank: Bank, sight: Array, belief: Belief, anchors: Array, most_bounces: int, particles: Particles
) -> Rays:
    """All paths worth a look from any anchor, anchor by anchor, with their existence as it is now."""
    none, as_it_is = particles.samples(belief, 0, 0, "no samples"), (1.0, 0.0)
    return _foreseen(Ahead.of(bank, sight, belief, anchors, -1, most_bounces, as_it_is, 0.0, none))[0]


def _foreseen(ahead: Ahead) -> tuple[Rays, Prediction]:
    runtime.start()
    from gridslam.kernels.propagation.rays import foresee

    for arguments in ahead.attempts():
        foresee(*arguments)
    return ahead.paths()


@lru_cache(16)
def _share(kept: float) -> float:
    """Share of the covariance's root that particles are drawn with."""
    return math.sqrt(1 - kept)


def _room(most: int) -> tuple[NDArray[np.int32], Array, Array, Array, NDArray[np.int32]]:
    """Table, existence, surfaces and prediction of so many paths, and room for their number."""
    table, found = np.empty((most, 4), np.int32), np.empty(1, np.int32)
    return table, np.empty(most), np.empty(most), np.empty((most, 12)), found
