"""Whether what is correlated with a joint belief, and stands beside it, can be: parked walls, mountings."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.state.arrangement import unparked
from gridslam.inference.state.mountings import PER_ANCHOR
from gridslam.inference.state.state import State
from gridslam.world.filter_model import FilterModel

MOST_PARKED, SLACK = 2000, 1e-6
Claim = tuple[str, bool, str]
"""A part, whether it is sound, and what is allowed."""


def claims_of_parked(state: State) -> list[Claim]:
    """What must hold of parked surfaces: others than those of the belief, and with it one Gaussian."""
    parked = state.parked
    if parked is None:
        return []
    joint = _is_covariance(unparked(state).belief.covariance)
    every = [*state.surfaces.identity.tolist(), *parked.surfaces.identity.tolist()]
    return [
        ("parked", 0 < len(parked) <= MOST_PARKED, f"1 to {MOST_PARKED} surfaces"),
        ("parked/surfaces/identity", len(set(every)) == len(every), "a number for each surface"),
        ("next_identity", state.next_identity > max(every), "above all identities"),
        ("parked/cross", joint, "covariances with the belief that are possible"),
    ]


def claims_of_mountings(state: State, model: FilterModel) -> list[Claim]:
    """What must hold of how anchors stand: an entry for each, and with the belief one Gaussian."""
    own, size = state.mountings, PER_ANCHOR * model.senders
    if own is None:
        return []
    shapes = (own.mean.shape, own.covariance.shape, own.cross.shape, own.pivot.shape)
    wanted = ((size,), (size, size), (size, len(state.belief.mean)), (2,))
    whole = shapes == wanted
    joint = np.block([[state.belief.covariance, own.cross.T], [own.cross, own.covariance]]) if whole else None
    return [
        ("mountings", whole, f"{PER_ANCHOR} numbers for each anchor"),
        ("mountings/turn_variance", 0 <= own.turn_variance < np.inf, "0 or more"),
        ("mountings/cross", joint is None or _is_covariance(joint), "covariances that are possible"),
    ]


def _is_covariance(joint: Array) -> bool:
    """Whether a matrix, whose entries may differ in size, can be a covariance."""
    scale = np.sqrt(np.maximum(np.diagonal(joint), 0))
    scale[scale == 0] = 1.0
    return bool(np.linalg.eigvalsh(joint / np.outer(scale, scale)).min(initial=0) > -SLACK)
