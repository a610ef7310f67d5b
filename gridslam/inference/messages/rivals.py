"""Rival sets of new features for one segment, each with the way that it leads: evidence chooses.

What is proposed depends on where the agent is believed to have been, and leads it elsewhere in turn. So
features are proposed again along the way that came of them, for as long as that explains the segment better.
If one stands beside an anchor, all may be beside where it belongs: that is tried, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.feature_likelihood import Front
from gridslam.inference.messages.following import START_STEPS
from gridslam.inference.messages.joint_update import predict, update
from gridslam.inference.messages.seeding import (
    FREE,
    IMAGE,
    LEAST_GAIN,
    NONE_M,
    SCATTERED,
    Gains,
    Stretch,
    first_gains,
    propose,
    stretch_of,
)
from gridslam.inference.messages.sight import feature_table
from gridslam.inference.state.features import MOVING, entries, places
from gridslam.inference.state.hybrid_state import JointBelief, Segment
from gridslam.world.signal_model import SignalModel

PRICES = np.array([[0.0, 10.0, 10.0], [10.0, 0.0, 10.0]])
"""Nats that each of these costs, where images are the rule and where scatterers are."""
CLEAR = 10.0
"""Nats by which one set has to explain a segment better than another to be preferred for it."""
ROUNDS = 3
"""Times, at most, that features are proposed along the way that the ones before led."""
EXTENTS_M = (0.0, 0.05, 0.1)
"""Of features: images are heard at their places, what stands for many scatterers now here, now there."""
UNTOLD = 0.3
"""Deviation of an image's extra length, in its length, on a track too short to tell it from a scatterer."""
MOVED_M = 0.1
"""Ways that are nowhere farther apart lead to the same features."""
SHIFTS, ASTRAY, SMALL_M, STRONG = 2, 3.0, 0.5, 0.2
"""Times that all is shifted. Deviations of the start within which a feature may be a line of sight seen from
a wrong place; its largest extra length, and its least power in that of the line of sight."""
LENGTH_STD_M, DIRECTION_STD_RAD, EXTRA_SHARE = 0.3, 0.2, 0.5
"""Of a new feature, before the segment is gone through again."""
TIED_M = 0.1
"""Deviation of a scatterer's extra length from what its place says."""


class Rival(NamedTuple):
    """A set of features, and what the segment says of it.

    Attributes
    ----------
    score : float
        Log of the segment's evidence, less what so many features cost, nats.
    joint : JointBelief
        At the segment's end.
    track : (K, 4)
    evidence : (K,)
        Log of each step's.
    start : JointBelief
        With the set at the segment's beginning.
    """

    score: float
    joint: JointBelief
    track: Array
    evidence: Array
    start: JointBelief


