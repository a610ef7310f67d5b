"""Particles: equally weighted joint samples of agent and surfaces, at which paths are evaluated.

They are drawn from the correlated belief whenever it is needed, from one fixed set of normal points, so
that nothing degenerates and a run repeats bit for bit. Each stands for a small Gaussian instead of a point
(a regularised particle filter): a share h^2 of the covariance is kept for the likelihood, by which a few
particles suffice where a likelihood is sharp, and in the linear case the mean is exact for any number.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import HEADING, StateLayout
from gridslam.inference.beliefs.streams import POINTS
from gridslam.kernels import PATH_BLOCK, ROOT_GIVEN, STATE_GIVEN, TAKE_ROOT
from gridslam.kernels.primitives.blocks import Draft

Single = NDArray[np.float32]
DIVERGENCE, SURE = 0.15, 2.33
"""Kullback-Leibler divergence that an adapted number of particles keeps below, and how sure that is: 99 %.
At a third of it, with three times as many, errors are the same within 0.15 %."""
BIN_M, BIN_RAD = 0.05, 0.03
"""Bins over which it is counted: about what one measurement tells."""
PORTION = 512
"""Adapted numbers come in portions, each with mean 0 and deviation 1."""


GOLDEN = 2654435769
"""2^32 over the golden ratio: its multiples, and theirs, are spread evenly over the remainders."""
NO_POINTS = np.empty((0, 0), np.float32)
NO_BELIEF = Belief(np.empty(0), np.empty((0, 0)))


@dataclass(frozen=True)
class Cloud:
    """Joint samples.

    Attributes
    ----------
    state : (3 + 3 S + J, P) float32 or float64
        x, y (m) and heading (rad); unit normal and offset (m) of every surface; differences of clocks, or
        rises (m), if these are unknown. Particles stay on the device that computes.
    bandwidth : float
        h^2: bandwidth, as a share of the covariance.
    unknowns : int
        J or G, 0 if clocks and heights are known.
    """

    state: runtime.Resident
    bandwidth: float
    unknowns: int = 0

    @property
    def surfaces(self) -> int:
        """Number of surfaces S."""
        return (self.state.shape[0] - self.unknowns) // 3 - 1


def rows_of(layout: StateLayout) -> int:
    """Rows of particles: the agent's pose, every line's normal and offset, and clocks or rises."""
    return 3 + 3 * layout.surfaces + layout.unknowns


@dataclass(frozen=True)
class Recipe:
    """How to draw particles: states ``base + root points``.

    Attributes
    ----------
    layout : StateLayout
    root : (N, N) float32
        Root of the share of the covariance that is drawn.
    base : (N, 3) float32
        Mean, and its cosine and sine.
    points : (N or more, P or more) float32
        Standard normal; where the device has them.
    count : int
        P.
    bandwidth : float
        Bandwidth, as a share of the covariance.
    """

    layout: StateLayout
    root: Single
    base: Single
    points: runtime.Resident
    count: int
    bandwidth: float

    @property
    def room(self) -> tuple[int, int]:
        """Shape of the states."""
        return rows_of(self.layout), self.count


def at_mean(belief: Belief) -> Cloud:
    """The belief's mean as a single sample, without clocks."""
    mean, layout = belief.mean, belief.layout
    state = np.empty((3 + 3 * len(belief.lines), 1))
    state[:2, 0], state[2, 0], angle = mean[:2], mean[HEADING], mean[layout.angles]
    state[3::3, 0], state[4::3, 0], state[5::3, 0] = np.cos(angle), np.sin(angle), mean[layout.offsets]
    return Cloud(state, 0.0)


def draft_of(layout: StateLayout, samples: int) -> Draft:
    """Reusable buffers to sample a belief of this layout with, but for the points; room for some samples."""
    size = layout.size
    square, state = (size, size), np.empty((rows_of(layout), samples))
    root, base = np.empty(square, np.float32), np.empty((size, 3), np.float32)
    return Draft(NO_POINTS, np.empty(square), root, base, state, np.empty(1, np.int32))


