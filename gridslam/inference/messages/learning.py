"""New features out of what nothing explains yet; docs/model.md, (M132), (M137).

Seeded one by one by back-projection, moved up the gradient of the log-likelihood along the track, then taken
into the joint belief by going through the segment once more, and kept if they foretell its last steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.feature_likelihood import Front
from gridslam.inference.messages.joint_update import predict, update
from gridslam.inference.messages.seeding import (
    FREE,
    IMAGE,
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
from gridslam.inference.state.hybrid_state import HybridState, JointBelief, Segment
from gridslam.world.signal_model import SignalModel

PRICES = np.array([[0.0, 10.0, 10.0], [10.0, 0.0, 10.0]])
"""Nats that each of these costs, where images are the rule and where scatterers are."""
CLEAR = 10.0
"""Nats by which scatterers have to explain a segment better than images to become the rule."""
JUDGED = 5
"""Last steps of a segment, which new features aren't learned from, but have to foretell."""
LENGTH_STD_M, DIRECTION_STD_RAD, EXTRA_SHARE = 0.3, 0.2, 0.5
"""Of a new feature, before the segment is gone through again."""
TIED_M = 0.1
"""Deviation of a scatterer's extra length from what its place says."""


@dataclass(frozen=True, eq=False)
class Learned:
    """What learning did: features proposed and taken, and what they gain on the steps that judge, nats."""

    proposed: int = 0
    taken: int = 0
    gain: float = 0.0


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


def learn(state: HybridState, front: Front, model: SignalModel) -> tuple[HybridState, Learned]:
    """The state with what the segment teaches, and a new segment begun."""
    segment, first = state.segment, state.step - len(state.segment)
    if len(segment) <= 2 * JUDGED:
        return state, Learned()
    old = len(state.before.features)
    joint, learned, identity, reached = state.joint, Learned(), state.next_identity, -np.inf
    looks = surveys(state.before, state, segment, JUDGED, front, model)
    for price in usual_prices(state.before, model):
        wider, following = with_proposals(state.before, state, segment, looks, price, model)
        proposed = len(wider.features) - old
        if not proposed:
            continue
        found, evidence, _ = replay(wider, segment, state.before_s, first, model)
        if evidence.sum() <= reached + CLEAR:  # in doubt, images are the rule
            continue
        reached, gain = float(evidence.sum()), float((evidence - segment.evidence)[-JUDGED:].sum())
        heard = found.features.steps_seen > 0
        heard[:old] = True
        joint, identity = (found.keep(heard), following) if gain > 0 else (state.joint, identity)
        learned = Learned(proposed, int(heard.sum()) - old if gain > 0 else 0, gain)
    return replace(begun(state, joint), next_identity=identity), learned


def usual_prices(belief: JointBelief, model: SignalModel) -> Array:
    """What kinds of features cost, (1 or 2, 3): by the kind of most that are known, or either to be tried."""
    bank = belief.features
    if not len(bank):
        return PRICES
    place = places(belief.mean, bank.origin_m)
    far = np.hypot(*(place[:, :2] - model.anchors[bank.anchor, :2]).T)
    scattered = int((place[:, 2] > 0.5 * far).sum())
    return PRICES[[int(2 * scattered > len(bank))]]


def begun(state: HybridState, joint: JointBelief) -> HybridState:
    """The state with this belief, and an empty segment from here on."""
    empty = Segment.empty(*state.segment.samples.shape[1:])
    return replace(state, joint=joint, before=joint, segment=empty, before_s=state.time_s)


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
    belief: JointBelief, state: HybridState, segment: Segment, judged: int, front: Front, model: SignalModel
) -> list[Survey]:
    """One of every anchor that was heard at more than a few steps, but for a segment's last ones.

    Features of the state that the belief doesn't hold aren't known yet.
    """
    known = state.joint.keep(np.isin(state.joint.features.identity, belief.features.identity))
    used, found = slice(0, len(segment) - judged), []
    for j in range(len(model.anchors)):
        if segment.heard[used, j].sum() > min(judged, JUDGED):
            stretch, table = stretch_of(known, segment, j, judged, front, model), feature_table(known, j)
            found.append(Survey(j, stretch, table, first_gains(stretch, table)))
    return found


def with_proposals(
    belief: JointBelief, state: HybridState, segment: Segment, looks: list[Survey], price: Array,
    model: SignalModel,
) -> tuple[JointBelief, int]:  # fmt: skip
    """The belief with all features that surveys of a segment propose; the next identity."""
    origin, first = segment.agent[len(segment) // 2, :2], state.step - len(segment)
    identity = state.next_identity
    for look in looks:
        table, kind = propose(look.stretch, look.known, look.gains, price)
        for row, what in zip(table, kind, strict=True):
            entry = entries(row[:3], origin)
            width = {IMAGE: NONE_M, SCATTERED: TIED_M, FREE: EXTRA_SHARE * row[2]}[int(what)]
            spread = np.diag(np.square([LENGTH_STD_M, DIRECTION_STD_RAD, width]))
            if what == SCATTERED:
                slope = extra_slopes(entry, model.anchors[look.anchor, :2] - origin)
                spread[2] += slope @ spread[:2]
                spread[:, 2] += spread[:, :2] @ slope
            belief = belief.with_feature(look.anchor, entry, spread, origin, row[3], identity, first)
            identity += 1
    return belief, identity


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
