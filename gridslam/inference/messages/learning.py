"""New features out of what nothing explains yet; docs/model.md, (M132), (M137).

Seeded one by one by back-projection, moved up the gradient of the log-likelihood along the track, then taken
into the joint belief by going through the segment once more, and kept if they foretell its last steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.feature_likelihood import Front
from gridslam.inference.messages.joint_update import columns, predict, update
from gridslam.inference.messages.sight import feature_table
from gridslam.inference.state.features import MOVING, entries, places
from gridslam.inference.state.hybrid_state import HybridState, JointBelief, Segment
from gridslam.world.signal_model import SignalModel

STEP_M, STEP_RAD = 0.2, np.radians(5.0)
NEAREST_M = 0.3
SHARES = (1.0, 0.6, 0.35, 0.2)
"""Of a candidate's length that are distance; the rest is extra length."""
IMAGE, SCATTERED, FREE = 0, 1, 2
"""What a candidate can be: without extra length, with that of a scatterer to the anchor, or any."""
PRICES = np.array([[0.0, 10.0, 10.0], [10.0, 0.0, 10.0]])
"""Nats that each of these costs, where images are the rule and where scatterers are."""
CLEAR = 10.0
"""Nats by which scatterers have to explain a segment better than images to become the rule."""
LEAST_GAIN = 12.0
"""Nats that a feature has to bring."""
MOST_FEATURES = 40
POWERS = np.logspace(-2, 1, 7)
"""Tried, in units of the line of sight's power."""
ITERATIONS, LAST_ITERATIONS = 20, 60
RATES = np.array([0.03, 0.03, 0.01, 5e-3])
"""Steps of Adam: places, extra length (m), and power in units of the line of sight's."""
JUDGED = 5
"""Last steps of a segment, which new features aren't learned from, but have to foretell."""
LENGTH_STD_M, DIRECTION_STD_RAD, EXTRA_SHARE = 0.3, 0.2, 0.5
"""Of a new feature, before the segment is gone through again."""
NONE_M, TIED_M = 1e-3, 0.1
"""Deviation of an extra length that isn't there, and of a scatterer's from what its place says."""


@dataclass(frozen=True, eq=False)
class Learned:
    """What learning did: features proposed and taken, and what they gain on the steps that judge, nats."""

    proposed: int = 0
    taken: int = 0
    gain: float = 0.0