@dataclass(frozen=True)
class Sampling:
    """How a kernel comes by exact samples: it draws them from a belief, or is given them.

    Attributes
    ----------
    belief : Belief
    points : (N or more, P) float32
        Standard normal; where the device has them.
    first : int
        Of the points that are taken, one for each sample; after the last comes the first.
    draft : Draft
    given : bool
        Whether the draft holds the samples already.
    """

    belief: Belief
    points: runtime.Resident
    first: int
    draft: Draft
    given: bool = False

    @classmethod
    def of(cls, belief: Belief, points: runtime.Resident, first: int, draft: Draft) -> Sampling:
        """As many samples by standard normal points as the draft has room for.

        Raises
        ------
        ValueError
            The points have fewer entries than the belief, or the draft is of another size.
        """
        size = len(belief.mean)
        if points.shape[0] < size or len(draft.whole) != size:
            raise ValueError(f"points of {points.shape[0]} entries for a belief of {size}")
        return cls(belief, points, first, Draft(points, *draft[1:]))

    @classmethod
    def at(cls, cloud: Cloud) -> Sampling:
        """Samples that are there already."""
        draft = draft_of(StateLayout(), 0)._replace(state=cloud.state)
        draft.failed[0] = 0
        return cls(NO_BELIEF, NO_POINTS, 0, draft, given=True)

    @property
    def head(self) -> int:
        """First entry of the lines."""
        return 0 if self.given else self.belief.layout.head

    def attempts(self) -> Iterator[tuple[int, Draft]]:
        """What a kernel is to make ready, and with what; if the covariance is singular, with another root."""
        yield STATE_GIVEN if self.given else TAKE_ROOT, self.draft
        if self.draft.failed[0]:
            yield ROOT_GIVEN, self.draft._replace(whole=np.ascontiguousarray(self.belief.root))


def needed(belief: Belief) -> float:
    """Number of particles by which a sampled pose comes within `DIVERGENCE` of its belief (KLD sampling).

    As in [Fox2003kld], eq. (7), over the bins within three deviations of the pose that is believed in.
    """
    (xx, xy), (_, yy) = belief.covariance[:2, :2].tolist()
    middle, apart = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)  # eigenvalues, in plain numbers
    turn = float(belief.covariance[HEADING, HEADING]) / BIN_RAD**2
    spreads = (middle - apart) / BIN_M**2, (middle + apart) / BIN_M**2, turn
    free = max(math.prod(math.ceil(6 * math.sqrt(max(spread, 0.0))) for spread in spreads) - 1.0, 1.0)
    part = 2 / (9 * free)
    return float(free / (2 * DIVERGENCE) * (1 - part + np.sqrt(part) * SURE) ** 3)


@lru_cache(16)
def _shrinkage(count: int) -> float:
    """Silverman's rule for a path's three parameters."""
    return float(count ** (-2 / 7))


def turned(points: Single, belief: Belief) -> Single:
    """Normal points of position and velocity (4, P) such that samples turn with the agent.

    docs/model.md, (M209), in plain numbers: threads of a linear algebra wait for each other longer than
    this takes. As they are, if the covariance is singular.
    """
    heading, own = float(belief.mean[HEADING]), belief.covariance[:4, :4].tolist()
    (xx, xy, _, _), (_, yy, _, _), (ux, uy, uu, uv), (vx, vy, _, vv) = own
    determinant = xx * yy - xy * xy
    if not (xx > 0 and determinant > 0):
        return points
    # of the velocity, what the position doesn't tell
    by_u = (yy * ux - xy * uy) / determinant, (xx * uy - xy * ux) / determinant
    by_v = (yy * vx - xy * vy) / determinant, (xx * vy - xy * vx) / determinant
    uu, uv, vv = (
        rest - by[0] * x - by[1] * y
        for rest, by, x, y in ((uu, by_u, ux, uy), (uv, by_u, vx, vy), (vv, by_v, vx, vy))
    )
    spreads, ahead = ((xx, xy, yy), (uu, uv, vv)), (math.cos(heading), math.sin(heading))
    turns = [turn for spread in spreads if (turn := _turn(*spread, *ahead)) is not None]
    if len(turns) < len(spreads):
        return points
    (cosine, sine), (x, y) = np.array(turns, np.float32).T[..., None], (points[::2], points[1::2])
    whole = np.empty_like(points)
    whole[::2], whole[1::2] = cosine * x - sine * y, sine * x + cosine * y
    return whole