@dataclass(frozen=True, eq=False)
class Lesson:
    """What rival sets of features have in common.

    Attributes
    ----------
    before : JointBelief
        At the beginning of the segment.
    before_s : float or None
        Time of the step before it.
    first, identity : int
        Number of its first step; of the next feature.
    judged : int
        Its last steps, of which no feature is made.
    front : Front
    model : SignalModel
    """

    before: JointBelief
    before_s: float | None
    first: int
    identity: int
    judged: int
    front: Front
    model: SignalModel

    def rivals(
        self, segment: Segment, after: JointBelief, prices: Array, taught: Segment | None = None
    ) -> list[Rival]:
        """What is proposed along the way of the agent in a segment, one set for each row of prices.

        Parameters
        ----------
        after : JointBelief
            At the end of the segment, as far as known.
        taught : Segment, optional
            The part of the segment of which features are made, instead of all but what is judged.
        """
        part = segment if taught is None else taught
        looks = surveys(self.before, after, part, self.judged, self.front, self.model)
        found = []
        for price in prices:
            wider = with_proposals(self.before, part, looks, price, self.first, self.identity, self.model)
            rival = self.judge(wider, segment)
            doubtful = self.sights(rival.joint)
            if doubtful.any():
                without = self.judge(wider.keep(~doubtful), segment)
                rival = max(rival, without, key=lambda one: one.score)
            found.append(rival)
        return found

    def judge(self, belief: JointBelief, segment: Segment) -> Rival:
        """What comes of a belief at the segment's beginning."""
        joint, evidence, track = replay(belief, segment, self.before_s, self.first, self.model)
        cost = LEAST_GAIN * (len(belief.features) - len(self.before.features))
        return Rival(float(evidence.sum()) - cost, joint, track, evidence, belief)

    def climb(self, rival: Rival, segment: Segment, price: Array) -> Rival:
        """The best of a set of features and those that are proposed along the way that it leads.

        The segment has the way along which the set itself was proposed.
        """
        for _ in range(ROUNDS):
            if apart(rival.track, segment.agent) < MOVED_M:
                return rival
            segment = replace(segment, agent=rival.track)
            (following,) = self.rivals(segment, rival.joint, price[None])
            if following.score < rival.score + CLEAR:
                return max(rival, following, key=lambda one: one.score)
            rival = following
        return rival

    def best(self, rivals: list[Rival], ways: list[Segment], price: Array) -> Rival:
        """The best of several sets, after each has climbed, and of what a shift of the best makes of it.

        Before any feature is known, nothing but the start and the lines of sight says where all of it is.

        Parameters
        ----------
        ways : list of Segment
            With the way along which each set was proposed.
        """
        climbed: list[Rival] = []
        for rival, segment in zip(rivals, ways, strict=True):
            known = any(apart(rival.track, one.track) < MOVED_M for one in climbed)
            climbed.append(rival if known else self.climb(rival, segment, price))
        found = max(climbed, key=lambda one: one.score)
        if len(self.before.features):
            return found
        for _ in range(SHIFTS):
            shift = self.shift(found)
            if shift is None:
                return found
            along = replace(ways[0], agent=found.track + np.append(shift, np.zeros(2)))
            (rival,) = self.rivals(along, found.joint, price[None])
            rival = self.climb(rival, along, price)
            if rival.score <= found.score:
                return found
            found = rival
        return found

    def settled(self, rival: Rival, segment: Segment) -> Rival:
        """The same set with another extent of features, where that clearly explains the segment better."""
        along = replace(segment, agent=rival.track)
        others = [one for one in EXTENTS_M if one != rival.start.extent]
        found = [self.judge(replace(rival.start, extent=one), along) for one in others]
        best = max(found, key=lambda one: one.score)
        return best if best.score > rival.score + CLEAR else rival

    def sights(self, joint: JointBelief) -> NDArray[np.bool_]:
        """Which new features may be a line of sight that is seen from a wrong place, (F,)."""
        place, bank = places(joint.mean, joint.features.origin_m), joint.features
        reach = ASTRAY * np.sqrt(np.trace(self.before.agent_covariance[:2, :2]) / 2)
        gap = np.hypot(*(self.model.anchors[bank.anchor, :2] - place[:, :2]).T)
        strong = bank.power > STRONG * joint.los_power[bank.anchor]
        near: NDArray[np.bool_] = (gap < reach) & (place[:, 2] < SMALL_M) & strong
        near[: len(self.before.features)] = False
        return near

    def shift(self, rival: Rival) -> Array | None:
        """How far (2,) m all has to move for the strongest feature of `sights` to be an anchor."""
        near, bank = self.sights(rival.joint), rival.joint.features
        if not near.any():
            return None
        top = int(np.argmax(np.where(near, bank.power, 0.0)))
        shift: Array = self.model.anchors[bank.anchor[top], :2]
        return shift - places(rival.joint.mean, bank.origin_m)[top, :2]


def apart(one: Array, other: Array) -> float:
    """Largest distance (m) between two ways (K, 4) at the same step."""
    return float(np.hypot(*(one - other)[:, :2].T).max())


