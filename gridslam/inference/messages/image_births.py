"""New images of direct SLAM: paths that a snapshot holds and the model doesn't (M81), (M82)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.distance_mode import Mode, PathPrior, joint_mode
from gridslam.inference.messages.signal_likelihood import Band, Inverse, Sweep
from gridslam.inference.state.belief import Belief
from gridslam.inference.state.images import DirectState, Tentative
from gridslam.inference.state.rings import BEARINGS, MOVING, Rings, outer
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import line_between, unit

Complex = NDArray[np.complex128]
INTENSITIES_DB = np.arange(3.0, 34.0, 5.0)
"""Intensities of a new path over the noise, equally likely."""
MOST_NEW, MOST_TENTATIVE = 4, 8
"""New images per anchor and step; tentative ones per anchor."""
BIRTHS, FIRST_BIRTHS, FIRST_STEPS = 1e-4, 0.05, 8.0
"""Probability of a new path per delay cell: of a running filter; at the first step, and for how many
steps. At the start several cells hold paths; with the rate of a running filter the line of sight is
dragged towards reflections that aren't in the model yet."""
POINTS = 2048
"""Of the folding range, at which one more path is tried."""
LEAST_EXISTENCE = 0.01
"""Existence below which a tentative image isn't begun."""
NEAR_M, BESIDE_M = 0.05, 0.2
"""By how much an image must be farther than its anchor; how near to a known path a weak one is none."""
DEVIATIONS = 2.0
"""Deviations of the line of sight that come on top."""
OVERLAP = 0.6
"""Deviation of a hypothesis along the ring at birth, in spacings."""
ACCEPTED = np.log(8.0) - 2.0
"""What a gain in log posterior is worth more than a ratio of likelihoods: searched at 8 points of a cell,
less what fitting a distance and an intensity gains in noise."""
SOLVED_AGAIN = 1.0
"""What solving everything again may gain on top of what the others' present fit shows; 0.5 is usual."""
OWN_PLACE_M = 0.6
"""An image so near to its anchor is the anchor itself."""


@dataclass(frozen=True, eq=False)
class NewPath:
    """A path that may come from a new image.

    Attributes
    ----------
    existence : float
    distance, variance : float; m, m^2
    intensity : float
    """

    existence: float
    distance: float
    variance: float
    intensity: float


@dataclass(frozen=True, eq=False)
class Found:
    """What a snapshot holds.

    Attributes
    ----------
    prior : PathPrior
        Of the known paths, and of new ones that were taken in.
    mode : Mode
        Of them.
    new : list of NewPath
        All new ones. Those taken in come first, in the order of the prior's last rows, all above 0.5.
    inverse : Inverse
        C^-1 at the mode.
    table : Sweep
        What one more path would be worth.
    """

    prior: PathPrior
    mode: Mode
    new: list[NewPath]
    inverse: Inverse
    table: Sweep


def find_births(band: Band, samples: Complex, prior: PathPrior, noise: float, step: int) -> Found:
    """Look for paths that the known ones leave unexplained, the strongest first, before anything is updated.

    Each candidate is solved for together with all known paths from their prediction: judged after an update,
    the agent would have swallowed the misfit.

    Parameters
    ----------
    step : int
        Steps taken before this one.
    """
    rate = max(BIRTHS, FIRST_BIRTHS * float(np.exp(-step / FIRST_STEPS)))
    mode = joint_mode(band, samples, prior, noise)
    taken, weak = list[NewPath](), list[NewPath]()
    nearest = prior.mean[0] + NEAR_M + DEVIATIONS * np.sqrt(1 / prior.precision[0, 0])
    grid = band.folding_m / POINTS * np.arange(POINTS)
    grid = grid + band.folding_m * (grid < nearest)
    open_ = grid < nearest + band.folding_m - band.resolution_m
    intensities = noise * 10 ** (INTENSITIES_DB / 10)
    needed = np.log(LEAST_EXISTENCE) - np.log(rate) - ACCEPTED
    inverse, table = _explained(band, samples, prior, mode, noise)
    for _ in range(MOST_NEW):
        logs = table.log_ratio(intensities[:, None])
        best = logs.max(0)
        score = np.where(open_, best + np.log(np.exp(logs - best).mean(0)), -np.inf)
        peak = int(score.argmax())
        if score[peak] < needed - SOLVED_AGAIN:
            break
        share = np.exp(logs[:, peak] - best[peak])
        intensity = float(share @ intensities / share.sum())
        wider = prior.with_path(float(grid[peak]), intensity)
        trial = joint_mode(band, samples, wider, noise)
        log_odds = trial.log_posterior - mode.log_posterior + np.log(rate) + ACCEPTED
        existence = float(1 / (1 + np.exp(-np.clip(log_odds, -50, 50))))
        if existence < LEAST_EXISTENCE or trial.distance[-1] < nearest:
            open_ &= np.abs(grid - grid[peak]) > BESIDE_M
            continue
        new = NewPath(existence, float(trial.distance[-1]), float(trial.variance[-1]), intensity)
        if existence > 0.5:
            taken.append(new)
            prior, mode = wider, trial
            inverse, table = _explained(band, samples, prior, mode, noise)
        else:
            open_ &= np.abs(grid - grid[peak]) > BESIDE_M
            known = np.append(mode.distance, [path.distance for path in weak])
            if (np.abs(known - new.distance) > BESIDE_M).all():
                weak.append(new)
    return Found(prior, mode, taken + weak, inverse, table)


