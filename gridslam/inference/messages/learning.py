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
from gridslam.inference.state.features import entries
from gridslam.inference.state.hybrid_state import HybridState, JointBelief, Segment
from gridslam.world.signal_model import SignalModel

STEP_M, STEP_RAD = 0.2, np.radians(5.0)
NEAREST_M = 0.3
SHARES = (1.0, 0.6, 0.35, 0.2)
"""Of a candidate's length that are distance; the rest is extra length."""
PRICE, LEAST_GAIN = 10.0, 12.0
"""Nats that an extra length costs, and that a feature has to bring."""
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
NONE_M = 1e-3
"""Deviation of an extra length that isn't there."""


@dataclass(frozen=True, eq=False)
class Learned:
    """What learning did: features proposed and taken, and what they gain on the steps that judge, nats."""

    proposed: int = 0
    taken: int = 0
    gain: float = 0.0


def replay(
    belief: JointBelief, segment: Segment, before_s: float | None, first_step: int, model: SignalModel
) -> tuple[JointBelief, Array]:
    """Go through a segment from the belief at its beginning: the belief at its end, and evidences (K,)."""
    evidence, earlier = np.zeros(len(segment)), before_s
    for k in range(len(segment)):
        if earlier is not None:
            belief = predict(belief, segment.time_s[k] - earlier, model.settings.acceleration_mps2)
        belief, evidence[k] = update(
            belief, segment.samples[k], segment.heard[k], segment.heading_rad[k], model, first_step + k,
            segment.agent[k],
        )  # fmt: skip
        earlier = float(segment.time_s[k])
    return belief, evidence


def learn(state: HybridState, front: Front, model: SignalModel) -> tuple[HybridState, Learned]:
    """The state with what the segment teaches, and a new segment begun."""
    segment, first = state.segment, state.step - len(state.segment)
    if len(segment) <= 2 * JUDGED:
        return state, Learned()
    origin = segment.agent[len(segment) // 2, :2]
    wider, identity, proposed = state.before, state.next_identity, 0
    for j in range(len(model.anchors)):
        if segment.heard[:-JUDGED, j].sum() <= JUDGED:
            continue
        for x, y, extra, power in propose(state.joint, segment, j, front, model):
            entry = entries(np.array([x, y, extra]), origin)
            width = max(EXTRA_SHARE * extra, NONE_M)
            spread = np.diag(np.square([LENGTH_STD_M, DIRECTION_STD_RAD, width]))
            wider = wider.with_feature(j, entry, spread, origin, power, identity, first)
            identity, proposed = identity + 1, proposed + 1
    joint, learned = state.joint, Learned()
    if proposed:
        _, without = replay(state.before, segment, state.before_s, first, model)
        found, with_them = replay(wider, segment, state.before_s, first, model)
        gain = float((with_them - without)[-JUDGED:].sum())
        heard = found.features.steps_seen > 0
        heard[: len(state.before.features)] = True
        if gain > 0:
            joint = found.keep(heard)
        learned = Learned(proposed, int(heard.sum() - len(state.before.features)) if gain > 0 else 0, gain)
    empty = Segment.empty(*segment.samples.shape[1:])
    return replace(
        state, joint=joint, before=joint, segment=empty, before_s=state.time_s, next_identity=identity
    ), learned


def propose(belief: JointBelief, segment: Segment, anchor: int, front: Front, model: SignalModel) -> Array:
    """New features (n, 4) of an anchor: x, y, extra length (m) and power."""
    used = np.flatnonzero(segment.heard[:-JUDGED, anchor])
    samples = segment.samples[used, anchor]
    noise, unit = belief.noise[anchor], belief.los_power[anchor]
    points = np.column_stack([segment.agent[used, :2], segment.heading_rad[used], np.full(len(used), noise)])
    steps, anchor_m = np.arange(len(used), dtype=np.int32), model.anchors[anchor, :2]
    tables = front.tables(samples)
    candidates, price = _candidates(points[len(points) // 2, :2], front.longest_m)
    known = feature_table(belief, anchor)
    new, fixed = np.zeros((0, 4)), len(known)
    while len(known) + len(new) < MOST_FEATURES:
        table = np.concatenate([known, new])
        left = front.tables(_unexplained(samples, points, table, anchor_m, unit, model))
        gain = front.gains(candidates, points, left, unit * POWERS)
        total = gain[:, 0] - price
        best = int(np.argmax(total))
        if total[best] < LEAST_GAIN:
            break
        rivals = [best]
        if price[best] > 0:  # the grid is coarse: an extra length has to earn its price off it, too
            rivals.append(int(np.argmax(np.where(price > 0, -np.inf, total))))
        ends = []
        for row in rivals:
            table = np.concatenate([known, new, [[*candidates[row], gain[row, 1]]]])
            table = _ascend(table, fixed, points, steps, tables, anchor_m, unit, ITERATIONS, front)
            _, value = front.slopes(points, steps, table, anchor_m, tables)
            ends.append((value - price[row], table))
        new = max(ends, key=lambda end: end[0])[1][fixed:]
    if len(new):
        table = np.concatenate([known, new])
        new = _ascend(table, fixed, points, steps, tables, anchor_m, unit, LAST_ITERATIONS, front)[fixed:]
    return new[new[:, 3] > 0.01 * unit] if len(new) else new


def _candidates(centre: Array, longest_m: float) -> tuple[Array, Array]:
    """Places and extra lengths (Q, 3) about a centre, and what each costs (Q,)."""
    length = np.arange(NEAREST_M, longest_m, STEP_M)
    direction = np.arange(0, 2 * np.pi, STEP_RAD)
    length, direction = (a.ravel() for a in np.meshgrid(length, direction, indexing="ij"))
    rows = [
        np.column_stack(
            [centre + (share * length)[:, None] * np.column_stack([np.cos(direction), np.sin(direction)]),
             (1 - share) * length]
        )
        for share in SHARES
    ]  # fmt: skip
    return np.concatenate(rows), np.repeat([0.0] + [PRICE] * (len(SHARES) - 1), len(length))


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


def _ascend(
    table: Array, fixed: int, points: Array, steps: NDArray[np.int32], tables: NDArray[np.float32],
    anchor_m: Array, unit: float, iterations: int, front: Front,
) -> Array:  # fmt: skip
    """Features moved up the gradient by Adam; the first ones and extra lengths of 0 stay."""
    scale = np.array([1.0, 1.0, 1.0, unit])
    free = np.ones_like(table)
    free[:fixed] = 0.0
    free[table[:, 2] == 0, 2] = 0.0
    first, second, table = np.zeros_like(table), np.zeros_like(table), table.copy()
    for i in range(1, iterations + 1):
        slope, _ = front.slopes(points, steps, table, anchor_m, tables)
        slope = slope * scale
        first = 0.9 * first + 0.1 * slope
        second = 0.999 * second + 0.001 * slope**2
        move = RATES * (first / (1 - 0.9**i)) / (np.sqrt(second / (1 - 0.999**i)) + 1e-12)
        table = table + free * scale * move
        table[:, 2:] = np.maximum(table[:, 2:], np.where(free[:, 2:] > 0, [0.0, 1e-4 * unit], table[:, 2:]))
    return table
