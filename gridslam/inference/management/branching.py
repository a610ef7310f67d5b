"""Branching of hypotheses: poses that a scan lists, and Gaussians too wide to be linearised about.

docs/model.md, section 14.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import AGENT, HEADING, OF_POSE, POSE
from gridslam.inference.management.poses.pose_search import Modes
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.state import State
from gridslam.world.geometry import wrap
from gridslam.world.radio import RadioModel

TOO_WIDE, NARROW, APART, REACH = 1.5, 0.8, 1.2, 2.5
"""In units of the width that can be linearised about: from which on a Gaussian is split, components' width,
and their distance in units of that; deviations of the centres to which they reach."""
SLACK = 1e-9
LEAST_WIDTH_M, WIDEST_M = 0.2, 1.0
"""Widths are not asked to be smaller; a wider Gaussian isn't split: too many components would be needed."""


def placed(state: State, pose: Array, covariance: Array, velocity: float) -> State:
    """The state with its agent at a pose (3,) that is known by itself, independent of the surfaces.

    Parameters
    ----------
    velocity : float
        Variance of each component, (m/s)^2.
    """
    mean, joint = state.belief.mean.copy(), state.belief.covariance.copy()
    mean[POSE], mean[2:4] = pose, 0.0
    joint[:AGENT], joint[:, :AGENT] = 0.0, 0.0
    joint[OF_POSE] = covariance
    joint[2, 2] = joint[3, 3] = velocity
    return state.placed(replace(state.belief, mean=mean, covariance=joint))


def conditioned(state: State, pose: Array, covariance: Array) -> State:
    """The state, given that its agent's pose is about so: all else follows by its correlation."""
    mean, joint = state.belief.mean, state.belief.covariance
    own = joint[OF_POSE]
    gain = np.linalg.solve(own + SLACK * np.eye(3), joint[POSE]).T
    gap = pose - mean[POSE]
    gap[2] = wrap(gap[2])
    moved, narrow = mean + gain @ gap, joint - gain @ (own - covariance) @ gain.T
    moved[HEADING] = wrap(moved[HEADING])
    return state.believing(replace(state.belief, mean=moved, covariance=0.5 * (narrow + narrow.T)))


def branches_of(state: State, modes: Modes, velocity: float) -> list[State]:
    """One state for each mode, its scan still to be taken in: time stands still until then."""
    return [
        replace(placed(state, pose, covariance, velocity), time_s=None)
        for pose, covariance in zip(modes.pose, modes.covariance, strict=True)
    ]


def linear_width(scans: Sequence[AnchorScan], radio: RadioModel) -> float:
    """Spread of the position (m) up to which paths that were heard are straight enough.

    A path of length d curves by s^2 / (2 d) over s; that is to stay below its deviation.
    """
    widths = []
    for scan in scans:
        for distance, amplitude in zip(scan.value[:, 0].tolist(), scan.amplitude.tolist(), strict=True):
            std = float(radio.distance_std(np.array(amplitude if amplitude > 0 else radio.threshold)))
            if distance > 0:
                widths.append(math.sqrt(2 * distance * std))
    return max(float(np.quantile(widths, 0.25)), LEAST_WIDTH_M) if widths else math.inf


def widest(belief: Belief) -> float:
    """Largest standard deviation of the position, m."""
    x, y = float(belief.covariance[0, 0]), float(belief.covariance[1, 1])
    cross = float(belief.covariance[0, 1])
    return math.sqrt(max(0.5 * (x + y) + math.hypot(0.5 * (x - y), cross), 0.0))


def split(belief: Belief, width: float, room: int) -> list[tuple[Belief, float]]:
    """Components of a Gaussian that is wider than `width` (m), along both axes of its position.

    Parameters
    ----------
    room : int
        Components at most; they are coarser where more would be needed, and none where two are too many.

    Returns
    -------
    list of (Belief, float)
        With their weights, which sum to 1; the belief itself if there is nothing to split.
    """
    while room > 1:
        parts = _split(belief, width)
        if len(parts) <= room:
            return parts
        width *= 1.25
    return [(belief, 1.0)]


def _split(belief: Belief, width: float) -> list[tuple[Belief, float]]:
    _, axes = np.linalg.eigh(belief.covariance[:2, :2])
    parts = [(belief, 1.0)]
    for axis in (1, 0):
        parts = [
            (part, weight * share)
            for whole, weight in parts
            for part, share in split_along(whole, axes[:, axis], width)
        ]
    return parts


def split_along(belief: Belief, axis: Array, width: float) -> list[tuple[Belief, float]]:
    """Components along one direction (2,) of the position; all of the state follows by its correlation."""
    spread = math.sqrt(max(float(axis @ belief.covariance[:2, :2] @ axis), 0.0))
    own = NARROW * width
    if spread <= TOO_WIDE * width:
        return [(belief, 1.0)]
    rest = math.sqrt(spread**2 - own**2)
    steps = math.ceil(REACH * rest / (APART * own))
    places = APART * own * np.arange(-steps, steps + 1)
    weight = np.exp(-0.5 * (places / rest) ** 2)
    weight /= weight.sum()
    places *= rest / math.sqrt(
        float(weight @ places**2)
    )  # what lies beyond them is missing from their spread
    gain = belief.covariance[:, :2] @ axis / spread**2
    covariance = belief.covariance - np.outer(gain, gain) * rest**2
    parts = []
    for place, share in zip(places.tolist(), weight.tolist(), strict=True):
        mean = belief.mean + gain * place
        mean[HEADING] = wrap(mean[HEADING])
        parts.append((replace(belief, mean=mean, covariance=covariance), share))
    return parts
