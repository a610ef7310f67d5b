"""Whether a surface is a wall or a point that scatters; docs/model.md, (M559) to (M561). Ours.

What a post, a lamp or a cupboard's edge scatters is heard as if off a wall through it that turns as the agent
goes by, and a surface is born there that walks along with it. A wall stays, and so does the point: both are
fitted beside each other to all that is heard of a surface, and how well either predicts it tells which it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.kernels import UNMEASURED
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import unit, wrap

POSE = np.array([0, 1, HEADING])
WALL, POINT, ODDS = slice(0, 5), slice(5, 10), 10
"""Columns of `SurfaceBank.forms`: of either form mean (2,) and covariance (xx, xy, yy); their log odds."""
BELIEVED, SHIFTED_M = 4.0, 1.0
"""Variances of the line as it is believed, with which a wall begins; deviation of the point's place, m."""
FADING = 1.02
"""Growth of a covariance with each measurement: poses that are off together don't average out."""
MOST_TOLD, MOST_SURPRISED = 3.0, 3.0
"""What one measurement may tell at most, nats, and by how many deviations it may move a form."""
DECIDED = 30.0
"""Log odds from which on a wall isn't looked at any more, and beyond which a point's don't go."""
WALLS, BESIDE = 5.0, -1.0
"""Log odds of a wall beforehand, and of what may be heard of a point that is known."""
KNOWN, SHARP_M, SAME_M = -10.0, 0.1, 0.3
"""Log odds of a point that is known; deviations of its place, and how far what else is heard of it may be."""
NEAR_M = 0.05
"""Lengths are not taken to be shorter."""


def weigh_forms(
    state: State, paths: PredictedPaths, ratios: LikelihoodRatios, exchange: Exchange, model: FilterModel
) -> State:
    """The state with both forms of its surfaces fitted to what single bounces caused, and their odds.

    Not of images that one anchor alone has, nor where clocks or heights lengthen paths.

    Parameters
    ----------
    paths : PredictedPaths
        L paths over the surfaces of `state`.
    ratios : LikelihoodRatios
        Of these, with the pairs that may belong together.
    exchange : Exchange
        Which of them did.
    """
    bank, belief = state.surfaces, state.belief
    if state.monitor.astray or belief.clocks or not len(bank) or model.places[:, 3].any():
        return state
    pair, sure = ratios.pairs.pair, exchange.likely_pairs(ratios)
    bounces, surface, _, anchor = paths.rays.table[ratios.pairs.index[sure, 0]].T
    open_ = (bounces == 1) & (bank.owner < 0)[surface] & (bank.forms[:, ODDS] < DECIDED)[surface]
    if not open_.any():
        return state
    rows, places, heard = surface[open_], model.places[anchor[open_], :3], pair[sure[open_]]
    entry = belief.layout.head + 2 * rows
    spread = [belief.covariance[entry + i, entry + j] for i, j in ((0, 0), (0, 1), (1, 1))]
    lines = np.column_stack([belief.lines[rows], *spread])
    forms = bank.forms.copy()
    forms[rows] = fitted(
        forms[rows], heard[:, :3], heard[:, 3:6], places, belief.mean[POSE],
        belief.covariance[np.ix_(POSE, POSE)], lines,
    )  # fmt: skip
    return replace(state, surfaces=replace(bank, forms=forms))


def wall_chances(bank: SurfaceBank) -> Array:
    """Chances that surfaces are walls, (S,); 1 of those of which nothing was weighed; (M561)."""
    point, spread, odds = bank.forms[:, 5:7], bank.forms[:, 7] + bank.forms[:, 9], bank.forms[:, ODDS]
    known = point[(odds < KNOWN) & (spread < SHARP_M**2)]
    apart = np.hypot(*(point[:, None] - known).transpose(2, 0, 1)).min(1, initial=np.inf)
    beside = (apart < SAME_M) & (spread < SAME_M**2) & (spread > 0)
    return np.where(spread > 0, expit(odds + np.where(beside, BESIDE, WALLS)), 1.0)


