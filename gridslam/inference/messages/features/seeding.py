"""Places of new features, by back-projection of what nothing explains yet; docs/model.md, (M132), (M124).

They are found one by one. What a place would gain hardly ever grows when others explain more, so that gains
that are older than the latest feature serve as bounds, and only the best of them are found anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.features.feature_likelihood import Tables
from gridslam.inference.messages.features.stretch import Stretch

Kinds = NDArray[np.int64]
STEP_M, STEP_RAD = 0.2, np.radians(5.0)
NEAREST_M = 0.3
SHARES = (1.0, 0.6, 0.35, 0.2)
"""Of a candidate's length that are distance; the rest is extra length."""
IMAGE, SCATTERED, FREE = 0, 1, 2
"""What a candidate can be: without extra length, with that of a scatterer to the anchor, or any."""
LEAST_GAIN = 12.0
"""Nats that a feature has to bring."""
MOST_FEATURES = 40
POWERS = np.logspace(-2, 1, 7)
"""Tried, in units of the line of sight's power."""
ITERATIONS, LAST_ITERATIONS = 6, 25
RATES = np.array([0.03, 0.03, 0.01, 5e-3])
"""Steps of Adam: places, extra length (m), and power in units of the line of sight's."""
FAINTEST = 1e-4
"""Least power of a feature, in these units."""
GLANCED, LEAST_GLANCE = 3, 1.0
"""Every which step a first look takes, and nats that a place has to gain there to be looked at again."""
BATCH = 128
"""Places whose gains are found anew together."""
ZOOMS = 2
"""Times that the grid about the best place is made five times finer."""
AROUND, AROUND_FREE = (
    np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3), shares, indexing="ij"), -1).reshape(-1, 3)
    for shares in (np.zeros(1), np.arange(-1.0, 2.0))
)
"""Grid about a place in steps of length, direction and share of distance; of a tied extra length, and any."""
CLOSE = 30.0
"""Nats within which a place of a cheaper kind is moved up as well before one of them is taken."""
TOGETHER, APART_M = 3, 2.0
"""Features that are added at once, and by how much the lengths of their paths have to differ."""
NONE_M = 1e-3


@dataclass(eq=False)
class Gains:
    """What places would gain, as far as known: some gains are older than the latest feature.

    Attributes
    ----------
    places : (Q, 3)
        x, y, extra length, m.
    kinds : (Q,) int64
    gain, power : (Q,)
        Of a feature there, nats; with which power.
    fresh : (Q,) bool
        Whether the gain is that on top of all features up to now.
    length : (Q,)
        Of the path from a place to where the agent was half-way, m.
    """

    places: Array
    kinds: Kinds
    gain: Array
    power: Array
    fresh: NDArray[np.bool_]
    length: Array

    def copy(self) -> Gains:
        """Others of the same values, to go on from."""
        return replace(self, gain=self.gain.copy(), power=self.power.copy(), fresh=self.fresh.copy())

    def age(self, louder: float = 1.0) -> None:
        """There is one more feature, and so much less noise."""
        self.fresh[:] = False
        self.gain *= max(louder, 1.0)

    def best(
        self, price: Array, kind: int | None, stretch: Stretch, left: Tables, beside: Array | None = None
    ) -> int:
        """The place, of this kind or any, that gains most beyond its kind's price; -1: none does enough.

        Parameters
        ----------
        beside : (n,), optional
            Lengths (m) of others: none within `APART_M` of them is taken.
        """
        total = self.gain - price[self.kinds]
        if beside is not None:
            total[(np.abs(self.length[:, None] - beside) < APART_M).any(1)] = -np.inf
        if kind is not None:
            total[self.kinds != kind] = -np.inf
        while len(total):
            top = int(np.argmax(total))
            if total[top] < LEAST_GAIN - price.max() * (kind is not None):
                return -1
            if self.fresh[top]:
                return top
            old = np.flatnonzero(~self.fresh & (total > LEAST_GAIN - price.max()))
            if len(old) > BATCH:
                old = old[np.argpartition(-total[old], BATCH)[:BATCH]]
            found = stretch.front.gains(self.places[old], stretch.points, left, stretch.unit * POWERS)
            self.gain[old], self.power[old] = found.T
            self.fresh[old] = True
            total[old] = np.where(np.isfinite(total[old]), self.gain[old] - price[self.kinds[old]], -np.inf)
        return -1