def _explained(
    band: Band, samples: Complex, prior: PathPrior, mode: Mode, noise: float
) -> tuple[Inverse, Sweep]:
    """All paths at their mode, broadened by their variance, and what one more would be worth on top.

    An error of 1 cm would else leave -24 dB of a strong path to be explained.
    """
    inverse = Inverse.of(band, samples, prior.weight, mode.distance, mode.variance, noise)
    return inverse, inverse.sweep(POINTS)


def add_tentative(state: DirectState, anchor: int, new: list[NewPath], model: FilterModel) -> DirectState:
    """Begin a ring for every new path, and keep the likeliest few of the anchor."""
    begun, belief = list[NewPath](), state.belief
    toward = _toward()
    position, weights = model.anchor_positions[anchor], list[Array]()
    for path in new:
        image = belief.mean[:2] + path.distance * toward
        weight = _density(image, position, model)
        if weight.sum() > 0:
            begun.append(path)
            weights.append(weight / weight.sum())
    if begun:
        fresh = _rings(belief, anchor, begun, np.array(weights))
        intensity = np.array([path.intensity for path in begun])
        tentative = state.tentative.joined(Tentative(fresh, intensity, np.ones(len(begun))))
        state = replace(state, tentative=tentative)
    return state


def _density(image: Array, position: Array, model: FilterModel) -> Array:
    """Of images (K, 2): surfaces are uniform over the lines that cross the region."""
    line, span = line_between(position, image), np.linalg.norm(image - position, axis=-1)
    crosses = np.abs((unit(line[:, 0]) @ model.middle) - line[:, 1]) < model.radius_m
    return np.asarray(crosses * (span > OWN_PLACE_M) / np.maximum(span, 0.1))


def _toward() -> Array:
    """Unit vectors of the hypotheses, (K, 2)."""
    return unit(np.asarray(2 * np.pi / BEARINGS * np.arange(BEARINGS), np.float64))


def _rings(belief: Belief, anchor: int, new: list[NewPath], weight: Array) -> Rings:
    """Rings (n) about the agent."""
    count = len(new)
    distance = np.array([path.distance for path in new])[:, None]
    variance = np.array([path.variance for path in new])[:, None]
    toward = np.broadcast_to(_toward(), (count, BEARINGS, 2))
    across = np.stack([-toward[..., 1], toward[..., 0]], -1)
    arc = np.square(OVERLAP * 2 * np.pi / BEARINGS * distance)[..., None, None]
    mean = np.zeros((count, BEARINGS, MOVING + 2))
    mean[..., :MOVING] = belief.mean[:MOVING]
    mean[..., MOVING:] = belief.mean[:2] + distance[..., None] * toward
    entry = np.array([0, 1, 2, 3, 0, 1])  # the image shares the error of the agent's position
    covariance = np.broadcast_to(belief.covariance[np.ix_(entry, entry)], (*mean.shape, MOVING + 2)).copy()
    covariance[..., MOVING:, MOVING:] += variance[..., None, None] * outer(toward, toward) + arc * outer(
        across, across
    )
    whole = np.zeros(count, np.int64)
    return Rings(
        np.full(count, anchor, np.intp), np.array([path.existence for path in new]), whole, whole + 1, weight,
        mean, covariance,
    )  # fmt: skip
