"""What is proposed as new features of one segment, along the way that the agent is believed to have gone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.features.feature_likelihood import Front, Tables
from gridslam.inference.messages.features.following import START_STEPS
from gridslam.inference.messages.features.path_products import LEAST_M
from gridslam.inference.messages.features.seeding import (
    FREE,
    IMAGE,
    NONE_M,
    SCATTERED,
    Gains,
    first_gains,
    propose,
)
from gridslam.inference.messages.features.sight import feature_table
from gridslam.inference.messages.features.stretch import Stretch, stretch_of
from gridslam.inference.state.features.features import CROWD, CROWD_EXTENT_M, entries
from gridslam.inference.state.features.hybrid_state import JointBelief, Segment
from gridslam.world.signal_model import SignalModel

AMBIGUOUS = 0.3
"""Deviation of an image's extra length, in its length, where nothing tells it from a scatterer: on a short
track, or in a crowd."""
LOOSE = 0.2
"""Deviation of ties in a crowd, in their length: no feature is quite what it is taken for."""
LENGTH_STD_M, DIRECTION_STD_RAD, EXTRA_SHARE = 0.3, 0.2, 0.5
"""Of a new feature, before the segment is gone through again."""
TIED_M = 0.1
"""Deviation of a scatterer's extra length from what its place says."""


@dataclass(frozen=True, eq=False)
class Survey:
    """What an anchor's part of a segment is, and what places about it would gain.

    Attributes
    ----------
    anchor : int
    stretch : Stretch
    known : (D, 4)
        Features that are there already: x, y, extra length (m) and power.
    left : (K, T, N, 2) float32
        What they leave unexplained, see `Stretch.unexplained`.
    gains : Gains
    """

    anchor: int
    stretch: Stretch
    known: Array
    left: Tables
    gains: Gains


def surveys(
    before: JointBelief, after: JointBelief, segment: Segment, judged: int, front: Front, model: SignalModel,
    tables: list[Tables],
) -> list[Survey]:  # fmt: skip
    """One of every anchor that was heard at more than a few steps, but for a segment's last ones.

    Features are where the belief after the segment has them; those that the one before doesn't hold
    aren't known yet.

    Parameters
    ----------
    tables : list of (K or more, N, T, 4) float32
        Matched outputs of every anchor at the segment's steps.
    """
    known = after.keep(np.isin(after.features.identity, before.features.identity))
    used, found = slice(0, len(segment) - judged), []
    for j in range(len(model.anchors)):
        if segment.heard[used, j].sum() > judged:
            stretch, left = stretch_of(known, segment, j, judged, front, model, tables[j])
            found.append(Survey(j, stretch, feature_table(known, j), left, first_gains(stretch, left)))
    return found


def with_proposals(
    belief: JointBelief, segment: Segment, looks: list[Survey], price: Array, first: int, identity: int,
    beside_m: Array, model: SignalModel,
) -> JointBelief:  # fmt: skip
    """The belief with all features that surveys of a segment propose.

    Parameters
    ----------
    beside_m : (2,)
        From the way along which they are proposed to where the agent is believed to begin, (M524).
    first, identity : int
        Number of the segment's first step, and of the next feature.
    """
    origin = segment.agent[len(segment) // 2, :2]
    for look in looks:
        table, kind = propose(look.stretch, look.known, look.left, look.gains, price)
        crowded = len(look.known) + len(table) > CROWD
        if crowded:
            belief = replace(belief, extent=CROWD_EXTENT_M)
        for row, what in zip(table, kind, strict=True):
            entry = entries(row[:3], origin)
            none = AMBIGUOUS * entry[0] if crowded or len(segment) <= START_STEPS else NONE_M
            tied = max(LOOSE * entry[0], TIED_M) if crowded else TIED_M
            width = {IMAGE: none, SCATTERED: tied, FREE: EXTRA_SHARE * row[2]}[int(what)]
            spread = np.diag(np.square([LENGTH_STD_M, DIRECTION_STD_RAD, width]))
            moved = shift_slopes(entry)  # if the agent is elsewhere, so is what it was seen from
            if what == SCATTERED:
                slope = extra_slopes(entry, model.anchors[look.anchor, :2] - origin)
                spread[2] += slope @ spread[:2]
                spread[:, 2] += spread[:, :2] @ slope
                moved[2] = slope @ moved[:2]
            entry = entry + moved @ beside_m
            belief = belief.with_feature(look.anchor, entry, spread, origin, row[3], identity, first, moved)
            identity += 1
    return belief


def shift_slopes(entry: Array) -> Array:
    """Slopes (3, 2) of a feature's entries (3,) by a shift of its place, (M527)."""
    ahead = np.array([np.cos(entry[1]), np.sin(entry[1])])
    aside = np.array([-ahead[1], ahead[0]]) / max(entry[0] - entry[2], LEAST_M)
    return np.stack([ahead, aside, np.zeros(2)])


def extra_slopes(entry: Array, way_m: Array) -> Array:
    """Slopes (2,) of a scatterer's extra length by its length and direction.

    Parameters
    ----------
    entry : (3,)
        Length, direction, extra length, as seen from an origin.
    way_m : (2,)
        From there to the anchor.
    """
    length, far, off = entry[0], np.hypot(*way_m), entry[1] - np.arctan2(way_m[1], way_m[0])
    over, under = length**2 - far**2, length - far * np.cos(off)
    own = np.array([2 * length * under - over, -over * far * np.sin(off)]) / (2 * under**2)
    return np.array([1.0, 0.0]) - own
