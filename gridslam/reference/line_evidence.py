"""Plain counterpart of the kernel that gathers evidence for lines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0e

from gridslam.arrays import Array
from gridslam.world.single_bounces import single_bounces

MOST_LOG = 12.0


def weigh_lines(
    power: NDArray[np.float32], noise: float, folding: float, place: Array, pose: Array, offset: Array,
    level: Array, chance: Array, fades: int, evidence: Array,
) -> Array:  # fmt: skip
    """Twin of `line_evidence.weigh_lines`: the evidence after a snapshot, (A, O, B)."""
    angle = np.pi * np.arange(len(evidence))[:, None] / len(evidence)
    line = np.stack(np.broadcast_arrays(
        angle, offset + pose[3] * np.cos(angle) + pose[4] * np.sin(angle)
    ), -1)  # fmt: skip
    path = single_bounces(line, place, pose[:3])
    share = path.value / [folding, 2 * np.pi, 2 * np.pi] + [0.0, 0.5, 0.5]
    size = np.array([power.shape[2], *power.shape[:2]])
    d, t, r = np.moveaxis(np.mod(np.floor(share * size + 0.5).astype(np.intp), size), -1, 0)
    matched = power[t, r, d] / noise
    strong, loud = level / path.value[..., :1], np.maximum(matched, 0)[..., None]
    bend = 2 * strong * np.sqrt(loud)
    own = np.exp(np.minimum(bend - strong**2, MOST_LOG)) * i0e(bend)
    if fades:
        own = np.exp(np.minimum(strong**2 * loud / (1 + strong**2), MOST_LOG)) / (1 + strong**2)
    ratio = chance[0] * own + 1 - chance[0]
    after = np.clip(ratio * ((1 - chance[1]) * evidence + chance[1]), 1e-6, 1e30)
    return np.where((path.possible & (matched >= 0))[..., None], after, evidence)
