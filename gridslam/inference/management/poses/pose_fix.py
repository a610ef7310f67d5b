"""The pose that explains a scan: proposed by the measurements themselves, scored against the map.

Each path that is heard with distance and both angles fixes a whole pose, if one knows over which surface it
came. All such poses are tried; the likelihood of a scan is that of a Poisson process of paths and clutter
(every measurement may come from any path or from none). docs/model.md, (M576).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import OF_POSE, POSE
from gridslam.inference.management.poses.scan_terms import ScanTerms, loudest_rows
from gridslam.inference.messages.amplitudes import DetectionTable
from gridslam.inference.messages.path_prediction import paths_now
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.arrangement import unparked
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import direction, level_of, mirror, slant, unit, wrap
from gridslam.world.radio import REFLECTION_BINS, RadioModel
from gridslam.world.scene_parts import GridSpec

COPIES, DRAWN, REFINED = 10, 150, 400
"""Draws per hypothesis, of the belief, and about the best pose."""
MODE_M, MODE_RAD = 0.6, 0.45
"""Poses closer than this are one mode."""
CLEAR, WORTH = 5.0, 8.0
"""Log-likelihood by which a mode must beat the next one, and the pose that was believed."""
BLOCK = 200_000
"""Poses x images x measurements that are scored at a time."""


@dataclass(frozen=True)
class Sources:
    """Images of one anchor over the surfaces at the belief's mean: where its paths seem to come from.

    Attributes
    ----------
    image : (L, 2) m
    line : (L, 2)
        Surface hit; the line of sight's is never used.
    level : (L,)
        Coefficient of the path.
    chance : (L,)
        Probability that the path is there.
    """

    image: Array
    line: Array
    level: Array
    chance: Array


def sources(rays: Rays, belief: Belief, places: Array, coefficient: Array) -> list[Sources]:
    """Lines of sight and single bounces of anchors at `places` (J, 2), by surfaces' coefficients (S,)."""
    every = np.concatenate([belief.lines, np.zeros((1, 2))])
    found = []
    for anchor, place in enumerate(places):
        own = (rays.anchor == anchor) & (rays.bounces < 2) & (rays.surfaces > 0.5)
        straight, last = rays.bounces[own] == 0, rays.last[own]
        image = np.where(straight[:, None], place, mirror(every[last], place))
        level = np.where(straight, 1.0, np.append(coefficient, 1.0)[last])
        chance = np.clip(rays.existence[own] * rays.surfaces[own], 0.2, 0.95)
        found.append(Sources(image, every[last], level, chance))
    return found


def known_sources(state: State, model: FilterModel, *, work: Workspace) -> list[Sources]:
    """Lines of sight and single bounces over all surfaces, parked ones among them: it may be anywhere."""
    whole = unparked(state)
    rays = paths_now(whole, replace(model, max_bounces=1), work=work)
    level = whole.surfaces.reflection @ REFLECTION_BINS
    return sources(rays, whole.belief, model.anchor_positions[: model.senders], level)


@dataclass(frozen=True)
class Fix:
    """A pose that explains a scan.

    Attributes
    ----------
    pose : (3,) m, m, rad
    covariance : (3, 3)
        Of the mode.
    gain : float
        Log-likelihood above that of the best pose that was believed in.
    lead : float
        Log-likelihood above that of the next mode.
    """

    pose: Array
    covariance: Array
    gain: float
    lead: float

    @property
    def clear(self) -> bool:
        """Whether no other mode comes near."""
        return self.lead > CLEAR

    @property
    def better(self) -> bool:
        """Whether it explains the scan far better than what was believed."""
        return self.gain > WORTH


def find_pose(
    belief: Belief, expected: Belief, images: Sequence[Sources], scans: Sequence[AnchorScan],
    table: DetectionTable, radio: RadioModel, stream: list[int], region: GridSpec | None = None,
) -> Fix | None:  # fmt: skip
    """The pose that explains scans best, or None if no measurement proposes any.

    Parameters
    ----------
    belief : Belief
        Soft bound of the search.
    expected : Belief
        The belief unless a better pose is found.
    region : GridSpec, optional
        Where the agent may be at all.
    """
    draw = np.random.default_rng(stream)
    asked = _proposals(images, scans, radio, draw)
    if region is not None:
        asked = asked[region.holds(asked[:, :2])]
    sizes = (len(own.image) * max(len(scan), 1) for own, scan in zip(images, scans, strict=True))

    def likelihood(poses: Array) -> Array:
        parts = zip(images, scans, strict=True)
        return np.asarray(sum(_log_likelihood(poses, own, scan, table, radio) for own, scan in parts))

    return best_pose(belief, expected, asked, likelihood, max(sizes, default=1), draw)


