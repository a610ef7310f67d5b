"""Births that earlier measurements bear out: walls that are heard too seldom to be told from clutter at once.

docs/model.md, (M251), (M252). Ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.likelihood import detection_table, deviations
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.anchor_measurements import AnchorScan
from gridslam.inference.state.leftovers import Leftovers
from gridslam.inference.state.state import State
from gridslam.kernels.primitives import tables
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import slant, unit, wrap
from gridslam.world.radio import REFLECTION_BINS, RadioModel

POSE = np.array([0, 1, 4])
NEAR_M, NEAR_RAD = 0.6, 0.6
"""By how much distance and angles of an earlier measurement may miss what a new line predicts, roughly."""
OPEN = 0.5
"""Chance that a line which one anchor hears is heard by another one, too."""
CERTAIN = 5.0
"""Ratio to clutter from which on a birth needs no help, and known causes from which on it gets none."""
KNOWN = 0.5
"""Probability from which on a measurement counts as a known path's, or as what bore a surface."""
WIDEST = 1e3
"""Deviation that stands for "tells nothing"."""
MOST_LOG, LEAST_DOUBT = 25.0, 1e-9
"""Largest log ratio of one measurement; least probability of a miss."""


@dataclass(frozen=True)
class Predicted:
    """Single bounces over one line, at many poses: distance, AoD, AoA, and their slopes.

    Attributes
    ----------
    value : (N, 3)
    by_line : (N, 3, 2)
    by_pose : (N, 3, 3)
    possible : (N,) bool
        Agent and anchor stand on one side.
    """

    value: Array
    by_line: Array
    by_pose: Array
    possible: NDArray[np.bool_]


def single_bounces(line: Array, places: Array, pose: Array) -> Predicted:
    """Single bounces over a line (angle, offset) from places (N, 4) to poses (N, 3)."""
    count, normal, tangent = len(pose), unit(line[0]), unit(line[0] + 0.5 * np.pi)
    gap, along = places[:, :2] @ normal - line[1], places[:, :2] @ tangent
    image = places[:, :2] - 2 * gap[:, None] * normal
    by_angle = -2 * along[:, None] * normal - 2 * gap[:, None] * tangent
    toward = image - pose[:, :2]
    level = np.maximum(np.hypot(toward[:, 0], toward[:, 1]), 1e-9)
    toward /= level[:, None]
    across = np.stack([-toward[:, 1], toward[:, 0]], 1) / level[:, None]
    arrival, distance = np.arctan2(toward[:, 1], toward[:, 0]), slant(level, places[:, 3])
    toward = toward * (level / distance)[:, None]
    value = np.stack([distance, 2 * line[0] - arrival - places[:, 2], arrival - pose[:, 2]], 1)
    by_line, by_pose = np.empty((count, 3, 2)), np.zeros((count, 3, 3))
    for column, moved in enumerate((by_angle, np.broadcast_to(2 * normal, (count, 2)))):
        by_line[:, 0, column] = (toward * moved).sum(1)
        by_line[:, 2, column] = (across * moved).sum(1)
    by_line[:, 1] = -by_line[:, 2]
    by_line[:, 1, 0] += 2.0
    by_pose[:, 0, :2], by_pose[:, 1, :2], by_pose[:, 2, :2] = -toward, across, -across
    by_pose[:, 2, 2] = -1.0
    return Predicted(value, by_line, by_pose, gap * (pose[:, :2] @ normal - line[1]) > 0)


def recall_leftovers(
    births: Births, state: State, heard: AnchorScan, ratios: LikelihoodRatios, radio: RadioModel,
    model: FilterModel,
) -> tuple[Births, LikelihoodRatios]:  # fmt: skip
    """Births of single bounces weighed by what was left unexplained before, and the ratios with their sums.

    Parameters
    ----------
    radio : RadioModel
        As the radio seems to be.
    """
    left = state.leftovers
    if left is None or not len(left) or not len(births):
        return births, ratios
    explained, amplitude = ratios.explained[births.measurement], heard.amplitude[births.measurement]
    new = (births.hit < 0).all(1) & (births.ratio < CERTAIN) & (explained < CERTAIN)
    new &= np.isfinite(heard.value[births.measurement]).all(1) & (amplitude > 0)
    rows = np.flatnonzero(new)
    if len(rows):
        rows = rows[_has_company(births.line[rows], left, model.places)]
    if not len(rows):
        return births, ratios
    support = np.ones((len(births), len(REFLECTION_BINS)))
    seen = np.zeros(len(births), np.int64)
    for row in rows.tolist():
        m = int(births.measurement[row])
        found = borne_out(births.line[row], heard, m, state, left, radio, model)
        support[row] += found[0]
        seen[row] = found[1]
    level = REFLECTION_BINS * radio.amplitude(heard.value[births.measurement[rows], 0])[:, None]
    prior = np.exp(radio.log_rician(amplitude[rows, None], level))
    prior /= prior.sum(1, keepdims=True)
    ratio = births.ratio.copy()
    ratio[rows] *= (prior * support[rows]).sum(1)
    measured = ratios.measured.copy()
    np.add.at(measured[tables.NEW], births.measurement[rows], ratio[rows] - births.ratio[rows])
    return replace(births, ratio=ratio, support=support, seen=seen), replace(ratios, measured=measured)


