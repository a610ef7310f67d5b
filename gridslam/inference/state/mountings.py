"""How anchors stand otherwise than is told, correlated with the joint belief; docs/model.md, (M569).

What an anchor is heard by depends on where agent and walls are seen from it. So they are looked at in a
frame in which it stands where it is taken to: in that it is known, and what isn't known of it is unknown of
all else instead. What is learned there moves the anchor as well, by its correlation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from scipy.linalg import solve_triangular

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.beliefs.regression import Beside, Rows, following
from gridslam.inference.beliefs.turn import direction
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import unit, wrap

PER_ANCHOR = 3
"""Entries of an anchor: how far it stands aside of where it is told to, dx, dy (m), and its turn (rad)."""
ROUNDING, FEW = 1e-10, 10.0
"""Of correlations, and how many of it may add up."""


class Learned(NamedTuple):
    """How the scene's anchors stand, as an earlier agent learned it with its map's lines.

    Attributes
    ----------
    aside : (J, 3) float64
        dx, dy (m) and turn (rad) against the scene.
    covariance, cross : (3 J, 3 J), (3 J, 2 S) float64
        In the scene: with what isn't known of a turn of all.
    """

    aside: Array
    covariance: Array
    cross: Array


@dataclass(frozen=True, eq=False)
class Mountings:
    """Gaussian belief about how J anchors stand otherwise than is told. A value.

    Attributes
    ----------
    mean : (3 J,)
        dx, dy (m) and turn (rad) of anchor after anchor.
    covariance : (3 J, 3 J)
    cross : (3 J, N)
        Covariance with the entries of the joint belief.
    pivot, turn_variance : (2,) m, float
        About where, and by how much (rad^2), all may turn together with the anchors: nothing that is heard
        tells. It is left out of the rest.
    """

    mean: Array
    covariance: Array
    cross: Array
    pivot: Array
    turn_variance: float

    @classmethod
    def start(cls, model: FilterModel, size: int) -> Self | None:
        """The prior, independent of a belief of so many entries; None where all anchors stand as is told."""
        variance, together, pivot, all_turn = _as_told(model)
        if not variance.any():
            return None
        covariance = _settled(np.diag(variance) - all_turn * np.outer(together, together), variance)
        return cls(np.zeros(len(variance)), covariance, np.zeros((len(variance), size)), pivot, all_turn)

    @classmethod
    def handed(cls, model: FilterModel, belief: Belief, learned: Learned) -> tuple[Belief, Self | None]:
        """As an earlier agent's map has anchors and its lines, which `belief` holds already.

        Where the scene tells an anchor better than that, it counts as well. The agent's start, told in the
        scene, may be turned against the rest by as much as all may turn together. None where the scene leaves
        nothing open.
        """
        variance, together, pivot, all_turn = _as_told(model)
        size, head = len(variance), belief.layout.head
        mean = np.concatenate([learned.aside.ravel(), belief.mean])
        joint = np.zeros((len(mean), len(mean)))
        joint[:size, :size] = learned.covariance
        joint[:size, size + head :], joint[size + head :, :size] = learned.cross, learned.cross.T
        joint[size:, size:] = belief.covariance
        told = np.square(model.mounting_std[:, [0, 0, 1]]).ravel()
        counts = np.tile([True, True, model.radio.departs], model.senders)
        for entry in np.flatnonzero(counts):
            mean, joint = _at_least_as_sure(mean, joint, int(entry), float(told[entry]))
        known = np.flatnonzero(~counts | (told == 0))
        mean[known], joint[known], joint[:, known] = 0.0, 0.0, 0.0
        belief = replace(belief, mean=mean[size:], covariance=np.ascontiguousarray(joint[size:, size:]))
        if not variance.any():
            return belief, None
        way, before = np.concatenate([together, direction(belief, pivot)]), joint.diagonal().copy()
        heard = np.concatenate([np.flatnonzero(variance), np.arange(size + head, len(mean))])
        if all_turn:
            all_turn = _removable(joint[np.ix_(heard, heard)], way[heard])
            # about an only anchor walls are turned, not the start: one so wide would be searched for
            of_start = np.arange(size, size + head) if model.senders > 1 else heard[heard >= size]
            within, against = np.zeros_like(way), np.zeros_like(way)
            within[heard], against[of_start] = way[heard], way[of_start]
            joint += all_turn * (np.outer(against, against) - np.outer(within, within))
        joint = _settled(joint, before)
        own, cross, rest = map(
            np.ascontiguousarray, (joint[:size, :size], joint[:size, size:], joint[size:, size:])
        )
        return replace(belief, covariance=rest), cls(mean[:size].copy(), own, cross, pivot, all_turn)

    @property
    def aside(self) -> Array:
        """Means, (J, 3)."""
        return self.mean.reshape(-1, PER_ANCHOR)

    def in_scene(self, model: FilterModel) -> Array:
        """Deviations in the scene, (J, 3): what isn't known of a turn of all is part of them."""
        together = _together(model.anchors[: model.senders, :2], self.pivot)
        variance = self.covariance.diagonal() + self.turn_variance * together**2
        std = np.sqrt(np.maximum(variance, 0.0)).reshape(-1, PER_ANCHOR)
        return std if model.radio.departs else np.column_stack([std[:, :2], model.orientation_std])

    def jointly(self, belief: Belief, model: FilterModel) -> tuple[Array, Array]:
        """Covariance in the scene (3 J, 3 J), and that with the entries of a belief (3 J, N).

        With what isn't known of a turn of all, which the belief has already.
        """
        variance, together, _, _ = _as_told(model)
        together = np.where(variance > 0, _together(model.anchors[: model.senders, :2], self.pivot), 0.0)
        covariance = self.covariance + self.turn_variance * np.outer(together, together)
        cross = self.cross + self.turn_variance * np.outer(together, direction(belief, self.pivot))
        if not model.radio.departs:
            turns = np.arange(PER_ANCHOR - 1, len(covariance), PER_ANCHOR)
            covariance[turns, turns] = model.orientation_std**2
        return covariance, cross

    def predicted(self, dt: float) -> Self:
        """A step of so many seconds on: the agent has moved."""
        cross = self.cross.copy()
        cross[:, :2] += dt * cross[:, 2:4]
        return replace(self, cross=cross)

    def following(self, before: Belief, after: Belief, rows: tuple[Rows, Rows] | None = None) -> Self:
        """The mountings once the joint belief has become `after`; see `regression.following`."""
        mean, covariance, cross = following(
            Beside(self.mean, self.covariance, self.cross), before, after, rows
        )
        return replace(self, mean=mean, covariance=covariance, cross=cross)

    def shared(self, belief: Belief, entries: Rows) -> tuple[Belief, Self]:
        """With entries of the belief, known as anchors tell them, off by as much as these are on the average.

        A shift of all anchors moves an agent that they find, and walls that they found, along.
        """
        count = len(self.mean) // PER_ANCHOR
        average = np.tile(np.eye(PER_ANCHOR)[:2], count) / count
        slope = np.zeros((len(belief.mean), 2))
        slope[entries] = -by_mounting(belief, self.pivot)[entries, :2]
        shift = slope @ average
        others = np.setdiff1d(np.arange(len(belief.mean)), entries)
        cross, covariance = self.cross.copy(), belief.covariance.copy()
        linked = shift[entries] @ self.cross[:, others]
        covariance[np.ix_(entries, others)], covariance[np.ix_(others, entries)] = linked, linked.T
        covariance[np.ix_(entries, entries)] += (shift @ self.covariance @ shift.T)[np.ix_(entries, entries)]
        cross[:, entries] = self.covariance @ shift[entries].T
        return replace(belief, covariance=covariance), replace(self, cross=cross)

    def framed(self, belief: Belief, anchor: int, model: FilterModel) -> tuple[Belief, Self]:
        """Belief and mountings in the frame in which an anchor stands as the model has it."""
        place, stands, turn = self._places(anchor, model)
        return self._linked(carried(belief, stands, place, -turn), anchor, place, 1.0)

    def unframed(self, belief: Belief, anchor: int, model: FilterModel) -> tuple[Belief, Self]:
        """They in the scene's frame, from that of an anchor."""
        place, stands, turn = self._places(anchor, model)
        linked, after = self._linked(belief, anchor, place, -1.0)
        return carried(linked, place, stands, turn), after

    def _places(self, anchor: int, model: FilterModel) -> tuple[Array, Array, float]:
        """Where the model has an anchor, where it is believed to stand, and how it is turned against that."""
        taken = np.zeros(PER_ANCHOR) if model.aside is None else model.aside[anchor]
        x, y, turn = (self.aside[anchor] - taken).tolist()
        place = model.anchors[anchor, :2]
        return place, place + np.array([x, y]), turn

    def _linked(self, belief: Belief, anchor: int, place: Array, sense: float) -> tuple[Belief, Self]:
        """With what isn't known of how an anchor stands in the belief, or out of it."""
        own = slice(PER_ANCHOR * anchor, PER_ANCHOR * (anchor + 1))
        slope = sense * by_mounting(belief, place)
        linked = slope @ self.cross[own]
        covariance = belief.covariance + linked + linked.T + slope @ self.covariance[own, own] @ slope.T
        cross = self.cross + self.covariance[:, own] @ slope.T
        return replace(belief, covariance=0.5 * (covariance + covariance.T)), replace(self, cross=cross)


