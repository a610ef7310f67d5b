"""Births that a double bounce may explain as well, put off until departures tell; docs/model.md, (M516).

What is heard over a corner of two walls arrives as if from behind one wall, for good: that a mirror there
would send it out in another direction is all that speaks against one. Where the pose is vague, it gives way
instead, and is pulled along by a wall that isn't there. The mean of all departures from the same image, as
far as they were left unexplained, tells which of the two it is. Ours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.layout import HEADING, OF_POSE, POSE
from gridslam.inference.messages.births import Births
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.deviations import deviations
from gridslam.inference.scans.leftovers import Leftovers
from gridslam.inference.state.state import State
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import level_of, unit, wrap
from gridslam.world.radio import RadioModel

KNOWN_M = 0.03
"""Standard deviation of the position (both axes) up to which a birth moves the agent by little."""
BLIND_M = 0.2
"""The same for births without an arrival, of which no image tells whether they are double bounces; (M558)."""
LEAST_ODDS = 1.0
"""Nats by which departures have to speak for a mirror."""
SURE = 4.0
"""The same where a surface wasn't a mirror: the mean of many departures tells that, and no single one."""
CORNERS = 0.5
"""Of double bounces, how many come from right angles; the others depart in any direction."""
REACH, SLACK_M = 3.0, 0.1
"""Deviations within which two images are one, and what is added to them."""
NEAR_M = 0.1
"""Lengths are not taken to be shorter."""


def put_off_double_bounces(
    births: Births, state: State, scan: AnchorScan, radio: RadioModel, model: FilterModel
) -> Births:
    """The births without single bounces that may well be double ones: while the position is vague, and from
    where a surface was taken for a mirror that isn't one.

    Their measurements stay as new as they were: something unknown sent them, and they are left over. Where
    clocks are unknown, (M491) judges births instead. Without an arrival nothing is born while the position is
    vaguer still; (M558).
    """
    x, y = state.belief.covariance.diagonal()[:2].tolist()
    vague = x + y > KNOWN_M**2
    if not len(births) or model.max_bounces < 2 or state.belief.clocks or not (vague or len(state.corners)):
        return births
    if x + y > BLIND_M**2:
        births = _kept(births, np.isfinite(scan.value[births.measurement, 2]))  # (M558)
    single = (births.hit < 0).all(1) & np.isfinite(scan.value[births.measurement, 1:]).all(1)
    if not single.any():
        return births
    asked = births.take(np.flatnonzero(single))
    least = dict.fromkeys(_pairs(asked), LEAST_ODDS) if vague else {}
    least |= dict.fromkeys(_over_corners(asked, state, scan, radio, model), SURE)
    doubtful = {pair for pair, odds in least.items() if mirror_odds(*pair, state, scan, radio, model) < odds}
    return _kept(births, ~(single & np.array([pair in doubtful for pair in _pairs(births)])))


def _pairs(births: Births) -> list[tuple[int, int]]:
    """Measurement and anchor of each birth."""
    return list(zip(births.measurement.tolist(), births.anchor.tolist(), strict=True))


def _kept(births: Births, keep: NDArray[np.bool_]) -> Births:
    """Those to keep (B,)."""
    return births if keep.all() else births.take(np.flatnonzero(keep))


def _over_corners(
    births: Births, state: State, scan: AnchorScan, radio: RadioModel, model: FilterModel
) -> list[tuple[int, int]]:
    """Measurements and anchors of births (B,) from where paths are known to come over corners; (M517)."""
    if not len(state.corners) or not len(births):
        return []
    m, anchor, belief = births.measurement.astype(np.intp), births.anchor, state.belief
    level = np.where(np.isnan(scan.amplitude[m]), radio.threshold, scan.amplitude[m])
    std = deviations(scan, m, level, scan.value[m, 1:], radio)
    std[:, 2] = np.hypot(std[:, 2], np.sqrt(belief.covariance[HEADING, HEADING]))
    pose = np.broadcast_to(belief.mean[POSE], (len(m), len(POSE)))
    image, shape = _images(pose, scan.value[m], std, model.places[anchor, 3])
    gap = image[:, None] - state.corners[:, 1:]
    certain = np.linalg.inv(shape + belief.covariance[:2, :2] + SLACK_M**2 * np.eye(2))
    near = np.einsum("bki,bij,bkj->bk", gap, certain, gap) < REACH**2
    known = (near & (anchor[:, None] == state.corners[:, 0])).any(1)
    return list(zip(m[known].tolist(), anchor[known].tolist(), strict=True))