def replay(
    belief: JointBelief, segment: Segment, before_s: float | None, first_step: int, model: SignalModel
) -> tuple[JointBelief, Array, Array]:
    """Go through a segment from its beginning: belief at its end, evidences (K,), track (K, 4)."""
    evidence, earlier, track = np.zeros(len(segment)), before_s, np.zeros((len(segment), MOVING))
    for k in range(len(segment)):
        if earlier is not None:
            belief = predict(belief, segment.time_s[k] - earlier, model.settings.acceleration_mps2)
        belief, evidence[k] = update(
            belief, segment.samples[k], segment.heard[k], segment.heading_rad[k], model, first_step + k,
            segment.agent[k],
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
    _, without, _ = replay(state.before, segment, state.before_s, first, model)
    for price in usual_prices(state.before, model):
        wider, following = with_proposals(state.before, state, segment, JUDGED, price, front, model)
        proposed = len(wider.features) - old
        if not proposed:
            continue
        found, evidence, _ = replay(wider, segment, state.before_s, first, model)
        if evidence.sum() <= reached + CLEAR:  # in doubt, images are the rule
            continue
        reached, gain = float(evidence.sum()), float((evidence - without)[-JUDGED:].sum())
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


def with_proposals(
    belief: JointBelief, state: HybridState, segment: Segment, judged: int, price: Array, front: Front,
    model: SignalModel,
) -> tuple[JointBelief, int]:  # fmt: skip
    """The belief with all features that a segment proposes but for its last steps; the next identity.

    Features of the state that the belief doesn't hold aren't known yet.
    """
    known = state.joint.keep(np.isin(state.joint.features.identity, belief.features.identity))
    origin, first = segment.agent[len(segment) // 2, :2], state.step - len(segment)
    identity, used = state.next_identity, slice(0, len(segment) - judged)
    for j in range(len(model.anchors)):
        if segment.heard[used, j].sum() <= min(judged, JUDGED):
            continue
        table, kind = propose(known, segment, j, judged, price, front, model)
        for row, what in zip(table, kind, strict=True):
            entry = entries(row[:3], origin)
            width = {IMAGE: NONE_M, SCATTERED: TIED_M, FREE: EXTRA_SHARE * row[2]}[int(what)]
            spread = np.diag(np.square([LENGTH_STD_M, DIRECTION_STD_RAD, width]))
            if what == SCATTERED:
                slope = extra_slopes(entry, model.anchors[j, :2] - origin)
                spread[2] += slope @ spread[:2]
                spread[:, 2] += spread[:, :2] @ slope
            belief = belief.with_feature(j, entry, spread, origin, row[3], identity, first)
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


def propose(
    belief: JointBelief, segment: Segment, anchor: int, judged: int, price: Array, front: Front,
    model: SignalModel,
) -> tuple[Array, NDArray[np.int64]]:  # fmt: skip
    """New features (n, 4) of an anchor: x, y, extra length (m) and power; and of which kind each is (n,)."""
    used = np.flatnonzero(segment.heard[: len(segment) - judged, anchor])
    samples = segment.samples[used, anchor]
    noise, unit = belief.noise[anchor], belief.los_power[anchor]
    points = np.column_stack([segment.agent[used, :2], segment.heading_rad[used], np.full(len(used), noise)])
    steps, anchor_m = np.arange(len(used), dtype=np.int32), model.anchors[anchor, :2]
    climb = Climb(points, steps, front.tables(samples), anchor_m, unit, front)
    candidates, kinds = _candidates(points[len(points) // 2, :2], front.longest_m, anchor_m)
    known = feature_table(belief, anchor)
    new, kind, fixed = np.zeros((0, 4)), np.zeros(0, np.int64), len(known)
    while len(known) + len(new) < MOST_FEATURES:
        table = np.concatenate([known, new])
        left = front.tables(_unexplained(samples, points, table, anchor_m, unit, model))
        gain = front.gains(candidates, points, left, unit * POWERS)
        total = gain[:, 0] - price[kinds]
        best = int(np.argmax(total))
        if total[best] < LEAST_GAIN:
            break
        # the grid is coarse: what is dearer has to earn its price off it, too
        rivals = [best] + [
            int(np.argmax(np.where(kinds == other, total, -np.inf))) for other in range(kinds[best])
        ]
        ends = []
        for row in rivals:
            table = np.concatenate([known, new, [[*candidates[row], gain[row, 1]]]])
            table, value = climb.ascend(table, np.append(kind, kinds[row]), ITERATIONS)
            ends.append((value - price[kinds[row]], table, kinds[row]))
        _, table, what = max(ends, key=lambda end: end[0])
        new, kind = table[fixed:], np.append(kind, what)
    if len(new):
        table, _ = climb.ascend(np.concatenate([known, new]), kind, LAST_ITERATIONS)
        new = table[fixed:]
    strong = new[:, 3] > 0.01 * unit
    return new[strong], kind[strong]


def _candidates(centre: Array, longest_m: float, anchor_m: Array) -> tuple[Array, NDArray[np.int64]]:
    """Places and extra lengths (Q, 3) about a centre, and of which kind each is (Q,)."""
    length = np.arange(NEAREST_M, longest_m, STEP_M)
    direction = np.arange(0, 2 * np.pi, STEP_RAD)
    length, direction = (a.ravel() for a in np.meshgrid(length, direction, indexing="ij"))
    unit = np.column_stack([np.cos(direction), np.sin(direction)])
    rows = [
        np.column_stack([centre + (share * length)[:, None] * unit, (1 - share) * length]) for share in SHARES
    ]
    way = anchor_m - centre
    reach = length > np.hypot(*way) + NEAREST_M  # the ellipse of this length about agent and anchor
    far = (length[reach] ** 2 - way @ way) / (2 * (length[reach] - unit[reach] @ way))
    tied = np.column_stack([centre + far[:, None] * unit[reach], length[reach] - far])[far > NEAREST_M]
    kinds = [IMAGE] * len(length) + [FREE] * ((len(SHARES) - 1) * len(length)) + [SCATTERED] * len(tied)
    return np.concatenate([*rows, tied]), np.array(kinds)


def _unexplained(
    samples: NDArray[np.complex128],
    points: Array,
    table: Array,
    anchor_m: Array,
    unit: float,
    model: SignalModel,
) -> NDArray[np.complex128]:
    """``C^-1 P z`` of every step, (K, N, M)."""
    from gridslam.inference.state.features import FeatureBank

    zeros = np.zeros(len(table), np.int64)
    out = np.empty_like(samples)
    only = replace(model, anchors=np.array([[*anchor_m, 0.0]]))
    power = np.append(SURE_SIGHT * unit, table[:, 3])
    for k, (x, y, heading, noise) in enumerate(points):
        here = np.array([x, y])
        rows = [entries(row[:3], here) for row in table]
        mean = np.concatenate([[x, y, 0, 0], *rows])
        bank = FeatureBank(zeros, zeros, np.tile(here, (len(table), 1)), table[:, 3], zeros, zeros)
        none = np.zeros(1)
        belief = JointBelief(mean, np.zeros((len(mean), len(mean))), bank, none, none, none)
        root = columns(mean, belief, 0, heading, only).value * np.sqrt(power)
        z = samples[k].ravel()
        small = noise * np.eye(len(power)) + root.conj().T @ root
        out[k] = ((z - root @ np.linalg.solve(small, root.conj().T @ z)) / noise).reshape(out[k].shape)
    return out


SURE_SIGHT = 1e3
"""Power of a line of sight, in units of what it is, that takes it out of the samples altogether."""


@dataclass(frozen=True, eq=False)
class Climb:
    """What moving features up the gradient of one anchor's log-likelihood takes.

    Attributes
    ----------
    points : (Q, 4)
        x, y, heading, noise power of each step.
    steps : (Q,) int32
    tables : (Q, N, T, 4)
        Matched outputs.
    anchor_m : (2,)
    unit : float
        Power of the line of sight.
    front : Front
    """

    points: Array
    steps: NDArray[np.int32]
    tables: NDArray[np.float32]
    anchor_m: Array
    unit: float
    front: Front

    def ascend(self, table: Array, kind: NDArray[np.int64], iterations: int) -> tuple[Array, float]:
        """Features (D, 4) moved by Adam, and the log-likelihood there; but for the last (n,) they stay."""
        scale = np.array([1.0, 1.0, 1.0, self.unit])
        moving, floor = slice(len(table) - len(kind), None), np.array([0.0, 1e-4 * self.unit])
        tied, bound = kind == SCATTERED, kind != FREE
        first, second, table = np.zeros((len(kind), 4)), np.zeros((len(kind), 4)), table.copy()
        for i in range(1, iterations + 1):
            slope, _ = self.front.slopes(self.points, self.steps, table, self.anchor_m, self.tables)
            slope, own = slope[moving], table[moving]
            way = own[:, :2] - self.anchor_m
            far = np.maximum(np.hypot(*way.T), NONE_M)[:, None]
            slope[tied, :2] += (slope[:, 2:3] * way / far)[tied]
            slope[bound, 2] = 0.0
            slope = slope * scale
            first = 0.9 * first + 0.1 * slope
            second = 0.999 * second + 0.001 * slope**2
            move = RATES * (first / (1 - 0.9**i)) / (np.sqrt(second / (1 - 0.999**i)) + 1e-12)
            own += scale * move
            own[:, 2:] = np.maximum(own[:, 2:], floor)
            own[tied, 2] = np.hypot(*(own[tied, :2] - self.anchor_m).T)
        _, value = self.front.slopes(self.points, self.steps, table, self.anchor_m, self.tables)
        return table, value
