"""Places of new features, by back-projection of what nothing explains yet; docs/model.md, (M132), (M124).

They are found one by one. What a place would gain hardly ever grows when others explain more, so that gains
that are older than the latest feature serve as bounds, and only the best of them are found anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.features.feature_likelihood import Front, Tables
from gridslam.inference.messages.features.sight import feature_table
from gridslam.inference.state.features.hybrid_state import JointBelief, Segment
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]
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
ITERATIONS, LAST_ITERATIONS = 12, 40
RATES = np.array([0.03, 0.03, 0.01, 5e-3])
"""Steps of Adam: places, extra length (m), and power in units of the line of sight's."""
GLANCED, LEAST_GLANCE = 3, 1.0
"""Every which step a first look takes, and nats that a place has to gain there to be looked at again."""
BATCH = 512
"""Places whose gains are found anew together."""
ZOOMS = 2
"""Times that the grid about the best place is made five times finer."""
CLOSE = 30.0
"""Nats within which a place of a cheaper kind is moved up as well before one of them is taken."""
NONE_M = 1e-3
SURE_SIGHT = 1e3
"""Power of a line of sight, in units of what it is, that takes it out of the samples altogether."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """What one anchor sent during a part of a segment, and where the agent was.

    Attributes
    ----------
    points : (K, 4)
        x, y, heading, noise power of each step.
    samples : (K, N, M) complex128
    anchor_m : (2,)
    unit : float
        Power of the line of sight.
    front : Front
    steps : (K,) int32
        Which table each point takes.
    tables : (K or more, N, T, 4) float32
        Matched outputs of samples.
    """

    points: Array
    samples: Complex
    anchor_m: Array
    unit: float
    front: Front
    steps: NDArray[np.int32]
    tables: Tables

    @property
    def centre(self) -> Array:
        """Where the agent was half-way, (2,) m."""
        middle: Array = self.points[len(self.points) // 2, :2]
        return middle

    @property
    def scale(self) -> Array:
        """Scale of places, extra lengths (m) and powers, (4,)."""
        return np.array([1.0, 1.0, 1.0, self.unit])

    def rest(self, table: Array) -> Complex:
        """What line of sight and features (D, 4) leave of the samples, (K, N, M)."""
        wave, points = self.front.waveform, self.points
        place = np.concatenate([[[*self.anchor_m, 0.0, SURE_SIGHT * self.unit]], table])
        way = place[:, :2] - points[:, None, :2]
        far = np.maximum(np.hypot(way[..., 0], way[..., 1]), NEAREST_M / 3)
        length = far + place[:, 2]
        angle = np.arctan2(way[..., 1], way[..., 0]) - points[:, 2:3]
        turned = np.stack([np.cos(angle), np.sin(angle)], -1) @ self.front.element.T  # (K, C, N)
        antennas = np.exp(1j * np.moveaxis(turned, -1, 1)) * np.sqrt(place[:, 3])
        rate = 2 * np.pi / SPEED_OF_LIGHT * wave.offset_hz
        spectrum = wave.pulse[:, None] * np.exp(-1j * rate[:, None] * length[:, None]) / length[:, None]
        upright, across = antennas.conj().swapaxes(1, 2), spectrum.conj().swapaxes(1, 2)
        small = (upright @ antennas) * (across @ spectrum)
        noise = points[:, 3]
        small[:, np.arange(len(place)), np.arange(len(place))] += noise[:, None]
        matched = ((across @ self.samples.swapaxes(1, 2)) * upright).sum(-1)
        amplitude = np.linalg.solve(small, matched[..., None])[..., 0]
        return self.samples - (antennas * amplitude[:, None]) @ spectrum.swapaxes(1, 2)

    def unexplained(self, table: Array) -> Tables:
        """Matched outputs of ``C^-1 P z`` under features (D, 4), (K, T, N, 2)."""
        return self._matched(self.rest(table))

    def quieter(self, table: Array) -> tuple[Stretch, Tables]:
        """The same with the noise's power that features (D, 4) leave, and what is unexplained then."""
        rest = self.rest(table)
        free = rest[0].size - 1 - len(table)
        noise = float((np.abs(rest) ** 2).sum() / (len(rest) * free))
        points = self.points.copy()
        points[:, 3] = noise
        quiet = replace(self, points=points)
        return quiet, quiet._matched(rest)

    def _matched(self, rest: Complex) -> Tables:
        """Matched outputs of what is left of the samples, in units of the noise."""
        return self.front.coarse(rest / self.points[:, 3, None, None])