def first_gains(stretch: Stretch, left: Tables) -> Gains:
    """Gains of all places about a stretch, of what is unexplained (K, T, N, 2)."""
    powers = stretch.unit * POWERS
    places, kinds = candidates(stretch.centre, stretch.front.longest_m, stretch.anchor_m)
    if len(stretch.points) > GLANCED:
        few = slice(GLANCED // 2, None, GLANCED)
        glance = stretch.front.gains(places, stretch.points[few], left[few], powers)[:, 0]
        places, kinds = places[glance > LEAST_GLANCE], kinds[glance > LEAST_GLANCE]
    gain, power = stretch.front.gains(places, stretch.points, left, powers).T.copy()
    length = np.hypot(*(places[:, :2] - stretch.centre).T) + places[:, 2]
    return Gains(places, kinds, gain, power, np.ones(len(places), bool), length)


def candidates(centre: Array, longest_m: float, anchor_m: Array) -> tuple[Array, Kinds]:
    """Places and extra lengths (Q, 3) about a centre, and of which kind each is (Q,)."""
    length = np.arange(NEAREST_M, longest_m, STEP_M)
    direction = np.arange(0, 2 * np.pi, STEP_RAD)
    length, direction = (a.ravel() for a in np.meshgrid(length, direction, indexing="ij"))
    unit = np.column_stack([np.cos(direction), np.sin(direction)])
    rows = [
        np.column_stack([centre + (share * length)[:, None] * unit, (1 - share) * length]) for share in SHARES
    ]
    tied = on_ellipse(length, direction, centre, anchor_m)
    kinds = [IMAGE] * len(length) + [FREE] * ((len(SHARES) - 1) * len(length)) + [SCATTERED] * len(tied)
    return np.concatenate([*rows, tied]), np.array(kinds)


def on_ellipse(length: Array, direction: Array, centre: Array, anchor_m: Array) -> Array:
    """Scatterers [x, y, b] (n, 3) in these directions, by way of which it is so long to the anchor."""
    way, unit = anchor_m - centre, np.column_stack([np.cos(direction), np.sin(direction)])
    reach = length > np.hypot(*way) + NEAREST_M
    length, unit = length[reach], unit[reach]
    far = (length**2 - way @ way) / (2 * (length - unit @ way))
    return np.column_stack([centre + far[:, None] * unit, length - far])[far > NEAREST_M]


def nearer(place: Array, power: float, kind: int, stretch: Stretch, left: Tables) -> tuple[Array, float]:
    """A feature [x, y, b, power] where the gain is highest about a place of the grid, and that gain."""
    centre, step = stretch.centre, np.array([STEP_M, STEP_RAD, 0.2])
    way = place[:2] - centre
    far = float(np.hypot(*way))
    at = np.array([far + place[2], np.arctan2(way[1], way[0]), far / (far + place[2])])
    best, gain = np.array([*place, power]), -np.inf
    for _ in range(ZOOMS):
        step = step / 5
        grid = at + step * (AROUND_FREE if kind == FREE else AROUND)
        grid[:, 2] = np.clip(grid[:, 2], 0.05, 1.0)
        if kind == SCATTERED:
            rows = on_ellipse(grid[:, 0], grid[:, 1], centre, stretch.anchor_m)
        else:
            unit = np.column_stack([np.cos(grid[:, 1]), np.sin(grid[:, 1])])
            shared = grid[:, 2] * grid[:, 0]
            rows = np.column_stack([centre + shared[:, None] * unit, grid[:, 0] - shared])
        if not len(rows):
            break
        found = stretch.front.gains(rows, stretch.points, left, stretch.unit * POWERS)
        top = int(np.argmax(found[:, 0]))
        if found[top, 0] > gain:
            gain, best = float(found[top, 0]), np.array([*rows[top], found[top, 1]])
            far = float(np.hypot(*(best[:2] - centre)))
            at = np.array([far + best[2], np.arctan2(*(best[:2] - centre)[::-1]), far / (far + best[2])])
    return best, gain


class NewFeature(NamedTuple):
    """A feature (4,): x, y, extra length (m) and power; its kind; what it gains beyond its price, nats."""

    feature: Array
    kind: int
    gain: float


def together(gains: Gains, price: Array, stretch: Stretch, left: Tables) -> list[list[NewFeature]]:
    """The best of new features, and others whose paths are too far from its own to depend on it.

    Each may be of any of the kinds that are listed, the best first: all that are in doubt of the first, and
    of others none, or they are left for later.
    """
    found, beside = list[list[NewFeature]](), np.zeros(0)
    while len(found) < TOGETHER:
        top = gains.best(price, None, stretch, left, beside)
        if top < 0:
            break
        # the grid is coarse: what is dearer has to earn its price off it, too
        mine = int(gains.kinds[top])
        rivals = [top, *(gains.best(price, other, stretch, left, beside) for other in range(mine))]
        ends = []
        for row in (r for r in rivals if r >= 0):
            what = int(gains.kinds[row])
            near, gain = nearer(gains.places[row], gains.power[row], what, stretch, left)
            ends.append(NewFeature(near, what, gain - price[what]))
        ends.sort(key=lambda end: end.gain, reverse=True)
        ends = [end for end in ends if end.gain > ends[0].gain - CLOSE]
        if found and len(ends) > 1:
            break
        found.append(ends)
        beside = np.append(beside, gains.length[top])
    return found


def propose(stretch: Stretch, known: Array, left: Tables, gains: Gains, price: Array) -> tuple[Array, Kinds]:
    """New features (n, 4) of an anchor: x, y, extra length (m) and power; and of which kind each is (n,).

    Parameters
    ----------
    known : (D, 4)
        Features that are there already, and stay where they are.
    left : (K, T, N, 2) float32
        What they leave unexplained.
    gains : Gains
        On top of these.
    price : (3,)
        Nats that each kind costs.
    """
    gains, new, kind, fixed = gains.copy(), np.zeros((0, 4)), np.zeros(0, np.int64), len(known)
    while len(known) + len(new) < MOST_FEATURES:
        found = together(gains, price, stretch, left)
        if not found:
            break
        (likely, *doubted), *others = found
        more = [end for (end,) in others][: MOST_FEATURES - len(known) - len(new) - 1]
        risen = []
        for end in (likely, *doubted):
            kinds = np.append(kind, [one.kind for one in (end, *more)])
            table = np.concatenate([known, new, [one.feature for one in (end, *more)]])
            table, value = ascend(stretch, table, kinds, ITERATIONS)
            risen.append((value - price[end.kind], table, kinds))
        _, table, kind = max(risen, key=lambda one: one[0])
        new = table[fixed:]
        quieter, left = stretch.quieter(table)
        gains.age(stretch.points[0, 3] / quieter.points[0, 3])
        stretch = quieter
    if len(new):
        table, _ = ascend(stretch, np.concatenate([known, new]), kind, LAST_ITERATIONS)
        new = table[fixed:]
    strong = new[:, 3] > 0.01 * stretch.unit
    return new[strong], kind[strong]


def ascend(stretch: Stretch, table: Array, kind: Kinds, iterations: int) -> tuple[Array, float]:
    """Features (D, 4) moved by Adam, and the log-likelihood there; but for the last (n,) they stay."""
    plan = np.array([0.0, stretch.unit, FAINTEST, *RATES])
    return stretch.front.climb(
        stretch.points, stretch.steps, table, stretch.anchor_m, stretch.tables, kind, plan, iterations
    )