def fitted(
    forms: Array, value: Array, variance: Array, places: Array, pose: Array, known: Array, lines: Array
) -> Array:
    """Forms (D, 11) of D surfaces after a measurement of each.

    Parameters
    ----------
    value, variance : (D, 3)
        Distance (m), AoD and AoA (rad), and their own variances; `UNMEASURED` for none.
    places : (D, 3)
        Of the anchors: x, y (m), orientation (rad).
    pose, known : (3,), (3, 3)
        The agent's x, y (m), heading (rad), and their covariance.
    lines : (D, 5)
        The surfaces as they are believed, angle (rad), offset (m) and covariance: what the first measurement
        begins with.
    """
    fresh = ~forms[:, [2, 4, 7, 9]].any(1)
    forms = forms.copy()
    if fresh.any():
        forms[fresh] = begun(value[fresh], variance[fresh], places[fresh], pose, lines[fresh])
    half = len(forms)
    mean = np.concatenate([forms[:, 0:2], forms[:, 5:7]])
    spread = np.concatenate([forms[:, 2:5], forms[:, 7:10]])[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    parts = zip(off_wall(mean[:half], places, pose), off_point(mean[half:], places, pose), strict=True)
    predicted, slope, bend = (np.concatenate(both) for both in parts)
    lateral = np.einsum("dki,dij,dkj->d", bend, spread, bend)
    noise = np.tile(variance, (2, 1))
    place = 0.5 * (known[0, 0] + known[1, 1])
    noise[:, 0] += place + 0.5 * lateral**2
    noise[:, 1:] += place / np.maximum(predicted[:, :1], NEAR_M) ** 2
    noise[:, 2] += known[2, 2]
    told = np.concatenate([variance, variance]) < UNMEASURED
    gap = np.tile(value, (2, 1)) - predicted
    gap[:, 1:] = wrap(gap[:, 1:])
    shift, log = np.zeros_like(mean), np.zeros(2 * half)
    for q in range(3):  # one quantity after the other, whose errors are apart
        along = np.einsum("dij,dj->di", spread, slope[:, q])
        whole = (slope[:, q] * along).sum(1) + noise[:, q]
        missed = gap[:, q] - (slope[:, q] * shift).sum(1)
        log -= told[:, q] * (0.5 * missed**2 / whole + 0.5 * np.log(whole))
        most = MOST_SURPRISED * np.sqrt(whole)
        gain = (told[:, q] / whole)[:, None] * along
        shift += gain * np.clip(missed, -most, most)[:, None]
        spread = spread - gain[:, :, None] * along[:, None]
    mean, spread = mean + shift, FADING * spread.reshape(-1, 4)[:, [0, 1, 3]]
    forms[:, WALL] = np.concatenate([mean[:half], spread[:half]], 1)
    forms[:, POINT] = np.concatenate([mean[half:], spread[half:]], 1)
    said = np.clip(log[:half] - log[half:], -MOST_TOLD, MOST_TOLD)
    forms[:, ODDS] = np.maximum(forms[:, ODDS] + np.where(fresh, 0.0, said), -DECIDED)
    return forms


def begun(value: Array, variance: Array, places: Array, pose: Array, lines: Array) -> Array:
    """Forms (D, 11) known about where they are: a wall as it is believed, and a point on the way."""
    forms, place = np.zeros((len(value), ODDS + 1)), pose[:2]
    forms[:, WALL] = lines * [1, 1, BELIEVED, BELIEVED, BELIEVED]
    arrives = variance[:, 2] < UNMEASURED
    near = np.where(arrives[:, None], place, places[:, :2])
    far = np.where(arrives[:, None], places[:, :2], place)
    away = unit(np.where(arrives, value[:, 2] + pose[2], value[:, 1] + places[:, 2]))
    apart, length = far - near, value[:, 0]
    rest = np.maximum(length - (away * apart).sum(1), NEAR_M)
    reach = np.maximum(0.5 * (length**2 - (apart**2).sum(1)) / rest, NEAR_M)  # both ways together are as long
    forms[:, 5:7] = near + np.minimum(reach, length)[:, None] * away
    forms[:, [7, 9]] = SHIFTED_M**2
    return forms


def off_wall(line: Array, places: Array, pose: Array) -> tuple[Array, Array, Array]:
    """What is heard off walls (D, 2), its slopes by them, and their directions in which a length bends."""
    normal, along = unit(line[:, 0]), unit(line[:, 0] + 0.5 * np.pi)
    (back, by_back), (out, by_out) = (
        _mirrored(end, line[:, 1], normal, along) for end in (places[:, :2], pose[None, :2])
    )
    coming, going = back - pose[:2], out - places[:, :2]
    length, turned_in, turned_out = _polar(coming, by_back, going, by_out)
    across = np.stack([-coming[:, 1], coming[:, 0]], 1) / length[:, None] ** 1.5
    bend = np.einsum("di,dik->dk", across, by_back)[:, None]
    value = np.stack([length, _angle(going) - places[:, 2], _angle(coming) - pose[2]], 1)
    by_length = np.einsum("di,dik->dk", coming / length[:, None], by_back)
    return value, np.stack([by_length, turned_out, turned_in], 1), np.repeat(bend, 2, 1) * [[[1.0], [0.0]]]


def off_point(point: Array, places: Array, pose: Array) -> tuple[Array, Array, Array]:
    """The same of points (D, 2) that scatter."""
    going, coming = point - places[:, :2], point - pose[:2]
    ways = [np.maximum(np.hypot(*way.T), NEAR_M)[:, None] for way in (going, coming)]
    ahead = [way / length for way, length in zip((going, coming), ways, strict=True)]
    across = [np.stack([-one[:, 1], one[:, 0]], 1) for one in ahead]
    value = np.stack([
        (ways[0] + ways[1])[:, 0], _angle(going) - places[:, 2], _angle(coming) - pose[2]
    ], 1)  # fmt: skip
    slope = np.stack([ahead[0] + ahead[1], across[0] / ways[0], across[1] / ways[1]], 1)
    return value, slope, np.stack([one / np.sqrt(way) for one, way in zip(across, ways, strict=True)], 1)


def _mirrored(point: Array, offset: Array, normal: Array, along: Array) -> tuple[Array, Array]:
    """Points (D, 2) behind lines, and their slopes (D, 2, 2) by angle and offset."""
    gap = (offset - (point * normal).sum(1))[:, None]
    by_angle = 2 * gap * along - 2 * (point * along).sum(1)[:, None] * normal
    return point + 2 * gap * normal, np.stack([by_angle, 2 * normal], 2)


def _polar(coming: Array, by_back: Array, going: Array, by_out: Array) -> tuple[Array, Array, Array]:
    """Lengths (D,), and slopes of the directions (D, 2) of arrival and departure."""
    length = np.maximum(np.hypot(*coming.T), NEAR_M)
    turned = [
        np.einsum("di,dik->dk", np.stack([-way[:, 1], way[:, 0]], 1) / length[:, None] ** 2, by)
        for way, by in ((coming, by_back), (going, by_out))
    ]
    return length, turned[0], turned[1]


def _angle(way: Array) -> NDArray[np.float64]:
    """Directions of vectors (D, 2), rad."""
    return np.arctan2(way[:, 1], way[:, 0])
