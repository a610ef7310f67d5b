"""The surfaces that there were to be found, and how near the found ones are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.estimate_tables import SurfaceEstimate
from gridslam.evaluation.metrics import OSPA_CUTOFF_M, gospa, ospa
from gridslam.simulation.image_source import Truth
from gridslam.world.geometry import Segments, gap_to_origin, line_through, moved_lines, sfv

MATCHED_M = 0.5
"""Distance of feature vectors within which a surface that was found is a true one."""
FAR_M = 10.0
"""Gap between the origin and all walls from which on feature vectors aren't taken from it."""
NEVER = np.iinfo(np.intp).max


@dataclass(frozen=True, eq=False)
class AudibleSurfaces:
    """Surfaces that some visible path hit, in the order of their numbers in ``Truth.segments``.

    A window shares the surface of its wall. To the paths, every facet of a curved wall is a surface of its
    own, but the wall is there once: any number of straight lines may stand for it, each for one facet.

    Attributes
    ----------
    feature : (S, 2) float64, m
        Surface feature vectors.
    curve : (S,) int
        Curved wall of which the surface is a facet; -1 for a straight wall.
    since : (S, J) int
        First step at which a path of each anchor hits the surface; `NEVER` if none does.
    every : (W, 2) float64, m
        Feature vectors of all surfaces of the world, those that no path hits, too.
    middle : (2,) float64, m
        About where feature vectors are taken, see `middle_of_walls`.
    """

    feature: Array
    curve: NDArray[np.intp]
    since: NDArray[np.intp]
    every: Array
    middle: Array

    @classmethod
    def of(cls, truth: Truth, earlier: Sequence[Truth] = ()) -> Self:
        """Surfaces that an agent's paths hit, or those of the agents whose map it started from.

        The latter are there from step 0 on. J is the number of anchors up to the last that has a path.
        """
        walls, every = truth.segments, (truth, *earlier)
        anchors = max((int(one.paths.anchor.max(initial=-1)) for one in every), default=-1) + 1
        first = np.full((int(walls.surface.max(initial=-1)) + 1, anchors), NEVER, np.intp)
        for one in every:
            path, bounce = np.nonzero(one.paths.segment >= 0)
            step = one.paths.step[path] if one is truth else 0
            surface = walls.surface[one.paths.segment[path, bounce]]
            np.minimum.at(first, (surface, one.paths.anchor[path]), step)
        curve = np.full(len(first), NEVER, np.intp)
        np.minimum.at(curve, walls.surface, walls.curve)  # a facet in line with a straight wall is part of it
        hit = np.flatnonzero((first < NEVER).any(1))
        number, piece = np.unique(walls.surface, return_index=True)
        middle = middle_of_walls(walls)
        line, _ = moved_lines(line_through(walls.start[piece], walls.end[piece]), -middle)
        feature = sfv(line)
        return cls(feature[np.searchsorted(number, hit)], curve[hit], first[hit], feature, middle)

    def vectors(self, found: SurfaceEstimate) -> Array:
        """Feature vectors (F, 2) of found surfaces about the same place, m."""
        return found.sfv_m if not self.middle.any() else sfv(moved_lines(found.line, -self.middle)[0])

    @property
    def first(self) -> NDArray[np.intp]:
        """First step at which a path of any anchor hits each surface, (S,)."""
        return np.asarray(self.since.min(1, initial=NEVER))

    def count(self, step: int = NEVER - 1) -> int:
        """How many are there at a step (default: ever): straight ones, and each curved wall once."""
        there = self.curve[self.first <= step]
        return int((there < 0).sum() + len(np.unique(there[there >= 0])))

    def ospa(self, found: SurfaceEstimate, step: int = NEVER - 1) -> float:
        """OSPA (5 m, order 1) of found surfaces against those there at a step (default: ever), m.

        Lines that serve one anchor each (virtual anchors) are judged anchor by anchor, against the surfaces
        that paths of this anchor hit, and the mean is taken over the anchors that have either: else each
        wall that two anchors found would count as a wall and a ghost.
        """
        return self._compared(ospa, found, step)

    def gospa(self, found: SurfaceEstimate, step: int = NEVER - 1) -> float:
        """GOSPA [Rahmathullah2017gospa] of the same sets (5 m, order 1, alpha 2), m, anchor by anchor, too.

        It is a sum: distances of the surfaces that are found, and 2.5 m for each that is missing or false.
        """
        return self._compared(gospa, found, step)

    def _compared(self, metric: Callable[..., float], found: SurfaceEstimate, step: int) -> float:
        """A distance of found surfaces from those there at a step, m."""
        there = self.since <= step
        if not (found.owner >= 0).any():
            return self._distance(metric, self.vectors(found), np.asarray(there.any(1)))
        each = []
        for anchor in np.union1d(np.arange(there.shape[1]), found.owner[found.owner >= 0]):
            own = there[:, anchor] if anchor < there.shape[1] else np.zeros(len(there), bool)
            mine = (found.owner == anchor) | (found.owner < 0)
            if own.any() or mine.any():
                each.append(self._distance(metric, self.vectors(found)[mine], own))
        return float(np.mean(each))

    def matched(self, found: SurfaceEstimate) -> int:
        """How many of them some found surface lies at, one for each: within 0.5 m as feature vectors."""
        from scipy.optimize import linear_sum_assignment

        distance = np.linalg.norm(self.vectors(found)[:, None] - self.feature, axis=-1)
        which, whom = linear_sum_assignment(np.minimum(distance, OSPA_CUTOFF_M))
        there = self.curve[whom[distance[which, whom] < MATCHED_M]]
        return int((there < 0).sum() + len(np.unique(there[there >= 0])))

    def false(self, found: SurfaceEstimate) -> NDArray[np.bool_]:
        """Which found surfaces (F,) lie at no wall: 0.5 m or more as feature vectors from each of the world.

        That of an earlier agent's map may be one that no path of this world's agents hits.
        """
        distance = np.linalg.norm(self.vectors(found)[:, None] - self.every, axis=-1)
        return np.asarray(distance.min(1, initial=np.inf) >= MATCHED_M)

    def _distance(self, metric: Callable[..., float], found: Array, there: NDArray[np.bool_]) -> float:
        """Distance from some of the surfaces; of a curved wall, the facets that lines were found for."""
        from scipy.optimize import linear_sum_assignment

        feature, curve = self.feature[there], self.curve[there]
        distance = np.linalg.norm(found[:, None] - feature, axis=-1)
        which, whom = linear_sum_assignment(np.minimum(distance, OSPA_CUTOFF_M))
        wanted = curve < 0
        wanted[whom[distance[which, whom] < OSPA_CUTOFF_M]] = True
        for wall in np.setdiff1d(curve, curve[wanted]):
            wanted[np.argmax(curve == wall)] = True  # missed: once
        return metric(found, feature[wanted], OSPA_CUTOFF_M, 1.0)