def replay(
    belief: JointBelief, segment: Segment, before_s: float | None, first_step: int, model: SignalModel,
    led: bool = True,
) -> tuple[JointBelief, Array, Array]:  # fmt: skip
    """Go through a segment from its beginning: belief at its end, evidences (K,), track (K, 4).

    Parameters
    ----------
    led : bool
        Whether each maximum is looked for from where the agent was believed to be then, else from where
        it is predicted.
    """
    evidence, earlier, track = np.zeros(len(segment)), before_s, np.zeros((len(segment), MOVING))
    for k in range(len(segment)):
        if earlier is not None:
            belief = predict(belief, segment.time_s[k] - earlier, model.settings.acceleration_mps2)
        belief, evidence[k] = update(
            belief, segment.samples[k], segment.heard[k], segment.heading_rad[k], model, first_step + k,
            segment.agent[k] if led else None,
        )  # fmt: skip
        earlier, track[k] = float(segment.time_s[k]), belief.mean[:MOVING]
    return belief, evidence, track


def usual_prices(belief: JointBelief, model: SignalModel) -> Array:
    """What kinds of features cost, (1 or 2, 3): by the kind of most that are known, or either to be tried."""
    bank = belief.features
    if not len(bank):
        return PRICES
    place = places(belief.mean, bank.origin_m)
    far = np.hypot(*(place[:, :2] - model.anchors[bank.anchor, :2]).T)
    scattered = int((place[:, 2] > 0.5 * far).sum())
    return PRICES[[int(2 * scattered > len(bank))]]


@dataclass(frozen=True, eq=False)
class Survey:
    """What an anchor's part of a segment is, and what places about it would gain.

    Attributes
    ----------
    anchor : int
    stretch : Stretch
    known : (D, 4)
        Features that are there already: x, y, extra length (m) and power.
    gains : Gains
    """

    anchor: int
    stretch: Stretch
    known: Array
    gains: Gains


def surveys(
    before: JointBelief, after: JointBelief, segment: Segment, judged: int, front: Front, model: SignalModel
) -> list[Survey]:
    """One of every anchor that was heard at more than a few steps, but for a segment's last ones.

    Features are where the belief after the segment has them; those that the one before doesn't hold
    aren't known yet.
    """
    known = after.keep(np.isin(after.features.identity, before.features.identity))
    used, found = slice(0, len(segment) - judged), []
    for j in range(len(model.anchors)):
        if segment.heard[used, j].sum() > judged:
            stretch, table = stretch_of(known, segment, j, judged, front, model), feature_table(known, j)
            found.append(Survey(j, stretch, table, first_gains(stretch, table)))
    return found


def with_proposals(
    belief: JointBelief, segment: Segment, looks: list[Survey], price: Array, first: int, identity: int,
    model: SignalModel,
) -> JointBelief:  # fmt: skip
    """The belief with all features that surveys of a segment propose.

    Parameters
    ----------
    first, identity : int
        Number of the segment's first step, and of the next feature.
    """
    origin = segment.agent[len(segment) // 2, :2]
    for look in looks:
        table, kind = propose(look.stretch, look.known, look.gains, price)
        for row, what in zip(table, kind, strict=True):
            entry = entries(row[:3], origin)
            none = UNTOLD * entry[0] if len(segment) <= START_STEPS else NONE_M
            width = {IMAGE: none, SCATTERED: TIED_M, FREE: EXTRA_SHARE * row[2]}[int(what)]
            spread = np.diag(np.square([LENGTH_STD_M, DIRECTION_STD_RAD, width]))
            if what == SCATTERED:
                slope = extra_slopes(entry, model.anchors[look.anchor, :2] - origin)
                spread[2] += slope @ spread[:2]
                spread[:, 2] += spread[:, :2] @ slope
            belief = belief.with_feature(look.anchor, entry, spread, origin, row[3], identity, first)
            identity += 1
    return belief


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