def mirror_odds(
    m: int, anchor: int, state: State, scan: AnchorScan, radio: RadioModel, model: FilterModel
) -> float:
    """Log odds of a single bounce against a double one, by departures to one image, nats; (M516).

    Parameters
    ----------
    m : int
        A measurement of both angles.
    anchor : int
        Which may have sent it.
    """
    belief, (x, y, facing, height) = state.belief, model.places[anchor, :4].tolist()
    level = np.array([radio.threshold if np.isnan(scan.amplitude[m]) else scan.amplitude[m]])
    std = deviations(scan, np.array([m]), level, scan.value[[m], 1:], radio)
    pose, value, std = _alike(belief.mean[POSE], scan.value[m], std[0], state.leftovers, anchor, height)
    image, shape = _images(pose, value, std, height)
    certain = np.linalg.inv(shape)
    spread = np.linalg.inv(certain.sum(0))
    middle = spread @ (certain @ image[..., None]).sum(0)[:, 0]

    from_anchor = middle - [x, y]
    apart = max(float(np.hypot(*from_anchor)), NEAR_M)
    normal = float(np.arctan2(from_anchor[1], from_anchor[0]))
    towards = np.arctan2(*(middle - pose[:, :2]).T[::-1])
    departing, weight = value[:, 1] + facing, std[:, 1] ** -2
    by_mirror = _mean(wrap(departing - (2 * normal - towards)), weight)
    by_corner = _mean(wrap(departing - towards), weight)

    # how predicted departures follow the image, and the pose with which it moves
    length = max(float(np.mean(level_of(value[:, 0], height))), NEAR_M)
    across = unit(_mean(towards, weight) + 0.5 * np.pi)
    tangent = unit(normal + 0.5 * np.pi) / apart
    turned = 2 * length * float(across @ tangent) - 1
    by_image, by_pose = 2 * tangent - across / length, np.append(2 * tangent, turned)
    noise, known = 1 / weight.sum(), belief.covariance[OF_POSE]
    mirror = noise + by_image @ spread @ by_image + by_pose @ known @ by_pose
    corner = noise + across @ spread @ across / length**2 + known[2, 2]
    double = CORNERS * _normal(by_corner, corner) + (1 - CORNERS) / (2 * np.pi)
    return float(np.log(max(_normal(by_mirror, mirror), 1e-300)) - np.log(double))


def _alike(
    pose: Array, value: Array, std: Array, left: Leftovers | None, anchor: int, height: float
) -> tuple[Array, Array, Array]:
    """Poses, values and deviations (K, 3) of a measurement and of leftovers of the same image, one a step."""
    poses, values, stds = pose[None], value[None], std[None]
    if left is None or not len(left):
        return poses, values, stds
    rows = np.flatnonzero((left.anchor == anchor) & np.isfinite(left.value).all(1))
    poses = np.concatenate([poses, left.pose[left.back[rows]]])
    values, stds = np.concatenate([values, left.value[rows]]), np.concatenate([stds, left.std[rows]])
    image, shape = _images(poses, values, stds, height)
    gap = image[1:] - image[0]
    far = np.einsum("ki,kij,kj->k", gap, np.linalg.inv(shape[1:] + shape[0] + SLACK_M**2 * np.eye(2)), gap)
    order = np.argsort(far, kind="stable")
    order = order[far[order] < REACH**2]
    _, nearest = np.unique(left.back[rows[order]], return_index=True)
    chosen = np.concatenate([[0], 1 + order[nearest]])
    return poses[chosen], values[chosen], stds[chosen]


def _images(pose: Array, value: Array, std: Array, height: Array | float) -> tuple[Array, Array]:
    """Where measurements (K, 3) seem to come from, (K, 2), and covariances without the pose's."""
    length, arriving = np.maximum(level_of(value[:, 0], height), NEAR_M), pose[:, 2] + value[:, 2]
    axes = np.stack([unit(arriving), unit(arriving + 0.5 * np.pi)], axis=1)
    own = np.stack([std[:, 0], length * std[:, 2]], axis=1)
    return pose[:, :2] + length[:, None] * axes[:, 0], np.einsum("ka,kai,kaj->kij", own**2, axes, axes)


def _mean(angle: Array, weight: Array) -> float:
    """Weighted mean of angles (K,)."""
    return float(np.angle((weight * np.exp(1j * angle)).sum()))


def _normal(gap: float, variance: float) -> float:
    """Density of a normal variable."""
    return float(np.exp(-0.5 * gap**2 / variance) / np.sqrt(2 * np.pi * variance))
