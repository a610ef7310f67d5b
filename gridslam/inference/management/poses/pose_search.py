"""Where the agent may be, by one scan and no map: all poses that explain it, as Gaussians with weights.

docs/model.md, section 14. Uniform poses and those that measurements stand for, taken as lines of sight, are
scored; the best of each neighbourhood are refined by importance sampling.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import OF_POSE, POSE
from gridslam.inference.management.poses.pose_score import AnchorTerms, PoseLikelihood
from gridslam.world.geometry import level_of, unit, wrap
from gridslam.world.scene_parts import GridSpec

POSES, COPIES, BEARINGS = 200_000, 20, 720
"""Uniform poses; draws per measurement that may be a line of sight, and bearings where it tells none."""
POSES_BY_MAP = 8_000
"""Uniform poses scored where a map helps: measurements over its surfaces propose others."""
REACH = 2.2
"""Standard deviations to which a prior is searched: a uniform one's half width is 1.7 of them."""
WIDEN = 2.0
"""Deviations are doubled while the poses are few."""
APART_M, APART_RAD = 0.5, 0.25
"""Poses nearer than this are one candidate."""
PORTION = 1024
"""Of the best poses that are looked through first; each further one is twice as large."""
ROUNDS, MOST_ROUNDS, SAMPLES, BROADER = 3, 7, 400, 1.5
EFFECTIVE, LEAST_POWER = 20.0, 1e-3
"""Samples that have to count for a Gaussian's covariance, as equal ones; power below which it is as it is."""
BEHIND, SHORTLIST = 14.0, 22.0
"""Log-likelihood behind the best at which a mode is dropped, and a candidate with doubled deviations."""
LEAST = np.array([0.01, 0.01, 0.005]) ** 2
"""Variances of a mode at least, m^2 and rad^2."""
AHEAD = 0.02
"""Standard deviation of the headings that are tried where no arrival tells one, rad: places alone differ."""
COVER = 0.5
"""Power of the likelihood that a mode's Gaussian covers: the scan is taken in once more, by the filter."""


@dataclass(frozen=True, eq=False)
class Modes:
    """Poses that explain a scan, best first.

    Attributes
    ----------
    pose : (K, 3) m, m, rad
    covariance : (K, 3, 3)
        Of the Gaussian that covers what the scan says near there.
    log_prior : (K,)
        Log of the prior's mass of that Gaussian: the weight before the scan is taken in.
    score : (K,)
        Log-likelihood of the scan at the best pose, in ratio to clutter.
    complete : bool
        Whether these are all; else there were too many to list.
    """

    pose: Array
    covariance: Array
    log_prior: Array
    score: Array
    complete: bool

    def __len__(self) -> int:
        return len(self.score)

    def take(self, rows: NDArray[np.intp]) -> Self:
        """Some of them."""
        return replace(
            self, pose=self.pose[rows], covariance=self.covariance[rows], log_prior=self.log_prior[rows],
            score=self.score[rows],
        )  # fmt: skip


