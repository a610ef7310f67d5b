"""Whether a filter knows how wrong it is, and how a run goes step by step."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri

from gridslam.arrays import Array
from gridslam.estimate_tables import PathEstimate
from gridslam.estimates import Estimate
from gridslam.evaluation.metrics import OSPA_CUTOFF_M, ospa
from gridslam.evaluation.surface_truth import AudibleSurfaces, assigned_error
from gridslam.simulation.image_source import TruePaths, Truth
from gridslam.world.filter_model import detected
from gridslam.world.geometry import unit, wrap
from gridslam.world.scene import Scene

FIGURE = re.compile(r"-?\d+(?:\.\d+)?")
SILENT = 4.0
"""Claimed deviations of the position from which on a filter should have said that something is amiss."""
SHARE = 0.95
"""Probability with which a mean NEES of consistent filters lies in its band."""
ABOUT_ANCHOR = re.compile(r"anchor .* seems turned by ")


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


def nees_band(runs: int, dimension: int) -> tuple[float, float]:
    """Band in which the mean NEES of independent runs lies with probability `SHARE`, if they are consistent.

    Parameters
    ----------
    runs : int
        N runs, at least 1: N times the mean is chi-square with ``N * dimension`` degrees of freedom.
    dimension : int
        D, the number of components of the error.
    """
    # quantiles of chi-square; `scipy.stats` takes half a second to import
    low, high = chdtri(runs * dimension, [0.5 + SHARE / 2, 0.5 - SHARE / 2]) / runs
    return float(low), float(high)


def complaints(estimates: Sequence[Estimate]) -> dict[str, int]:
    """What filters said was amiss, and at how many steps, most frequent first.

    Complaints that differ by their figures alone count as one: told are the median and range of the first
    figure. Anchors are kept apart by name.
    """
    grouped: dict[str, list[tuple[float, str, str]]] = defaultdict(list)
    for reason in (reason for e in estimates for reason in e.health.why.split("; ") if reason):
        named = ABOUT_ANCHOR.match(reason)  # digits of a name are no figures
        head, rest = (named[0], reason[named.end() :]) if named else ("", reason)
        figure = FIGURE.search(rest)
        shown = figure[0] if figure else ""
        grouped[head + FIGURE.sub("#", rest)].append((float(shown or 0), shown, reason))
    counts = {}
    for group in sorted(grouped.values(), key=len, reverse=True):
        ranked = sorted(group)
        (low, first, _), (_, _, middle), (high, last, _) = ranked[0], ranked[len(ranked) // 2], ranked[-1]
        counts[middle if low == high else f"{middle}, median of {first} to {last}"] = len(group)
    return counts


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
    position_claimed_m : (N,) m
        What the filter holds that error for: the root of the trace of the position's covariance.
    surface_ospa_m : (N,) m
        Of the surface feature vectors of the detected surfaces (5 m, order 1), against the surfaces that some
        path hit up to that step (`gridslam.evaluation.surface_truth.AudibleSurfaces.ospa`).
    image_ospa_m : (N,) m
        Of the virtual anchors of the paths held for existing, single and double bounces, against those of the
        visible ones (5 m, order 1), anchor by anchor and averaged over those that have either. As in
        [Li2025adaptive], Fig. 4b, it compares methods whether a surface of theirs serves one anchor or all.
    surfaces : (N,)
        How many are detected; a line that serves one anchor alone counts as a J-th.
    surface_error_m : (S, N) m
        Error of each of the `AudibleSurfaces`: of the detected one that the best assignment gives it, NaN
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
    position_claimed_m: Array
    surface_ospa_m: Array
    image_ospa_m: Array
    surfaces: Array
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
    audible = AudibleSurfaces.of(truth, earlier)
    found = [e.surfaces.take(e.detected) for e in estimates]
    rays = np.zeros((len(scene.anchors), count), np.intp)
    belief, apart = np.zeros(rays.shape), np.full((len(audible.feature), count), np.nan)
    image, place = np.zeros(count), truth.trajectory
    for step, estimate in enumerate(estimates):
        chance = estimate.paths.existence
        believed = detected(chance, scene.filter)
        owner = estimate.paths.anchor[believed]
        rays[:, step] = np.bincount(owner, minlength=len(rays))
        belief[:, step] = np.bincount(owner, chance[believed], len(rays))
        apart[:, step] = assigned_error(audible.vectors(found[step]), audible.feature)
        held = estimate.paths.take(believed)
        there = truth.paths.at(step)
        if scene.clocks is not None or scene.has_heights:  # distances hold offsets and heights, places don't
            held = replace(held, distance_m=_lengths(held.points))
        if scene.has_heights:
            there = replace(there, distance_m=_lengths(there.points))
        image[step] = _image_ospa(
            virtual_anchors(held, estimate.position_m, estimate.heading_rad),
            virtual_anchors(there, place.position_m[step], place.heading_rad[step]),
        )
    return Steps(
        np.linalg.norm(position, axis=1),
        heading,
        nees(position, covariance[:, :2, :2]),
        nees(heading[:, None], covariance[:, 4:, 4:]),
        np.sqrt(np.trace(covariance[:, :2, :2], axis1=1, axis2=2)),
        np.array([audible.ospa(f, step) for step, f in enumerate(found)]),
        image,
        np.array([np.where(f.owner < 0, 1.0, 1 / len(rays)).sum() for f in found]),
        apart,
        rays,
        belief,
    )


def silent_steps(estimates: Sequence[Estimate], steps: Steps) -> int:
    """At how many steps the position is off by more than four claimed deviations while health is well.

    The deviation is the root of the trace of the position's covariance, as `Steps.position_claimed_m`.
    """
    return wrong_and_well(estimates, steps.position_error_m, steps.position_claimed_m)


def wrong_and_well(estimates: Sequence[Estimate], error_m: Array, claimed_m: Array) -> int:
    """As `silent_steps`, by errors and claimed deviations of the position, (N,) each, m."""
    well = np.array([one.health.ok for one in estimates], bool)
    return int((well & (error_m > SILENT * claimed_m)).sum())


def virtual_anchors(
    paths: PathEstimate | TruePaths, position_m: Array, heading_rad: Array | float
) -> tuple[Array, NDArray[np.intp]]:
    """Where the reflected paths of one step seem to come from: the mirror images of their anchors.

    Parameters
    ----------
    paths : PathEstimate or TruePaths
        Those in line of sight are left out.
    position_m, heading_rad : (2,), float
        Of the agent to which distance and AoA belong.

    Returns
    -------
    images : (L, 2) float64, m
    anchor : (L,) int
    """
    bent = np.isfinite(paths.points[:, 1, 0])
    toward = unit(heading_rad + paths.aoa_rad[bent])
    return position_m + paths.distance_m[bent, None] * toward, paths.anchor[bent]


def _lengths(points: Array) -> Array:
    """Lengths (L,) in m of ways over points (L, 4, 2); NaN for a bounce that isn't there."""
    way = points.copy()
    for corner in (1, 2):
        way[:, corner] = np.where(np.isnan(way[:, corner]), way[:, corner - 1], way[:, corner])
    return np.asarray(np.linalg.norm(np.diff(way, axis=1), axis=-1).sum(1))


def _image_ospa(found: tuple[Array, NDArray[np.intp]], truth: tuple[Array, NDArray[np.intp]]) -> float:
    each = [
        ospa(found[0][found[1] == anchor], truth[0][truth[1] == anchor], OSPA_CUTOFF_M)
        for anchor in np.union1d(found[1], truth[1])
    ]
    return float(np.mean(each)) if each else 0.0


def true_rays(scene: Scene, agent: str, truth: Truth, above: float = 0.0) -> NDArray[np.intp]:
    """Number of visible paths per anchor and step whose detection probability is above `above`, (J, N)."""
    paths, count = truth.paths, np.zeros((len(scene.anchors), len(truth.trajectory)), np.intp)
    likely = scene.signal_model(agent).detection_probability(paths.amplitude) > above
    np.add.at(count, (paths.anchor[likely], paths.step[likely]), 1)
    return count