def _as_told(model: FilterModel) -> tuple[Array, Array, Array, float]:
    """Variances that a scene gives anchors, (3 J,), and what `common_turn` makes of them.

    Returns
    -------
    (variance, together, pivot, turn variance)
        together: 0 for what is known.
    """
    place, turn = model.mounting_std.T
    departs = model.radio.departs  # without, nothing hangs on how anchors are turned, or tells it
    variance = np.square(np.column_stack([place, place, departs * turn])).ravel()
    if not variance.any():
        return variance, np.zeros_like(variance), np.zeros(2), 0.0
    told = turn if departs else np.full(len(turn), np.inf)
    pivot, together, all_turn = common_turn(model.anchors[: model.senders, :2], place, told)
    return variance, np.where(variance > 0, together, 0.0), pivot, all_turn


def _removable(covariance: Array, way: Array) -> float:
    """The largest variance of a motion `way` (N,) that a covariance (N, N) holds independent of all else."""
    scale = np.sqrt(covariance.diagonal())
    moved = scale > 0
    if not moved.all() and way[~moved].any():
        return 0.0
    own = covariance[np.ix_(moved, moved)] / np.outer(scale[moved], scale[moved])
    root = np.linalg.cholesky(own + ROUNDING * np.eye(len(own)))
    most = 1 / np.square(solve_triangular(root, way[moved] / scale[moved], lower=True)).sum()
    return float(most * (1 - FEW * ROUNDING))


