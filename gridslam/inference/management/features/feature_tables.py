"""Learned features as tables that users get and the next agent starts from; docs/model.md, (M138)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from gridslam.arrays import Array
from gridslam.estimate_tables import FREE, MIRROR, SCATTERER, FeatureEstimate
from gridslam.inference.messages.features.joint_update import FORGETS
from gridslam.inference.state.features.features import (
    CROWD,
    CROWD_EXTENT_M,
    ENTRIES,
    MOVING,
    FeatureBank,
    place_jacobian,
    places,
)
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.maps.feature_rows import chosen, own_covariance, owners

SURE = 2.0
"""Deviations within which a feature counts as a mirror image or a scatterer."""
POWER_STD = float(np.sqrt(FORGETS / (2 - FORGETS)))
"""Deviation of a running mean of exponential powers, in units of their mean."""
SURELY_M = 0.05
"""Deviation of an extra length up to which a mirror is sure to be one, in a crowd or not."""
NEAREST_M = 0.5
"""A feature nearer to where an agent starts is counted from beside it."""


def feature_estimate(belief: JointBelief, anchors: Array) -> tuple[FeatureEstimate, Array]:
    """Table of all features, and the covariance of all their x, y and bias together (3 F, 3 F).

    Parameters
    ----------
    anchors : (J, 2) m
    """
    bank, count = belief.features, len(belief.features)
    if not count:
        return FeatureEstimate.empty(), np.zeros((0, 0))
    place = places(belief.mean, bank.origin_m)
    jacobian = block_diag(*place_jacobian(belief.mean))
    joint = jacobian @ belief.covariance[MOVING:, MOVING:] @ jacobian.T
    covariance = np.zeros((count, 4, 4))
    for n in range(count):
        at = slice(ENTRIES * n, ENTRIES * (n + 1))
        covariance[n] = with_power(joint[at, at], bank.power[n])
    kind = [
        classify(p, c[:3, :3], anchors[a]) for p, c, a in zip(place, covariance, bank.anchor, strict=True)
    ]
    table = FeatureEstimate(
        bank.identity.copy(), bank.anchor.copy(), anchors[bank.anchor], place[:, :2], place[:, 2],
        bank.power.copy(), belief.noise[bank.anchor], covariance, np.array(kind, np.int64),
        bank.steps_seen.copy(), bank.last_step.copy(),
    )  # fmt: skip
    return table, joint


def with_power(square: Array, power: float) -> Array:
    """Covariance (4, 4) of x, y, b and of the power, a running mean, by that of x, y, b (3, 3)."""
    covariance = np.zeros((4, 4))
    covariance[:3, :3], covariance[3, 3] = square, (POWER_STD * power) ** 2
    return covariance


def classify(place: Array, covariance: Array, anchor_m: Array) -> int:
    """What a feature [x, y, b] can be: a mirror image has no extra length, a scatterer that to the anchor."""
    x, y, extra = place
    way = np.array([x, y]) - anchor_m
    far = np.hypot(*way)
    slope = np.array([*(-way / max(far, 1e-9)), 1.0])
    if abs(extra) <= SURE * np.sqrt(covariance[2, 2]):
        return MIRROR
    if abs(extra - far) <= SURE * np.sqrt(slope @ covariance @ slope):
        return SCATTERER
    return FREE


def with_features(
    belief: JointBelief, table: FeatureEstimate, joint: Array | None, anchors: Array
) -> JointBelief:
    """The belief before the first step with the features that an earlier agent left.

    Parameters
    ----------
    joint : (3 F, 3 F), optional
        Covariance of all x, y, bias; default: each feature's own.
    anchors : (J, 2) m
        Features of others are left out.
    """
    whose = owners(table, anchors)
    rows = np.flatnonzero(whose >= 0)
    table, square = chosen(table, own_covariance(table) if joint is None else joint, rows)
    whose, count = whose[rows], len(table)
    if not count:
        return belief
    origin = np.tile(belief.mean[:2], (count, 1))
    near = np.hypot(*(table.position_m - origin).T) < NEAREST_M
    origin[near, 0] += 2 * NEAREST_M
    way = table.position_m - origin
    entry = np.stack(
        [np.hypot(*way.T) + table.bias_m, np.arctan2(way[:, 1], way[:, 0]), table.bias_m], 1
    ).ravel()
    mean = np.concatenate([belief.mean, entry])
    inverse = block_diag(*np.linalg.inv(place_jacobian(mean)))
    size = len(belief.mean)
    covariance = np.zeros((len(mean), len(mean)))
    covariance[:size, :size] = belief.covariance
    covariance[size:, size:] = inverse @ square @ inverse.T
    bank = FeatureBank(
        np.arange(count), whose, origin, table.variance, table.steps_seen, np.full(count, -1), np.ones(count)
    )
    noise = belief.noise.copy()
    for anchor, level in zip(whose, table.noise, strict=True):
        noise[anchor] = level if np.isfinite(level) and level > 0 else noise[anchor]
    extent = CROWD_EXTENT_M if crowded(table, whose) else belief.extent
    return replace(belief, mean=mean, covariance=covariance, features=bank, noise=noise, extent=extent)


def crowded(table: FeatureEstimate, whose: NDArray[np.int64]) -> bool:
    """Whether some anchor (F,) has a crowd of features that aren't sure to be images."""
    unsure = (table.kind != MIRROR) | (table.covariance[:, 2, 2] > SURELY_M**2)
    return bool((np.bincount(whose[unsure]) > CROWD).any())
