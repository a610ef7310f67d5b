"""Twins of the kernels that update agent, surfaces and rays, and judge the fit, from general formulas."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.kernels import PATH_BLOCK
from gridslam.kernels.primitives.blocks import (
    Account,
    Anchors,
    Belief,
    Existence,
    Messages,
    Pairs,
    PathRows,
    Ratios,
)
from gridslam.reference.gaussian import correct
from gridslam.reference.messages import associate, length_given
from gridslam.world.geometry import wrap

Whole = NDArray[np.int32]
SURE, WORST, MEASURED = 0.9, 30.0, 1e11


def exist(
    path: Whole, odds: Array, ratio: Array, nu: Array, surface: Array, sight: Array, single: Array,
    double: Array,
) -> tuple[Array, Array, Array, Array, Array]:  # fmt: skip
    """Twin of `updates.exist`: surfaces, lines of sight, rays over one and two; worth (L,)."""
    bounces, last, first, anchor = path.T
    there, surfaces, detected, possible, known = odds[[0, 1, 3, 4, 5]]
    worth = (nu * ratio).sum(1) + 1 - detected
    chance = surfaces * possible
    ahead = chance * worth + 1 - chance
    after = there * ahead / (there * ahead + 1 - there)
    sight, single, double = sight.copy(), single.copy(), double.copy()
    sight[anchor[bounces == 0]] = after[bounces == 0]
    single[anchor[bounces == 1], last[bounces == 1]] = after[bounces == 1]
    double[anchor[bounces == 2], last[bounces == 2], first[bounces == 2]] = after[bounces == 2]
    whole, log = known * worth + 1 - known, np.zeros(len(surface))
    for own, other in ((last, first), (first, last)):
        rows = np.flatnonzero((bounces == 2) | ((bounces == 1) & (own is last)))
        partner = np.where(bounces[rows] == 1, 1.0, surface[other[rows]])
        np.add.at(log, own[rows], np.log(np.maximum(partner * whole[rows] + 1 - partner, 1e-12)))
    total = np.log(np.maximum(surface, 1e-12)) - np.log(np.maximum(1 - surface, 1e-9)) + log
    surface = np.clip(1 / (1 + np.exp(-np.clip(total, -40, 40))), 0, 1 - 1e-7)
    return surface, sight, single, double, worth


def fit(
    path: Whole, index: Whole, pair: Array, predicted: Array, share: Array, responsible: Array, scan: Array,
    blocks: Array, radio: Array, turned: Array, sums: Array,
) -> Array:  # fmt: skip
    """Twin of `fitting.fit`: the sums afterwards, (J, 9)."""
    loud, sums = scan[:, 7] > 0.5, sums.copy()
    sender = np.maximum(scan[:, 9], 0).astype(int)
    np.add.at(sums[:, 4], sender[loud], np.minimum(responsible.sum(0), 1.0)[loud])
    np.add.at(sums[:, 5], sender[loud], 1.0)
    sure = np.flatnonzero(share > SURE)
    rows, scan_rows = index[sure].T
    anchor = path[rows, 3]
    known = pair[sure, 3:6] < MEASURED
    gap = pair[sure, :3] - predicted[rows, :3]
    gap[:, 1:] = wrap(gap[:, 1:])
    gap = np.where(known, gap, 0.0)
    spread = predicted[rows, 3:12].reshape(-1, 3, 3) + pair[sure, 3:6, None] * np.eye(3)
    square = (gap * np.linalg.solve(spread, gap[..., None])[..., 0]).sum(1)
    np.add.at(sums, (anchor, 0), np.minimum(square, WORST))
    np.add.at(sums, (anchor, 1), known.sum(1))
    direct = path[rows, 0] == 0
    left = direct & known[:, 1]
    np.add.at(sums, (anchor[left], 6), (turned[anchor[left]] - gap[left, 1]) / spread[left, 1, 1])
    np.add.at(sums, (anchor[left], 7), 1 / spread[left, 1, 1])
    amplitude, own = scan[scan_rows, 6], radio[anchor]
    strong = direct & known[:, 0] & (amplitude >= 0)
    length, unsure = length_given(predicted[rows], pair[sure, 0], pair[sure, 3]).T
    level = own[:, 7] / length
    variance = 0.5 + level**2 / (4 * own[:, 8])
    measured = np.sqrt(np.maximum(amplitude**2 - variance, 0.0))
    variance += unsure**2 * level * amplitude
    clear = strong & (measured > 2 * own[:, 9])
    np.add.at(sums, (anchor[clear], 2), (level * measured / variance)[clear])
    np.add.at(sums, (anchor[clear], 3), (level**2 / variance)[clear])
    np.minimum.at(sums, (anchor, 8), effective_sample_size(blocks[len(path) + sure]))
    return sums


def effective_sample_size(blocks: Array) -> Array:
    """Effective number of the particles behind each pair (K,), from sums of weights over blocks of them.

    Blocks are sums of independent weights, so their spread tells that of the weights.
    """
    particles, sums = PATH_BLOCK * blocks.shape[1], blocks.astype(np.float64)
    spread = PATH_BLOCK * sums.var(1) / np.maximum(sums.mean(1), 1e-30) ** 2
    return np.asarray(np.maximum(particles / (1 + np.minimum(spread, 1e12)), 1.0))


def note(
    rows: PathRows, pairs: Pairs, odds: Array, worth: Array, scan: Array, share: Array, messages: Messages
) -> dict[str, NDArray[Any]]:
    """Twin of `path_messages.note`: what it writes, by the names of its arguments.

    Parameters
    ----------
    odds : (12, L)
        Rows as in `primitives.tables`.
    worth : (L,)
        As `exist` finds it.
    scan : (M, 10)
        As `AnchorScan.table`.
    share : (K or more,)
        Probability of each pair's association.
    """
    (path, predicted), (count, noted, factor, summary, begin, detection) = rows, messages
    start, index = pairs.start, pairs.index
    (n, k), paths, pairs_now = count, len(path), start[-1]
    noted, begin, factor, summary, detection = (
        noted.copy(),
        begin.copy(),
        factor.copy(),
        summary.copy(),
        detection.copy(),
    )
    belief, after, more = odds[0] * odds[1], slice(n, n + paths), slice(k, k + pairs_now)
    noted[after] = path
    caused = np.bincount(index[:pairs_now, 0], share[:pairs_now], paths)
    factor[after] = np.stack([belief * worth + 1 - belief, belief > 0.1], -1)
    summary[:, after] = odds[1], odds[5], caused, predicted[:, 12]
    begin[n + 1 : n + 1 + paths] = k + start[1:]
    detection[:, more] = scan[index[:pairs_now, 1], 6], share[:pairs_now]
    count = count + np.array([paths, pairs_now], np.int32)
    return {
        "count": count, "noted": noted, "factor": factor, "summary": summary, "begin": begin,
        "detection": detection,
    }  # fmt: skip


def update(
    head: int, rounds: int, belief: Belief, rows: PathRows, pairs: Pairs, ratios: Ratios, scan: Array,
    anchors: Anchors, existence: Existence, account: Account, messages: Messages,
) -> dict[str, NDArray[Any]]:  # fmt: skip
    """Twin of `updates.update`: what it writes, by the names of the blocks' arrays.

    Parameters
    ----------
    head : int
        Entry of the mean where the lines begin.
    rounds : int
        Of association at most; 0 where it was done elsewhere.
    scan : (M, 10)
        As `AnchorScan.table`.
    """
    (path, predicted), (start, index, pair, blocks), (odds, message, measured) = rows, pairs, ratios
    ratio, beta, claim, nu, _ = message
    *before, claimed, _ = measured
    if rounds:
        claim, nu, claimed = associate(odds, message, measured, rounds)
    mean, covariance, share, responsible, total, taken = correct(
        *belief, head, path, start, index, pair, odds, beta, nu, anchors.places
    )
    after = fit(
        path, index, pair, predicted, share, responsible, scan, blocks, anchors.radio, account.turned,
        account.sums,
    )  # fmt: skip
    there = exist(path, odds, ratio, nu, *existence)
    known: dict[str, NDArray[Any]] = {}
    if len(messages.noted):
        known = note(rows, pairs, odds, there[-1], scan, share, messages)
    known |= dict(zip(("surface", "sight", "single", "double", "worth"), there, strict=True))
    return known | {
        "mean": mean, "covariance": covariance, "share": share, "sums": after,
        "message": np.stack([ratio, beta, claim, nu, responsible]),
        "measured": np.stack([*before, claimed, taken]), "total": total,
    }  # fmt: skip