def stretch_of(
    belief: JointBelief, segment: Segment, anchor: int, judged: int, front: Front, model: SignalModel,
    tables: Tables | None = None,
) -> tuple[Stretch, Tables]:  # fmt: skip
    """A segment of an anchor but for its last steps, with the noise that what a belief holds leaves.

    And what is unexplained then, (K, T, N, 2).

    Parameters
    ----------
    tables : (K, N, T, 4) float32, optional
        Matched outputs of this anchor's samples at all steps, if they are known.
    """
    used = np.flatnonzero(segment.heard[: len(segment) - judged, anchor])
    noise = np.full(len(used), belief.noise[anchor])
    points = np.column_stack([segment.agent[used, :2], segment.heading_rad[used], noise])
    power = float(belief.los_power[anchor])
    samples, anchor_m = segment.samples[used, anchor], model.anchors[anchor, :2].copy()
    steps = used.astype(np.int32)
    if tables is None:
        steps, tables = np.arange(len(used), dtype=np.int32), front.tables(samples)
    raw = Stretch(points, samples, anchor_m, power, front, steps, tables)
    return raw.quieter(feature_table(belief, anchor))


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
    """

    places: Array
    kinds: Kinds
    gain: Array
    power: Array
    fresh: NDArray[np.bool_]

    def copy(self) -> Gains:
        """Others of the same values, to go on from."""
        return Gains(self.places, self.kinds, self.gain.copy(), self.power.copy(), self.fresh.copy())

    def age(self, louder: float = 1.0) -> None:
        """There is one more feature, and so much less noise."""
        self.fresh[:] = False
        self.gain *= max(louder, 1.0)

    def best(self, price: Array, kind: int | None, stretch: Stretch, left: Tables) -> int:
        """The place, of this kind or any, that gains most beyond its kind's price; -1: none does enough."""
        total = self.gain - price[self.kinds]
        if kind is not None:
            total[self.kinds != kind] = -np.inf
        while True:
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


def first_gains(stretch: Stretch, left: Tables) -> Gains:
    """Gains of all places about a stretch, of what is unexplained (K, T, N, 2)."""
    powers = stretch.unit * POWERS
    places, kinds = candidates(stretch.centre, stretch.front.longest_m, stretch.anchor_m)
    gain, power = np.full(len(places), -np.inf), np.zeros(len(places))
    keep = np.ones(len(places), bool)
    if len(stretch.points) > GLANCED:
        few = slice(GLANCED // 2, None, GLANCED)
        glance = stretch.front.gains(places, stretch.points[few], left[few], powers)[:, 0]
        keep = glance > LEAST_GLANCE
    gain[keep], power[keep] = stretch.front.gains(places[keep], stretch.points, left, powers).T
    return Gains(places, kinds, gain, power, np.ones(len(places), bool))


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
        ways = [np.arange(-2, 3), np.arange(-2, 3), np.arange(-1, 2) if kind == FREE else np.zeros(1)]
        grid = at + step * np.stack(np.meshgrid(*ways, indexing="ij"), -1).reshape(-1, 3)
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
        top = gains.best(price, None, stretch, left)
        if top < 0:
            break
        # the grid is coarse: what is dearer has to earn its price off it, too
        mine = int(gains.kinds[top])
        rivals = [top, *(gains.best(price, other, stretch, left) for other in range(mine))]
        ends = []
        for row in (r for r in rivals if r >= 0):
            what = int(gains.kinds[row])
            near, gain = nearer(gains.places[row], gains.power[row], what, stretch, left)
            ends.append((gain - price[what], near, what))
        highest = max(end[0] for end in ends)
        risen = []
        for _, near, what in (end for end in ends if end[0] > highest - CLOSE):
            table = np.concatenate([known, new, [near]])
            table, value = ascend(stretch, table, np.append(kind, what), ITERATIONS)
            risen.append((value - price[what], table, what))
        _, table, what = max(risen, key=lambda end: end[0])
        new, kind = table[fixed:], np.append(kind, what)
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
    moving, floor = slice(len(table) - len(kind), None), np.array([0.0, 1e-4 * stretch.unit])
    tied, bound = kind == SCATTERED, kind != FREE
    first, second, table = np.zeros((len(kind), 4)), np.zeros((len(kind), 4)), table.copy()
    here = stretch.points, stretch.steps

    def rise() -> tuple[Array, float]:
        return stretch.front.slopes(*here, table, stretch.anchor_m, stretch.tables, len(table) - len(kind))

    for i in range(1, iterations + 1):
        slope, own = rise()[0][moving], table[moving]
        way = own[:, :2] - stretch.anchor_m
        far = np.maximum(np.hypot(*way.T), NONE_M)[:, None]
        slope[tied, :2] += (slope[:, 2:3] * way / far)[tied]
        slope[bound, 2] = 0.0
        slope = slope * stretch.scale
        first = 0.9 * first + 0.1 * slope
        second = 0.999 * second + 0.001 * slope**2
        move = RATES * (first / (1 - 0.9**i)) / (np.sqrt(second / (1 - 0.999**i)) + 1e-12)
        own += stretch.scale * move
        own[:, 2:] = np.maximum(own[:, 2:], floor)
        own[tied, 2] = np.hypot(*(own[tied, :2] - stretch.anchor_m).T)
    return table, rise()[1]