def _at_least_as_sure(mean: Array, joint: Array, entry: int, variance: float) -> tuple[Array, Array]:
    """Mean (N,) and covariance (N, N), where an entry is told to be 0 with a variance.

    What is told counts by so much that the entry gets as sure as that; nothing where it is already.
    """
    own = float(joint[entry, entry])
    if variance >= own:
        return mean, joint
    gain = joint[:, entry] * ((own - variance) / own**2)
    return mean - gain * mean[entry], joint - np.outer(gain, joint[entry])


def _settled(covariance: Array, before: Array) -> Array:
    """A covariance (N, N) without what rounding left of variances (N,) that all went."""
    gone = covariance.diagonal() <= FEW * ROUNDING * before
    settled = covariance.copy()
    settled[gone], settled[:, gone] = 0.0, 0.0
    return settled


def common_turn(place: Array, place_std: Array, turn_std: Array) -> tuple[Array, Array, float]:
    """What anchors' deviations leave open of a turn that all make together.

    Parameters
    ----------
    place : (J, 2) m
    place_std, turn_std : (J,) m, rad
        Infinite for turns that nothing depends on.

    Returns
    -------
    (pivot, together, variance)
        About where, so that it is independent of how else anchors stand, (2,); how they stand if all turn by
        1, (3 J,); rad^2, 0 where an orientation or two places are known, or nothing is.
    """
    known = place_std == 0
    weight = known.astype(np.float64) if known.any() else place_std**-2.0
    pivot = weight @ place / weight.sum()
    together = _together(place, pivot)
    if known.sum() > 1 or not turn_std.all():
        return pivot, together, 0.0
    std = np.column_stack([place_std, place_std, turn_std]).ravel()
    moved = std > 0
    information = float(np.square(together[moved] / std[moved]).sum())
    return pivot, together, 1 / information if information > 0 else 0.0


def _together(place: Array, pivot: Array) -> Array:
    """How anchors at places (J, 2) stand if all turn about a pivot (2,), per rad, (3 J,)."""
    x, y = (place - pivot).T
    return np.column_stack([-y, x, np.ones(len(place))]).ravel()


def carried(belief: Belief, origin: Array, to: Array, turn: float) -> Belief:
    """The belief with its mean turned about `origin` (2,), and shifted with that `to` (2,)."""
    layout, mean = belief.layout, belief.mean.copy()
    cosine, sine = np.cos(turn), np.sin(turn)
    rotation = np.array([[cosine, -sine], [sine, cosine]])
    angles = mean[layout.angles]
    mean[:2] = rotation @ (mean[:2] - origin) + to
    mean[2:4] = rotation @ mean[2:4]
    mean[HEADING] = wrap(mean[HEADING] + turn)
    mean[layout.offsets] += unit(angles + turn) @ to - unit(angles) @ origin
    mean[layout.angles] = wrap(angles + turn)
    return replace(belief, mean=mean)


def by_mounting(belief: Belief, place: Array) -> Array:
    """Derivatives (N, 3) of all entries, as seen from an anchor at `place` (2,), by how it stands."""
    slope = np.zeros((len(belief.mean), PER_ANCHOR))
    slope[[0, 1], [0, 1]] = -1.0
    slope[belief.layout.offsets, :2] = -unit(belief.mean[belief.layout.angles])
    slope[:, 2] = -direction(belief, place)
    return slope
