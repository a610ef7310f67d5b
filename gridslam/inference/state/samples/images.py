"""What direct SLAM believes: agent and settled images in one Gaussian, tentative images as rings beside it.

An image is the place at which an anchor seems to stand by way of a wall. What a distance leaves unknown of it
is a bent arc about the agent, so the joint Gaussian holds bearing and range of each image as seen from the
place where the agent stood when the image joined: in these the arc is straight (docs/model.md, (M78)).
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import LATER, Array
from gridslam.inference.beliefs.belief import Belief, carry
from gridslam.inference.health.signal_watch import SignalWatch
from gridslam.inference.state.presence import FRESH_SIGHT
from gridslam.inference.state.rings import BEARINGS, MOVING, Rings, pushed
from gridslam.world.geometry import unit

Whole = NDArray[np.int64]
Part = TypeVar("Part", "Belief", "Images", "Links", "Rings")
MEMORY = 50.0
"""Steps over which an intensity is averaged."""


@dataclass(frozen=True, eq=False)
class Images:
    """Settled images: S rows, aligned with the joint belief.

    Attributes
    ----------
    identity, anchor : (S,) int64
    origin : (S, 2) m
        Whence bearing and range are taken.
    existence : (S,)
        Probability that there is such an image.
    visible : (S,)
        Probability that its path is there now.
    intensity : (S,)
        Mean power of its path.
    heard : (S,)
        Steps in that mean, at most `MEMORY`.
    age : (S,) int64
        Steps since birth.
    extent : (S, 2) m
        Stretch of its surface that was hit, along the tangent; NaN before its place was known well.
    bounces : (S,) int64
        Over how many walls that other images show, too, its place follows, 1 or 2; 0: over none known.
        Negative: it was proposed there and isn't confirmed yet.
    """

    identity: Whole
    anchor: Whole
    origin: Array
    existence: Array
    visible: Array
    intensity: Array
    heard: Array
    age: Whole
    extent: Array = field(metadata={"blank": True})
    bounces: Whole = field(default_factory=lambda: np.zeros(0, np.int64), metadata=LATER)

    def __post_init__(self) -> None:
        if len(self) and not len(self.bounces):  # of an earlier version's checkpoint
            object.__setattr__(self, "bounces", np.zeros(len(self), np.int64))

    def __len__(self) -> int:
        return len(self.identity)

    @property
    def proposed(self) -> NDArray[np.bool_]:
        """Which were proposed where other walls would mirror an anchor, and aren't confirmed yet, (S,)."""
        return np.asarray(self.bounces < 0)

    @property
    def by_walls(self) -> NDArray[np.bool_]:
        """Whose places follow from walls that other images show, proposed ones among them, (S,)."""
        return np.asarray(self.bounces != 0)

    @classmethod
    def empty(cls) -> Images:
        """No images."""
        none, whole, pair = np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 2))
        return cls(whole, whole, pair, none, none, none, none, whole, pair, whole)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Images:
        """Some of the images."""
        return Images(*(getattr(self, f.name)[rows] for f in fields(self)))

    def joined(self, other: Images) -> Images:
        """These and then the others."""
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))
        return Images(*(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True, eq=False)
class Tentative:
    """Images whose place is not observable yet: a ring of hypotheses each, with an intensity.

    Attributes
    ----------
    rings : Rings
        R of them; existence is that of image and path in one.
    intensity, heard : (R,)
        As in `Images`.
    """

    rings: Rings
    intensity: Array
    heard: Array

    def __len__(self) -> int:
        return len(self.rings)

    @classmethod
    def empty(cls) -> Tentative:
        """None."""
        return cls(Rings.empty(), np.zeros(0), np.zeros(0))

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Tentative:
        """Some of them."""
        return Tentative(self.rings.take(rows), self.intensity[rows], self.heard[rows])

    def joined(self, other: Tentative) -> Tentative:
        """These and then the others."""
        return Tentative(
            self.rings.joined(other.rings),
            np.concatenate([self.intensity, other.intensity]),
            np.concatenate([self.heard, other.heard]),
        )


@dataclass(frozen=True, eq=False)
class Links:
    """What is known of each anchor's own path and of the noise it is received in.

    Attributes
    ----------
    visible, intensity, heard : (J,)
        As in `Images`, of the line of sight; intensity 0: nothing heard yet.
    noise : (J,)
        Mean power of the noise in a sample; 0: nothing heard yet.
    usurped : (J,) int64
        For how many steps another path has stood in the line of sight's place.
    """

    visible: Array
    intensity: Array
    heard: Array
    noise: Array
    usurped: Whole

    @classmethod
    def start(cls, anchors: int) -> Links:
        """Before the first snapshot."""
        none = np.zeros(anchors)
        return cls(np.full(anchors, FRESH_SIGHT), none, none, none, np.zeros(anchors, np.int64))


@dataclass(frozen=True, eq=False)
class DirectState:
    """What direct SLAM believes after a step. A value, as every state.

    Attributes
    ----------
    belief : Belief
        Of [x, y, vx, vy, bearing_1, range_1, ...].
    images : Images
    tentative : Tentative
    links : Links
    watch : SignalWatch
        How well samples fitted.
    step, next_identity : int
    time_s : float or None
    one_sided : (J,) int64
        1 where an anchor was in sight, or its distance vague, while both sides of it fitted, and no other has
        told since.
    firsts : (K, 1 + J)
        Time (s) of the latest looks at what arrives first, and its length (m) of each anchor; 0: nothing.
    found_again : bool
        Whether it begins where first arrivals told that a lost agent is, and they haven't borne it out since.
    """

    belief: Belief
    images: Images = field(default_factory=Images.empty)
    tentative: Tentative = field(default_factory=Tentative.empty)
    links: Links = field(default_factory=lambda: Links.start(0))
    watch: SignalWatch = field(default_factory=SignalWatch)
    step: int = 0
    next_identity: int = 0
    time_s: float | None = None
    one_sided: Whole = field(default_factory=lambda: np.zeros(0, np.int64), metadata=LATER)
    firsts: Array = field(default_factory=lambda: np.zeros((0, 0)), metadata=LATER)
    found_again: bool = field(default=False, metadata=LATER)

    @classmethod
    def start(cls, mean: Array, variance: Array, anchors: int, noise: Array | None = None) -> Self:
        """Before the first step, from priors of [x, y, vx, vy] (4,) and, if there is one, of noise (J,)."""
        links = Links.start(anchors)
        links = links if noise is None else replace(links, noise=np.array(noise, np.float64))
        whole = Belief(mean.copy(), np.diag(variance))
        return cls(
            whole, links=links, one_sided=np.zeros(anchors, np.int64), firsts=np.zeros((0, 1 + anchors))
        )

    @property
    def spread_m(self) -> float:
        """Standard deviation of the agent's position, m."""
        return float(np.sqrt(self.belief.covariance[0, 0] + self.belief.covariance[1, 1]))

    @cached_property
    def places(self) -> Array:
        """Mean places of the settled images, (S, 2) m."""
        polar = self.belief.mean[MOVING:].reshape(-1, 2)
        return np.asarray(self.images.origin + polar[:, 1:] * unit(polar[:, 0]))

    @cached_property
    def place_covariances(self) -> Array:
        """Covariances of the settled images' places, (S, 2, 2) m^2."""
        count, slope = len(self.images), self.place_slopes
        own = MOVING + 2 * np.arange(count)[:, None] + np.arange(2)
        return np.asarray(
            slope @ self.belief.covariance[own[:, :, None], own[:, None, :]] @ np.swapaxes(slope, 1, 2)
        )

    @cached_property
    def place_slopes(self) -> Array:
        """Derivatives of the places by bearing and range, (S, 2, 2)."""
        polar = self.belief.mean[MOVING:].reshape(-1, 2)
        toward = unit(polar[:, 0])
        across = polar[:, 1:] * np.stack([-toward[:, 1], toward[:, 0]], -1)
        return np.stack([across, toward], -1)

    def packed(self) -> Self:
        """The state with every array in the order in which files hold it.

        Sums depend on it in the last digit: so a run goes on from a checkpoint bit for bit.
        """
        tentative = self.tentative
        rings = _packed(tentative.rings)
        return replace(
            self, belief=_packed(self.belief), images=_packed(self.images), links=_packed(self.links),
            tentative=Tentative(rings, *map(np.ascontiguousarray, (tentative.intensity, tentative.heard))),
        )  # fmt: skip

    def claims(self, anchors: int) -> list[tuple[str, bool, str]]:
        """What must hold of a state that was read from a file: part, whether it does, what is allowed."""
        images, rings, links, size = self.images, self.tentative.rings, self.links, len(self.images)
        tentative = self.tentative
        rows = [getattr(images, f.name) for f in fields(images)]
        chances = (images.existence, images.visible, rings.existence, links.visible)
        counts = (images.heard, images.intensity, tentative.heard, tentative.intensity, links.heard,
                  links.intensity, links.noise)  # fmt: skip
        owners = np.concatenate([images.anchor, rings.anchor])
        mixture, firsts = rings.weight.shape, np.atleast_2d(self.firsts)
        return [
            ("step", self.step >= 0, "0 or more"),
            ("belief/mean", self.belief.mean.shape == (MOVING + 2 * size,), "two entries for each image"),
            ("belief/covariance", len(self.belief.covariance) == MOVING + 2 * size, "a row for each entry"),
            ("images", all(len(row) == size for row in rows), "rows of one number"),
            ("images/origin", images.origin.shape == images.extent.shape == (size, 2), "pairs"),
            ("images/identity", len(set(images.identity.tolist())) == size, "a number for each image"),
            ("images/bounces", bool((np.abs(images.bounces) <= 2).all()), "-2 to 2"),
            ("next_identity", self.next_identity > images.identity.max(initial=-1), "above all identities"),
            ("anchor", bool(((owners >= 0) & (owners < anchors)).all()), "anchors' numbers"),
            ("existence", all(((c >= 0) & (c <= 1)).all() for c in chances), "probabilities"),
            ("intensity", all((c >= 0).all() for c in counts), "0 or more"),
            ("links", all(len(getattr(links, f.name)) == anchors for f in fields(links)), "anchors' rows"),
            ("one_sided", len(self.one_sided) in (0, anchors), "anchors' rows"),
            ("firsts", self.firsts.shape[1:] == (1 + anchors,) or not self.firsts.size, "anchors' columns"),
            ("firsts", bool((firsts[:, 1:] >= 0).all()), "lengths of 0 or more"),
            ("firsts", bool((np.diff(firsts[:, :1], axis=0) > 0).all()), "times that rise"),
            ("tentative", {len(getattr(rings, f.name)) for f in fields(rings)}
             == {len(tentative.intensity)} == {len(tentative.heard)}, "rows of one number"),
            ("tentative/rings", mixture[1:] == (BEARINGS,)
             and rings.mean.shape == (*mixture, MOVING + 2)
             and rings.covariance.shape == (*mixture, MOVING + 2, MOVING + 2), "hypotheses of rings"),
            ("tentative/rings/weight", bool((rings.weight >= 0).all())
             and bool((np.abs(rings.weight.sum(-1) - 1) < 1e-6).all()), "probabilities"),
        ]  # fmt: skip

    def keep(self, images: NDArray[np.bool_]) -> Self:
        """Without some of the settled images (S,): they are marginalised out."""
        if images.all():
            return self
        rows = np.concatenate([np.ones(MOVING, bool), np.repeat(images, 2)])
        belief = Belief(self.belief.mean[rows], self.belief.covariance[np.ix_(rows, rows)])
        return replace(self, belief=belief, images=self.images.take(images))


def _packed(part: Part) -> Part:
    loose: dict[str, Any] = {
        name: np.ascontiguousarray(value)
        for name, value in vars(part).items()
        if isinstance(value, np.ndarray) and not value.flags.c_contiguous
    }
    return replace(part, **loose) if loose else part


def predict(belief: Belief, dt: float, acceleration: float, walk_m: float) -> Belief:
    """Near-constant velocity of the agent; a random walk of the images along their range.

    Parameters
    ----------
    dt, acceleration, walk_m : float; s, m/s^2, m
    """
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    carry(mean, covariance, slice(2), slice(2, MOVING), dt)
    for axis in range(2):
        covariance[axis:MOVING:2, axis:MOVING:2] += pushed(dt, acceleration)
    polar = mean[MOVING:].reshape(-1, 2)
    on = MOVING + 2 * np.arange(len(polar))
    covariance[on, on] += (walk_m / polar[:, 1]) ** 2
    covariance[on + 1, on + 1] += walk_m**2
    return Belief(mean, covariance)