def middle_of_walls(walls: Segments) -> Array:
    """About where feature vectors are compared, (2,) m: the origin, or the walls' middle if that is far off.

    They are twice as far from the origin as their lines: beside it, half a metre is no angle at all.
    """
    ends = np.concatenate([walls.start, walls.end])
    if not len(ends):
        return np.zeros(2)
    low, high = ends.min(0), ends.max(0)
    return np.round(0.5 * (low + high)) if gap_to_origin(low, high) > FAR_M else np.zeros(2)


def assigned_error(found: Array, truth: Array, cutoff: float = OSPA_CUTOFF_M) -> Array:
    """Distance of each true point to the estimate that the cheapest assignment gives it.

    Parameters
    ----------
    found, truth : (M, 2) and (S, 2), m
    cutoff : float, m

    Returns
    -------
    (S,) m
        NaN where no estimate is left for it, or none nearer than the cutoff.
    """
    from scipy.optimize import linear_sum_assignment

    distance = np.linalg.norm(found[:, None] - truth[None], axis=-1)
    which, whom = linear_sum_assignment(np.minimum(distance, cutoff))
    error = np.full(len(truth), np.nan)
    error[whom] = distance[which, whom]
    return np.where(error < cutoff, error, np.nan)


def surface_scores(found: SurfaceEstimate, truth: Truth) -> dict[str, float | int]:
    """Compare detected surfaces with all that the truth's paths hit: how many, how many found, how far off.

    Several found at the facets of one curved wall count once as matched, and none of them as false.
    """
    audible = AudibleSurfaces.of(truth)
    return {
        "surfaces_matched": audible.matched(found),
        "surfaces_true": audible.count(),
        "surfaces_false": int(audible.false(found).sum()),
        "surface_ospa_m": audible.ospa(found),
        "surface_gospa_m": audible.gospa(found),
    }


def false_surfaces(found: SurfaceEstimate | None, truth: Truth) -> NDArray[np.bool_] | None:
    """Which of a map's surfaces lie at no wall."""
    return None if found is None else AudibleSurfaces.of(truth).false(found)
