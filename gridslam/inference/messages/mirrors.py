"""Whether surfaces are mirrors, by where paths leave and arrive; docs/model.md, (M517), (M547). Ours.

What is heard over a corner of two walls, of which one isn't known, arrives as if from behind one wall, from a
place that stays. Born there, such a wall is confirmed at every step by its distance, and pulls the agent by
what doesn't fit: where paths leave, and, where several anchors are heard over the corner, where they arrive.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, i0e

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.kernels import UNMEASURED
from gridslam.kernels.primitives.tables import AOA, AOD, COVARIANCE, PATH_ROW, VARIANCE

DEPARTED, ARRIVED, COSTS, TURNED = slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 8)
WEIGHTS, MISSES = slice(0, 4, 2), slice(1, 4, 2)
"""Columns of `SurfaceBank.angles`; of departures and arrivals, those of weights, and of what they missed."""
TINY = 1e-300
MOST_SURPRISED = 2.5
"""What one angle may say at most, in deviations: it may be another path's."""
MIRRORS = math.log(6)
"""Log odds of a mirror before any departure: of seven surfaces that are born one is heard over a corner."""
SYSTEMATIC_RAD = math.radians(0.5)
"""How far all may miss together, for what the radio doesn't know of itself, as an anchor that is turned."""


def weigh_angles(state: State, paths: PredictedPaths, ratios: LikelihoodRatios, exchange: Exchange) -> State:
    """The state with the angles of its single bounces weighed, as they were predicted; (M517), (M547).

    Where the agent is lost, or was until lately, they tell of its place.

    Parameters
    ----------
    paths : PredictedPaths
        L paths over the surfaces of `state`.
    ratios : LikelihoodRatios
        Of these, with the pairs that may belong together.
    exchange : Exchange
        Which of them did.
    """
    pair, sure = ratios.pairs.pair, exchange.likely_pairs(ratios)
    return weigh_heard_angles(state, paths, ratios.pairs.index[sure, PATH_ROW], pair[sure])


def weigh_heard_angles(state: State, paths: PredictedPaths, rows: NDArray[np.intp], heard: Array) -> State:
    """The state with the angles of its single bounces weighed by D measurements of paths; (M517), (M547).

    Parameters
    ----------
    rows : (D,)
        Which of the paths.
    heard : (D, 6 or more)
        Distance (m), AoD and AoA (rad), and their own variances; `UNMEASURED` for none.
    """
    # plain numbers: a handful, one by one
    told, predictions, measured = (
        part.tolist() for part in (paths.rays.table[rows], paths.prediction.whole[rows], heard)
    )
    if state.monitor.astray or all(bounces != 1 for bounces, *_ in told):
        return state
    bank, belief = state.surfaces, state.belief
    heading, angles, normals = float(belief.mean[HEADING]), bank.angles.copy(), belief.lines[:, 0].tolist()
    for (bounces, last, _, anchor), predicted, found in zip(told, predictions, measured, strict=True):
        if bounces != 1:
            continue
        sums = angles[last, anchor].tolist()
        for kind, to in ((AOD, DEPARTED), (AOA, ARRIVED)):
            if found[VARIANCE + kind] < UNMEASURED:
                std = math.sqrt(predicted[COVARIANCE + 4 * kind] + found[VARIANCE + kind])
                angle = math.remainder(found[kind] - predicted[kind], math.tau)
                missed = limited(angle / std)
                _add(sums, to, std**-2, missed / std)
                if kind == AOD:
                    # over a right corner it leaves the way it arrives, which a mirror turns about its normal
                    beside = angle + 2 * (normals[last] - heading - predicted[AOA])
                    by_corner = limited(math.remainder(beside, math.tau) / std)
                    _add(sums, COSTS, 0.5 * missed**2, 0.5 * by_corner**2)
                    _add(sums, TURNED, math.cos(beside) / std**2, math.sin(beside) / std**2)
        angles[last, anchor] = sums
    return replace(state, surfaces=replace(bank, angles=angles))


def _add(sums: list[float], to: slice, one: float, other: float) -> None:
    """Add to two sums that stand side by side."""
    sums[to.start] += one
    sums[to.start + 1] += other


def limited(deviations: float) -> float:
    """What one angle says, in deviations."""
    return min(max(deviations, -MOST_SURPRISED), MOST_SURPRISED)


def missed_angles(bank: SurfaceBank) -> Array:
    """By how many deviations the angles of single bounces miss in the mean, (S, J, 2) squared; (M517).

    Departures and arrivals of each anchor; all of them may miss by `SYSTEMATIC_RAD`.
    """
    weight, missed = bank.angles[..., WEIGHTS], bank.angles[..., MISSES]
    return np.asarray(missed**2 / np.maximum(weight + SYSTEMATIC_RAD**2 * weight**2, TINY))


def mirror_odds(bank: SurfaceBank) -> Array:
    """Log odds of a mirror against a corner of two walls by all departures so far, (S,) nats; (M547)."""
    slack, (weight, missed, _, _, each, right, x, y) = SYSTEMATIC_RAD**2, bank.angles.sum(1).T
    length = np.hypot(x, y)
    mirror = each - 0.5 * missed**2 * slack / (1 + weight * slack) + 0.5 * np.log1p(weight * slack)
    any_corner = weight - length - np.log(i0e(length))
    return np.asarray(np.log(2) - np.logaddexp(-right, -any_corner) - mirror)


def mirror_chances(bank: SurfaceBank, odds: Array | None = None) -> Array:
    """Chances that surfaces are mirrors, (S,); 1 of those of which no departure was weighed; (M547).

    Parameters
    ----------
    odds : (S,), optional
        Their `mirror_odds`, where they are known.
    """
    odds = mirror_odds(bank) if odds is None else odds
    return np.where(departures_weighed(bank), expit(odds + MIRRORS), 1.0)


def departures_weighed(bank: SurfaceBank) -> NDArray[np.bool_]:
    """Of which surfaces a departure was weighed, (S,)."""
    return np.asarray(bank.angles[:, :, DEPARTED.start].any(1))


def unweighed(state: State) -> State:
    """The state as if no angle had been weighed: its agent was elsewhere than believed."""
    return replace(state, corners=state.corners[:0], surfaces=unweighed_bank(state.surfaces))


def unweighed_bank(bank: SurfaceBank) -> SurfaceBank:
    """The surfaces of such a state."""
    return replace(bank, angles=np.zeros_like(bank.angles), forms=np.zeros_like(bank.forms))