def find_modes(
    likelihood: PoseLikelihood,
    prior: Belief,
    region: GridSpec,
    cap: int,
    stream: Sequence[int],
    poses: int = POSES,
) -> Modes:
    """All poses that explain a scan, within a prior and the region.

    A scan without arrivals tells no heading: that of the prior stands for all, with the prior's deviation.

    Parameters
    ----------
    prior : Belief
        Of which the agent's pose is used.
    cap : int
        Modes listed at most.
    stream : sequence of int
        Names the stream of random numbers.
    """
    draw = np.random.default_rng(list(stream))
    mean, covariance = prior.mean[POSE], prior.covariance[OF_POSE]
    headed, near_by = likelihood.tells_heading, covariance.copy()
    if not headed:
        near_by[2], near_by[:, 2], near_by[2, 2] = 0.0, 0.0, AHEAD**2
    within = Bounds.of(mean, near_by, region)
    anywhere = within.uniform(draw, poses)
    ahead = None if headed else float(mean[2])
    asked = [line_of_sight_poses(terms, draw, facing=ahead) for terms in likelihood.terms]
    asked += [
        reflected_poses(terms, draw, facing=ahead) for terms in likelihood.terms if terms.known is not None
    ]
    every = np.concatenate([anywhere, *(part[within.holds(part)] for part in asked)])
    log = likelihood.score(every, WIDEN)
    chosen, more = best_apart(every, log, SHORTLIST, 2 * cap)
    pose, spread, score = _refined(likelihood, within, every[chosen], draw)
    if not headed:
        pose[:, 2], spread[:, 2], spread[:, :, 2], spread[:, 2, 2] = mean[2], 0.0, 0.0, covariance[2, 2]
    distinct, _ = best_apart(pose, score, BEHIND, len(score), 0.5)
    complete = len(distinct) <= cap and not (more and _still_finds(pose, score))
    distinct = distinct[:cap]
    pose, spread = pose[distinct], spread[distinct]
    gap = pose - mean
    gap[:, 2] = wrap(gap[:, 2])
    known = covariance + np.diag(LEAST)
    far = np.einsum("ki,ij,kj->k", gap, np.linalg.inv(known), gap)
    mass = 0.5 * np.linalg.slogdet(spread)[1] - 0.5 * np.linalg.slogdet(known)[1] - 0.5 * far
    return Modes(pose, spread, np.minimum(mass, 0.0), score[distinct], complete)


@dataclass(frozen=True, eq=False)
class Bounds:
    """Box of poses, m, m, rad.

    Attributes
    ----------
    low, high : (3,)
        The angle's may reach beyond pi.
    """

    low: Array
    high: Array

    @classmethod
    def of(cls, mean: Array, covariance: Array, region: GridSpec) -> Bounds:
        """What a Gaussian reaches of the region, all of the region if it reaches none."""
        reach = REACH * np.sqrt(np.diagonal(covariance)) + np.sqrt(LEAST)
        reach[2] = min(reach[2], np.pi)
        low, high = mean - reach, mean + reach
        edges = np.transpose([region.x_m, region.y_m])
        low[:2], high[:2] = np.maximum(low[:2], edges[0]), np.minimum(high[:2], edges[1])
        if (low >= high).any():
            low[:2], high[:2] = edges
        return cls(low, high)

    def uniform(self, draw: np.random.Generator, count: int) -> Array:
        """Poses (count, 3)."""
        return draw.uniform(self.low, self.high, (count, 3))

    def holds(self, poses: Array) -> NDArray[np.bool_]:
        """Whether poses (N, 3) lie within, (N,)."""
        middle = 0.5 * (self.low[2] + self.high[2])
        there = np.abs(wrap(poses[:, 2] - middle)) <= 0.5 * (self.high[2] - self.low[2])
        for axis in (0, 1):
            there &= (poses[:, axis] >= self.low[axis]) & (poses[:, axis] <= self.high[axis])
        return np.asarray(there)


def line_of_sight_poses(
    terms: AnchorTerms, draw: np.random.Generator, copies: int = COPIES, bearings: int = BEARINGS,
    facing: float | None = None,
) -> Array:  # fmt: skip
    """Poses (N, 3) from which an anchor's measurements would be lines of sight.

    Parameters
    ----------
    copies, bearings : int
        Draws per measurement, and bearings where it tells none.
    facing : float, optional
        Heading where there is no arrival, rad; default: what has none isn't used.
    """
    measured = np.isfinite(terms.variance)
    far, departs, arrives = measured.T
    parts = [np.zeros((0, 3))]
    for rows, count in (
        (np.flatnonzero(far & departs & (arrives | (facing is not None))), copies),
        (np.flatnonzero(far & ~departs & arrives), bearings),
    ):
        std = np.sqrt(np.where(measured[rows], terms.variance[rows], 0.0))[:, None]
        noise = draw.standard_normal((len(rows), count, 3))
        noise[:, 0] = 0.0  # as it was measured, to begin with
        value = terms.value[rows][:, None] + std * noise
        if rows.size and not measured[rows[0], 1]:
            value[..., 1] = 2 * np.pi * (np.arange(count) + draw.random()) / count
        value = value.reshape(-1, 3)
        place = terms.position + level_of(value[:, :1], terms.height) * unit(value[:, 1])
        heading = _headed(value[:, 1] + np.pi - value[:, 2], np.repeat(arrives[rows], count), facing)
        parts.append(np.column_stack([place, heading]))
    return np.concatenate(parts)


