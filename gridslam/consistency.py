"""Whether a filter knows how wrong it is, and how a run goes step by step."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from gridslam.estimates import Estimate
from gridslam.geometry import line_through, sfv, wrap
from gridslam.metrics import OSPA_CUTOFF_M, ospa
from gridslam.scene import Scene
from gridslam.simulate import Truth

Array = NDArray[np.float64]


def nees(error: ArrayLike, covariance: ArrayLike) -> Array:
    """Normalised estimation error squared, e^T P^-1 e.

    Of a consistent Gaussian filter it is chi-square distributed with D degrees of freedom, mean D. Where the
    covariance is singular, an error in a direction that it excludes makes it infinite.

    Parameters
    ----------
    error : (..., D)
        Estimate minus truth; angles wrapped.
    covariance : (..., D, D)

    Returns
    -------
    (...) float64
    """
    value, vector = np.linalg.eigh(np.asarray(covariance, float))
    square = np.einsum("...ij,...i->...j", vector, np.asarray(error, float)) ** 2
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        each = np.where(square > 0, square / np.maximum(value, 0), 0.0)
    return np.asarray(each.sum(-1))


def nees_band(runs: int, dimension: int, share: float = 0.95) -> tuple[float, float]:
    """Band in which the mean NEES of independent runs lies with probability `share`, if they are consistent.

    Parameters
    ----------
    runs : int
        N runs, at least 1: N times the mean is chi-square with ``N * dimension`` degrees of freedom.
    dimension : int
        D, the number of components of the error.
    share : float
        Between 0 and 1.
    """
    low, high = chi2.ppf([0.5 - share / 2, 0.5 + share / 2], runs * dimension) / runs
    return float(low), float(high)


def complaints(estimates: Sequence[Estimate]) -> dict[str, int]:
    """What filters said was amiss, and at how many steps, most frequent first; "#" stands for numbers."""
    said = Counter(
        re.sub(r"[\d.]+", "#", reason) for e in estimates for reason in e.health.why.split("; ") if reason
    )
    return dict(said.most_common())


@dataclass(frozen=True, eq=False)
class Steps:
    """How a run went, step by step.

    Attributes
    ----------
    position_error_m : (N,) m
    heading_error_rad : (N,) rad
        Estimate minus truth, wrapped.
    position_nees, heading_nees : (N,)
        Normalised squared errors with 2 and 1 degrees of freedom.
    surface_ospa_m : (N,) m
        Of the surface feature vectors of the detected surfaces (5 m, order 1), against the surfaces that some
        path hit up to that step.
    surfaces : (N,) int
        How many are detected.
    surface_error_m : (S, N) m
        Error of each surface of `surfaces_heard`: of the detected one that the best assignment gives it, NaN
        where it gives none within 5 m.
    rays : (J, N) int
        Paths of each anchor that the filter holds for existing.
    ray_belief : (J, N)
        Sum of their existence probabilities.
    """

    position_error_m: Array
    heading_error_rad: Array
    position_nees: Array
    heading_nees: Array
    surface_ospa_m: Array
    surfaces: NDArray[np.intp]
    surface_error_m: Array
    rays: NDArray[np.intp]
    ray_belief: Array


def follow(estimates: Sequence[Estimate], scene: Scene, truth: Truth, earlier: Sequence[Truth] = ()) -> Steps:
    """Compare a run with the truth, step by step.

    Parameters
    ----------
    estimates : N estimates
        One per step of the truth's track, or of its beginning.
    scene : Scene
    truth : Truth
    earlier : sequence of Truth
        Of the agents whose map this one started from: their surfaces count as there to be found.
    """
    count = len(estimates)
    position = np.array([e.position_m for e in estimates]) - truth.trajectory.position_m[:count]
    heading = wrap(np.array([e.heading_rad for e in estimates]) - truth.trajectory.heading_rad[:count])
    covariance = np.array([e.covariance for e in estimates])
    feature, since = surfaces_heard(truth, earlier)
    found = [e.surfaces.take(e.detected) for e in estimates]
    rays = np.zeros((len(scene.anchors), count), np.intp)
    belief, apart = np.zeros(rays.shape), np.full((len(feature), count), np.nan)
    for step, estimate in enumerate(estimates):
        chance = estimate.paths.existence
        believed = chance > scene.filter.detect_above
        owner = estimate.paths.anchor[believed]
        rays[:, step] = np.bincount(owner, minlength=len(rays))
        belief[:, step] = np.bincount(owner, chance[believed], len(rays))
        apart[:, step] = assigned_error(found[step].sfv_m, feature)
    return Steps(
        np.linalg.norm(position, axis=1),
        heading,
        nees(position, covariance[:, :2, :2]),
        nees(heading[:, None], covariance[:, 4:, 4:]),
        np.array([ospa(f.sfv_m, feature[since <= step], OSPA_CUTOFF_M) for step, f in enumerate(found)]),
        np.array([len(f) for f in found], np.intp),
        apart,
        rays,
        belief,
    )


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
    distance = np.linalg.norm(found[:, None] - truth[None], axis=-1)
    which, whom = linear_sum_assignment(np.minimum(distance, cutoff))
    error = np.full(len(truth), np.nan)
    error[whom] = distance[which, whom]
    return np.where(error < cutoff, error, np.nan)


def surfaces_heard(truth: Truth, earlier: Sequence[Truth] = ()) -> tuple[Array, NDArray[np.intp]]:
    """Surfaces that some path hits: feature vectors (S, 2) in m, and the first step of each (S,).

    Surfaces that an earlier agent heard are there from step 0 on. They come in the order of their numbers in
    ``truth.segments``, as in `gridslam.bounds.MapBound`.
    """
    walls = truth.segments
    first = np.full(int(walls.surface.max(initial=-1)) + 1, len(truth.trajectory), np.intp)
    for one in (truth, *earlier):
        paths, hit = one.paths, one.paths.segment >= 0
        step = paths.step if one is truth else np.zeros_like(paths.step)
        np.minimum.at(first, walls.surface[paths.segment[hit]], np.repeat(step, hit.sum(1)))
    heard = np.flatnonzero(first < len(truth.trajectory))
    piece = np.array([np.flatnonzero(walls.surface == surface)[0] for surface in heard], np.intp)
    if not len(piece):
        return np.zeros((0, 2)), piece
    return sfv(line_through(walls.start[piece], walls.end[piece])), first[heard]


def true_rays(scene: Scene, agent: str, truth: Truth, above: float = 0.0) -> NDArray[np.intp]:
    """Number of visible paths per anchor and step whose detection probability is above `above`, (J, N)."""
    paths, count = truth.paths, np.zeros((len(scene.anchors), len(truth.trajectory)), np.intp)
    likely = scene.signal_model(agent).detection_probability(paths.amplitude) > above
    np.add.at(count, (paths.anchor[likely], paths.step[likely]), 1)
    return count