def _turn(xx: float, xy: float, yy: float, cosine: float, sine: float) -> tuple[float, float] | None:
    """Cosine and sine of the turn that makes a root in the agent's frame, turned, the one in the map's."""
    ahead = cosine * cosine * xx + 2 * cosine * sine * xy + sine * sine * yy
    both = cosine * sine * (yy - xx) + (cosine * cosine - sine * sine) * xy
    aside = sine * sine * xx - 2 * cosine * sine * xy + cosine * cosine * yy
    if not (xx > 0 and ahead > 0 and aside - both * both / ahead > 0):
        return None
    root = math.sqrt(ahead)
    lean, rest = both / root, math.sqrt(aside - both * both / ahead)
    return (cosine * root - sine * lean) / math.sqrt(xx), sine * rest / math.sqrt(xx)


class Particles:
    """A fixed set of standard normal points that becomes a cloud for any belief.

    Parameters
    ----------
    count : int
        Rounded up to whole blocks of the evaluation kernel.
    seed : int
    adapt : bool
        Whether to take as few as the belief asks for, `count` at most.

    Attributes
    ----------
    count : int
        How many there are at most.
    limit : int or None
        As few as this are drawn for now, of each of several hypotheses.
    """

    def __init__(self, count: int, seed: int, adapt: bool = False) -> None:
        self.count, self.adapt = -(-count // PATH_BLOCK) * PATH_BLOCK, adapt
        self.limit: int | None = None
        self._seed = seed
        self._points = np.zeros((0, self.count), np.float32)
        self._few = self._points
        self._held: runtime.Resident = self._points

    def points(self, belief: Belief) -> runtime.Resident:
        """The normal points, (N or more, count) float32, where the device has them.

        If they are limited, (N or more, limit), `turned` with the agent: until the next are asked for.
        """
        size = len(belief.mean)
        if size > len(self._points):
            fresh = [self._column(n) for n in range(len(self._points), size)]
            points = np.concatenate([self._points, np.stack(fresh)])
            self._held = runtime.resident(points)
            self._points = points  # last, should anything interrupt
        if self.limit is None:
            return self._held
        if self._few.shape != (len(self._points), self.limit):
            self._few = self._points[:, : self.limit].copy()
        self._few[:4] = turned(self._points[:4, : self.limit], belief)
        return runtime.resident(self._few)

    def samples(self, belief: Belief, number: int, draft: Draft) -> Sampling:
        """Exact samples of a belief by points that follow each other, from another one on for every `number`.

        Those of a sequence of numbers are spread evenly over all points. The draft is where they are drawn.
        """
        points = self.points(belief)
        first = (number * GOLDEN % 2**32) * points.shape[1] >> 32
        return Sampling.of(belief, points, first, draft)

    def ask(self, belief: Belief) -> tuple[int, float]:
        """How many particles to draw of a belief, and the share of the covariance that each keeps."""
        count = self.count if self.limit is None else min(self.count, self.limit)
        if self.adapt:
            count = min(count, -int(-needed(belief) // PORTION) * PORTION)
        return count, _shrinkage(count)

    def _column(self, number: int) -> Single:
        values = np.random.default_rng([self._seed, POINTS, number]).standard_normal(self.count)
        whole = self.count // PORTION * PORTION
        for portions in (values[:whole].reshape(-1, PORTION), values[whole:].reshape(1, -1)):
            if portions.size:  # each by itself, so that the first few will do
                portions -= portions.mean(1, keepdims=True)
                portions /= portions.std(1, keepdims=True)
        return values.astype(np.float32)