def _headed(told: Array, arrives: NDArray[np.bool_], facing: float | None) -> Array:
    """Headings (N,) that arrivals tell; else those that stand for any."""
    return np.asarray(wrap(told if facing is None else np.where(arrives, told, facing)))


def reflected_poses(
    terms: AnchorTerms, draw: np.random.Generator, copies: int = 5, facing: float | None = None
) -> Array:
    """Poses (N, 3) from which an anchor's measurements would be single bounces over known surfaces.

    `facing` as for `line_of_sight_poses`.
    """
    assert terms.known is not None
    parts, measured = [np.zeros((0, 3))], np.isfinite(terms.variance)
    far, departs, arrives = measured.T
    rows = np.flatnonzero(far & departs & (arrives | (facing is not None)))
    std = np.sqrt(np.where(measured[rows], terms.variance[rows], 0.0))[:, None]
    for image, line in zip(terms.known.image, terms.known.line, strict=True):
        if (image == terms.position).all():
            continue
        noise = draw.standard_normal((len(rows), copies, 3))
        noise[:, 0] = 0.0
        value = (terms.value[rows][:, None] + std * noise).reshape(-1, 3)
        back = 2 * line[0] - value[:, 1]  # towards the image, by the law of reflection
        place = image - level_of(value[:, :1], terms.height) * unit(back)
        heading = _headed(back - value[:, 2], np.repeat(arrives[rows], copies), facing)
        parts.append(np.column_stack([place, heading]))
    return np.concatenate(parts)


def near(poses: Array, centre: Array, scale: float = 1.0) -> NDArray[np.bool_]:
    """Which poses (N, 3) are in the neighbourhood of one (3,)."""
    reach, there = scale * APART_M, np.zeros(len(poses), bool)
    beside = np.abs(poses[:, 0] - centre[0]) < reach
    beside &= np.abs(poses[:, 1] - centre[1]) < reach
    (rows,) = beside.nonzero()  # few, of which the rest takes longer
    x, y, turn = (poses[rows] - centre).T
    there[rows] = (np.hypot(x, y) < reach) & (np.abs(wrap(turn)) < scale * APART_RAD)
    return there


def best_apart(
    poses: Array, log: Array, behind: float, most: int, scale: float = 1.0
) -> tuple[list[int], bool]:
    """The best pose of each neighbourhood, best first, and whether there are more than `most`.

    Parameters
    ----------
    behind : float
        How far behind the best is left out.
    scale : float
        Of a neighbourhood.
    """
    (rows,) = (log > log.max() - behind).nonzero()
    rows = rows[np.argsort(-log[rows], kind="stable")]
    chosen, first, portion = list[int](), 0, PORTION
    while first < len(rows):  # where there are too many, the best portions name as many as are asked for
        left, first, portion = rows[first : first + portion], first + portion, 2 * portion
        places = poses[left]
        for one in chosen:
            others = ~near(places, poses[one], scale)
            left, places = left[others], places[others]
        while len(left):
            if len(chosen) == most:
                return chosen, True
            chosen.append(int(left[0]))
            others = ~near(places, places[0], scale)
            left, places = left[others], places[others]
    return chosen, False