def _has_company(line: Array, left: Leftovers, places: Array) -> NDArray[np.bool_]:
    """Whether any leftover lies roughly where a single bounce over each line (B, 2) is predicted, (B,)."""
    place, pose = places[left.anchor], left.pose[left.back]
    normal = unit(line[:, 0])
    gap = place[:, :2] @ normal.T - line[:, 1]
    toward = place[:, None, :2] - 2 * gap[..., None] * normal - pose[:, None, :2]
    distance = slant(np.hypot(toward[..., 0], toward[..., 1]), place[:, 3:])
    near = np.abs(distance - left.value[:, :1]) < NEAR_M
    arrival = np.arctan2(toward[..., 1], toward[..., 0])
    near &= np.abs(wrap(arrival - pose[:, 2:] - left.value[:, 2:])) < NEAR_RAD
    near &= np.abs(wrap(2 * line[:, 0] - arrival - place[:, 2:3] - left.value[:, 1:2])) < NEAR_RAD
    return np.asarray(near.any(0))


def borne_out(
    line: Array, heard: AnchorScan, m: int, state: State, left: Leftovers, radio: RadioModel,
    model: FilterModel,
) -> tuple[Array, int]:  # fmt: skip
    """Likelihood of what was left over if the line has been there for some steps, over that if it hasn't.

    Misses alone tell nothing for a line and are left out.

    Returns
    -------
    (gain, seen)
        gain (BINS,): by the line's coefficient; seen: how often it was heard before.
    """
    own, places = heard.anchor, model.places
    now = state.belief.covariance[np.ix_(POSE, POSE)]
    rows = np.array([m])
    z = heard.value[rows]
    std = np.minimum(deviations(heard, rows, heard.amplitude[rows], z[:, 1:], radio)[0], WIDEST)
    here = single_bounces(line, places[[own]], state.belief.mean[None, POSE])
    spread = here.by_pose[0] @ now @ here.by_pose[0].T + np.diag(std**2)
    weighed = np.linalg.solve(spread, here.by_line[0])
    covariance = np.linalg.inv(here.by_line[0].T @ weighed + 1e-9 * np.eye(2))
    gap = z[0] - here.value[0]
    gap[1:] = wrap(gap[1:])
    line = line + covariance @ (weighed.T @ gap)

    logs, seen = np.zeros((2, len(left.pose), len(REFLECTION_BINS))), 0.0
    for anchor in range(len(places)):
        silent, both, count = _history(line, covariance, anchor, left, radio, places)
        if anchor != own:
            silent, both = (
                np.log(1 - OPEN + OPEN * np.exp(np.minimum(log, 500.0))) for log in (silent, both)
            )
        logs[0] += silent
        logs[1] += both
        seen += count
    gain = np.exp(np.minimum(logs, 50.0)).mean(1)
    return gain[1] - gain[0], round(seen)


def _history(
    line: Array, covariance: Array, anchor: int, left: Leftovers, radio: RadioModel, places: Array
) -> tuple[Array, Array, float]:
    """Log ratios (W, BINS) of what an anchor sent in the latest 1, 2 ... steps: if nothing of it was the
    line's, and if anything may have been; and about how many were."""
    place = np.broadcast_to(places[anchor], (len(left.pose), 4))
    path = single_bounces(line, place, left.pose)
    level = REFLECTION_BINS * radio.amplitude(path.value[:, :1])
    missed = np.maximum(1 - detection_table(radio)(level) * path.possible[:, None], LEAST_DOUBT)
    silent = np.cumsum(np.log(missed), 0)
    rows = np.flatnonzero(left.anchor == anchor)
    back = left.back[rows]
    gap = left.value[rows] - path.value[back]
    gap[:, 1:] = wrap(gap[:, 1:])
    near = path.possible[back] & (np.abs(gap) < (NEAR_M, NEAR_RAD, NEAR_RAD)).all(1)
    if not near.any():
        return silent, silent, 0.0
    rows, back, gap = rows[near], back[near], gap[near]
    amplitude = left.amplitude[rows]
    by_line, by_pose = path.by_line[back], path.by_pose[back]
    spread = by_line @ covariance @ by_line.transpose(0, 2, 1)
    spread += by_pose @ left.covariance[back] @ by_pose.transpose(0, 2, 1)
    spread[:, range(3), range(3)] += left.std[rows] ** 2
    far = np.einsum("ni,ni->n", gap, np.linalg.solve(spread, gap[..., None])[..., 0])
    log = -0.5 * far - 0.5 * np.linalg.slogdet(2 * np.pi * spread)[1]
    log -= radio.log_clutter(amplitude) + np.log(radio.false_alarms)
    ratio = np.exp(np.minimum(log[:, None] + radio.log_rician(amplitude[:, None], level[back]), MOST_LOG))
    heard = missed.copy()
    np.add.at(heard, back, ratio)
    each = (ratio / heard[back]).max(1).sum()
    return silent, np.cumsum(np.log(heard), 0), float(each)


def remember_leftovers(
    state: State, scans: Sequence[AnchorScan], exchanges: Sequence[Exchange], model: FilterModel
) -> State:
    """Keep what was probably no known path's, nor bore a surface, for later steps.

    Measurements that lack distance, an angle or the amplitude aren't kept.
    """
    if state.leftovers is None:
        return state
    parts = []
    for heard, exchange in zip(scans, exchanges, strict=True):
        free = np.isfinite(heard.value).all(1) & (heard.amplitude > 0)
        free &= exchange.responsible.sum(0) < KNOWN
        free[exchange.born[exchange.born[:, 1] > KNOWN, 0].astype(np.intp)] = False
        rows = np.flatnonzero(free)
        value, amplitude = heard.value[rows], heard.amplitude[rows]
        std = np.minimum(deviations(heard, rows, amplitude, value[:, 1:], model.radio), WIDEST)
        parts.append((np.full(len(rows), heard.anchor, np.int64), value, std, amplitude))
    own = state.belief.covariance[np.ix_(POSE, POSE)]
    columns = (np.concatenate(column) for column in zip(*parts, strict=True))
    return replace(state, leftovers=state.leftovers.joined(state.belief.mean[POSE], own, *columns))
