"""What direct SLAM believes: agent and settled images in one Gaussian, tentative images as rings beside it.

An image is the place at which an anchor seems to stand by way of a wall. What a distance leaves unknown of it
is a bent arc about the agent, so the joint Gaussian holds bearing and range of each image as seen from the
place where the agent stood when the image joined: in these the arc is straight (docs/model.md, (M78)).
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.state.belief import Belief
from gridslam.inference.state.rings import MOVING, Rings
from gridslam.world.geometry import unit

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
MEMORY = 50.0
"""Steps over which an intensity is averaged."""
FRESH_SIGHT = 0.9
"""Probability of an anchor's own path before the first snapshot."""


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
        Stretch of its surface that was hit, along the tangent.
    """

    identity: Whole
    anchor: Whole
    origin: Array
    existence: Array
    visible: Array
    intensity: Array
    heard: Array
    age: Whole
    extent: Array

    def __len__(self) -> int:
        return len(self.identity)

    @classmethod
    def empty(cls) -> Images:
        """No images."""
        none, whole, pair = np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 2))
        return cls(whole, whole, pair, none, none, none, none, whole, pair)

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
    step, next_identity : int
    time_s : float or None
    """

    belief: Belief
    images: Images = field(default_factory=Images.empty)
    tentative: Tentative = field(default_factory=Tentative.empty)
    links: Links = field(default_factory=lambda: Links.start(0))
    step: int = 0
    next_identity: int = 0
    time_s: float | None = None

    @classmethod
    def start(cls, mean: Array, variance: Array, anchors: int) -> Self:
        """Before the first step, from the prior of [x, y, vx, vy] (4,)."""
        return cls(Belief(mean.copy(), np.diag(variance)), links=Links.start(anchors))

    @property
    def places(self) -> Array:
        """Mean places of the settled images, (S, 2) m."""
        polar = self.belief.mean[MOVING:].reshape(-1, 2)
        return np.asarray(self.images.origin + polar[:, 1:] * unit(polar[:, 0]))

    @property
    def place_covariances(self) -> Array:
        """Covariances of the settled images' places, (S, 2, 2) m^2."""
        count, slope = len(self.images), self.place_slopes
        own = MOVING + 2 * np.arange(count)[:, None] + np.arange(2)
        return np.asarray(
            slope @ self.belief.covariance[own[:, :, None], own[:, None, :]] @ np.swapaxes(slope, 1, 2)
        )

    @property
    def place_slopes(self) -> Array:
        """Derivatives of the places by bearing and range, (S, 2, 2)."""
        polar = self.belief.mean[MOVING:].reshape(-1, 2)
        toward = unit(polar[:, 0])
        across = polar[:, 1:] * np.stack([-toward[:, 1], toward[:, 0]], -1)
        return np.stack([across, toward], -1)

    def keep(self, images: NDArray[np.bool_]) -> Self:
        """Without some of the settled images (S,): they are marginalised out."""
        if images.all():
            return self
        rows = np.concatenate([np.ones(MOVING, bool), np.repeat(images, 2)])
        belief = Belief(self.belief.mean[rows], self.belief.covariance[np.ix_(rows, rows)])
        return replace(self, belief=belief, images=self.images.take(images))


def predict(belief: Belief, dt: float, acceleration: float, walk_m: float) -> Belief:
    """Near-constant velocity of the agent; a random walk of the images along their range.

    Parameters
    ----------
    dt, acceleration, walk_m : float; s, m/s^2, m
    """
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    mean[:2] += dt * mean[2:4]
    covariance[:2] += dt * covariance[2:4]
    covariance[:, :2] += dt * covariance[:, 2:4]
    push = acceleration * np.array([0.5 * dt**2, dt])
    for axis in range(2):
        entry = np.array([axis, axis + 2])
        covariance[np.ix_(entry, entry)] += np.outer(push, push)
    polar = mean[MOVING:].reshape(-1, 2)
    on = MOVING + 2 * np.arange(len(polar))
    covariance[on, on] += (walk_m / polar[:, 1]) ** 2
    covariance[on + 1, on + 1] += walk_m**2
    return Belief(mean, covariance)