def _still_finds(pose: Array, score: Array) -> bool:
    """Whether the last tenth of candidates (K, 3), the best first, led to likely places that no other led to.

    If it didn't, nor would those left out.
    """
    likely = score > score.max() - BEHIND
    last = np.arange(len(score)) >= len(score) - (len(score) // 10 + 1)
    known = pose[likely & ~last]
    return any(not near(known, one, 0.5).any() for one in pose[likely & last])


def _refined(
    likelihood: PoseLikelihood, within: Bounds, poses: Array, draw: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Means (K, 3), covariances (K, 3, 3) and best scores (K,) of the modes about poses (K, 3).

    By importance sampling from one Gaussian after the other, (M204): where a scan is exact against the width
    of the first, a step takes in as much of it as leaves enough samples that count. Where that ends on what
    all poses about a narrow mode share, as each measurement may be clutter, all of the scan is taken at once.
    """
    mean, covariance, best, settled = _sampled(likelihood, within, poses, draw, MOST_ROUNDS)
    (rest,) = (~settled).nonzero()
    mean[rest], covariance[rest], best[rest], _ = _sampled(likelihood, within, poses[rest], draw, ROUNDS)
    mean[:, 2] = wrap(mean[:, 2])
    return mean, covariance, best


def _sampled(
    likelihood: PoseLikelihood, within: Bounds, poses: Array, draw: np.random.Generator, rounds: int
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """As `_refined`, and whether a Gaussian is where the scan is about as likely as at its best pose, (K,).

    Ratios are taken to powers if there are more than `ROUNDS` rounds at most.
    """
    count, first = len(poses), np.diag(np.array([0.5 * APART_M, 0.5 * APART_M, 0.5 * APART_RAD]) ** 2)
    mean, covariance, best = poses.copy(), np.tile(first, (count, 1, 1)), np.full(count, -np.inf)
    live, settled = np.arange(count), np.ones(count, bool)
    for turn in range(rounds):
        if not len(live):
            break
        normal = draw.standard_normal((len(live), SAMPLES, 3))
        normal[:, 0] = 0.0  # the mean itself
        fresh = mean[live, None] + normal @ np.linalg.cholesky(covariance[live]).transpose(0, 2, 1)
        every = fresh.reshape(-1, 3)
        value = np.where(within.holds(every), likelihood.score(every, WIDEN if turn == 0 else 1.0), -np.inf)
        value = value.reshape(fresh.shape[:2])
        there = np.isfinite(value).any(1)
        live, fresh, value, normal = live[there], fresh[there], value[there], normal[there]
        log = (1.0 if turn == 0 else COVER) * value + 0.5 * (normal**2).sum(-1)
        weight, whole = _tempered(log, LEAST_POWER if rounds > ROUNDS else 1.0)
        mean[live] = (weight[:, None] @ fresh)[:, 0]
        gap = fresh - mean[live, None]
        covariance[live] = (weight[..., None] * gap).transpose(0, 2, 1) @ gap + np.diag(LEAST)
        if turn:
            best[live] = np.maximum(best[live], value.max(1))
        usual = (weight * np.where(weight > 0, value, 0.0)).sum(1)
        settled[live] = whole & (usual > best[live] - BEHIND)
        live = live[~whole] if turn >= ROUNDS - 1 else live
        if turn < rounds - 1:
            covariance[live] *= BROADER
    return mean, covariance, best, settled


def _tempered(log: Array, least: float = LEAST_POWER) -> tuple[Array, NDArray[np.bool_]]:
    """Weights (K, N) of samples of such log ratios, and whose ratios weren't taken to a power below 1.

    The power leaves samples that count for `EFFECTIVE` equal ones at least, so that their covariance is one.
    """
    power = np.ones((len(log), 1))
    while True:
        weight = np.exp(power * (log - log.max(1, keepdims=True)))
        weight /= weight.sum(1, keepdims=True)
        few = 1 / np.square(weight).sum(1) < EFFECTIVE
        if not few.any() or power.min() <= least:
            return weight, power[:, 0] == 1
        power[few] *= 0.6