def best_pose(
    belief: Belief, expected: Belief, asked: Array, likelihood: Callable[[Array], Array], largest: int,
    draw: np.random.Generator,
) -> Fix | None:  # fmt: skip
    """The pose of greatest likelihood, of those proposed (N, 3) and those that are believed in.

    Parameters
    ----------
    belief, expected : Belief
        As of `find_pose`.
    likelihood : callable
        Log-likelihoods (n,) of a scan at poses (n, 3).
    largest : int
        Numbers that it works out for one pose.
    """
    if not len(asked):
        return None
    mean, wide = belief.mean[POSE], belief.covariance[OF_POSE]
    narrow = expected.covariance[OF_POSE]
    # after a silence of days its entries differ by more than a double's digits, and can't be checked
    known = draw.multivariate_normal(mean, narrow, DRAWN, method="eigh", check_valid="ignore")
    bound = np.linalg.inv(wide + np.diag([0.1, 0.1, 0.1]))
    block = max(BLOCK // max(largest, 1), 1)

    def score(every: Array) -> Array:
        return np.concatenate([one(every[at : at + block]) for at in range(0, len(every), block)])

    def one(poses: Array) -> Array:
        gap = poses - mean
        gap[:, 2] = wrap(gap[:, 2])
        far = np.einsum("ni,ij,nj->n", gap, bound, gap)
        # heavy tails: what was believed may be wrong altogether
        return np.asarray(likelihood(poses) - 3.0 * np.log1p(far / 6))

    before, log = score(known), score(asked)
    poses, log = np.concatenate([known, asked]), np.concatenate([before, log])
    best = int(log.argmax())
    inside = _near(poses, poses[best])
    lead = float(log[best] - log[~inside].max(initial=-np.inf))
    pose, covariance = _moments(poses[inside], log[inside] - log[best])
    for _ in range(2):
        covariance = 2.0 * covariance + np.diag([0.02**2, 0.02**2, 0.02**2])
        fresh = draw.multivariate_normal(pose, covariance, REFINED, method="eigh")
        gap = fresh - pose
        density = -0.5 * np.einsum("ni,ij,nj->n", gap, np.linalg.inv(covariance), gap)
        value = score(fresh)
        lead += max(float(value.max() - log[best]), 0.0)
        log[best] = max(log[best], float(value.max()))
        weight = value - density
        pose, covariance = _moments(fresh, weight - weight.max())
    return Fix(pose, covariance, float(log[best] - before.max()), lead)


def _proposals(
    images: Sequence[Sources], scans: Sequence[AnchorScan], radio: RadioModel, draw: np.random.Generator
) -> Array:
    """Poses (N, 3) that the loud measurements stand for, over each surface they could have come by."""
    poses = [np.zeros((0, 3))]
    for own, scan in zip(images, scans, strict=True):
        rows, std = loudest_rows(scan, radio)
        if not len(rows):
            continue
        for copy in range(COPIES):
            value = scan.value[rows] + (copy > 0) * std * draw.standard_normal((len(rows), 3))
            leaving = scan.orientation + value[None, :, 1]
            straight = (own.image == scan.position).all(1)[:, None]
            back = np.where(straight, leaving + np.pi, 2 * own.line[:, 0, None] - leaving)
            level = level_of(value[None, :, :1], scan.height)
            place = own.image[:, None] - level * unit(back)
            poses.append(
                np.concatenate([place, wrap(back - value[None, :, 2])[..., None]], -1).reshape(-1, 3)
            )
    return np.concatenate(poses)


def _log_likelihood(
    poses: Array, own: Sources, scan: AnchorScan, table: DetectionTable, radio: RadioModel
) -> Array:
    """Log-likelihood (N,) of one anchor's measurements at poses (N, 3), relative to clutter alone."""
    back = direction(poses[:, None, :2], own.image[None])
    distance = slant(np.linalg.norm(poses[:, None, :2] - own.image[None], axis=-1), scan.height)
    straight = (own.image == scan.position).all(1)
    leaving = np.where(straight, back + np.pi, 2 * own.line[:, 0] - back) - scan.orientation
    normal, offset = unit(own.line[:, 0]), own.line[:, 1]
    sides = ((poses[:, :2] @ normal.T) - offset) * (normal @ scan.position - offset)
    there = own.chance * (straight | (sides > 0))
    strength = radio.amplitude(distance, own.level)
    log = -(there * table(strength)).sum(1)
    if not len(scan):
        return np.asarray(log)
    terms = ScanTerms.of(scan, radio)
    measured, variance = terms.measured, terms.variance
    predicted = (distance, leaving, back - poses[:, 2, None])
    square = np.zeros((len(poses), len(own.image), len(scan)))
    for axis, value in enumerate(predicted):
        gap = scan.value[:, axis] - value[..., None]
        gap = gap if axis == 0 else wrap(gap)
        square += np.where(measured[:, axis], gap**2 / variance[:, axis], 0.0)
    square += terms.misfit(strength)
    constant = np.where(measured, np.log(terms.flat / np.sqrt(2 * np.pi * variance)), 0.0).sum(1)
    ratio = np.exp(np.minimum(constant + terms.tail - np.log(radio.false_alarms) - 0.5 * square, 60.0))
    return np.asarray(log + np.log1p((there[..., None] * ratio).sum(1)).sum(1))


def _near(poses: Array, centre: Array) -> NDArray[np.bool_]:
    apart = np.linalg.norm(poses[:, :2] - centre[:2], axis=1)
    return np.asarray((apart < MODE_M) & (np.abs(wrap(poses[:, 2] - centre[2])) < MODE_RAD))


def _moments(poses: Array, log: Array) -> tuple[Array, Array]:
    weight = np.exp(log)
    weight /= weight.sum()
    turned = poses.copy()
    turned[:, 2] = poses[weight.argmax(), 2] + wrap(poses[:, 2] - poses[weight.argmax(), 2])
    mean = weight @ turned
    gap = turned - mean
    return mean, np.asarray((weight[:, None] * gap).T @ gap)
