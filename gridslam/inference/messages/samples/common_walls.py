"""Where images must be by walls that other images have shown (M292).

A wall mirrors every anchor, and a second wall mirrors the image: what one anchor's image says of a wall says
where another anchor's image in it is, and two walls say where the image of a double bounce is.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import give_birth
from gridslam.inference.messages.samples.image_births import OWN_PLACE_M
from gridslam.inference.state.rings import MOVING
from gridslam.inference.state.samples.images import DirectState, Images
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import line_between, mirror, mirror_derivative, unit

SURE = 0.9
"""Existence of an image that says where others are."""
SPREAD_M = 0.2
"""Deviation of a place, along its worst direction, beyond which it isn't known."""
SAID_M = 0.6, 0.2
"""The same, beyond which nothing is said of other places, where walls reflect once and where they do twice:
ten or more paths are there then, and at a vague place stands one of any wall."""
TIE_M = 0.01
"""How well images in one wall agree: walls are that plane."""
SINGLE, DOUBLE = 0.3, 0.1
"""Probability that an image at such a place is heard and not settled yet, over one wall and over two."""
UNKNOWN = 5.0
"""Images of an anchor expected at other places."""
SAME_M, APART_M = 0.2, 0.5
"""Places nearer than this to each other are one; how near to a known image none is new."""
NOTHING = np.zeros((0, 2))
ONE_BOUNCE, TWO_BOUNCES = 1, 2


@dataclass(frozen=True, eq=False)
class Places:
    """Places of an anchor's images by the walls that other images show.

    Attributes
    ----------
    place : (C, 2) m
    slope : (C, 2, N)
        By the joint state.
    covariance : (C, 2, 2) m^2
    bounces : (C,) int64
    maker : (C,) int64
        Row of the image that showed the wall; of two walls, the first.
    """

    place: Array
    slope: Array
    covariance: Array
    bounces: NDArray[np.int64]
    maker: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.place)

    def take(self, rows: NDArray[np.intp]) -> Self:
        """Some of them."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def log_worth(self, position: Array, model: FilterModel) -> Array:
        """Log (C,) of how much likelier an image is here than one of an unknown wall per area, m^2.

        Lines of unknown walls are uniform over those that cross the region (M292).
        """
        span = np.maximum(np.linalg.norm(self.place - position, axis=-1), OWN_PLACE_M)
        chance = np.where(self.bounces == ONE_BOUNCE, SINGLE, DOUBLE)
        return np.asarray(np.log(chance * 4 * np.pi * model.radius_m * span / UNKNOWN))


def places_by_walls(
    state: DirectState, anchor: int, model: FilterModel, proven: bool = False, taken: Array = NOTHING
) -> Places:
    """Places of an anchor's images over walls that sure images show, one bounce first, then the surest.

    Parameters
    ----------
    proven : bool
        Double bounces alone over walls that images of two anchors show.
    taken : (T, 2) m
        No places within `APART_M` of these.
    """
    images, position, most = state.images, model.anchor_positions, said_m(model)
    known = (images.existence > SURE) & ~images.proposed & (images.bounces < TWO_BOUNCES)
    rows = np.flatnonzero(known & (widest(state.place_covariances) < most))
    line = line_between(position[images.anchor], state.places)
    places = _single(state, rows[images.anchor[rows] != anchor], line, anchor, model, taken)
    if model.max_bounces > 1:
        walls = rows[images.bounces[rows] == ONE_BOUNCE] if proven else rows
        own = walls[images.anchor[walls] == anchor]
        double = _double(state, own, walls, line, anchor, model, taken)
        pairs = ((getattr(places, f.name), getattr(double, f.name)) for f in fields(places))
        places = Places(*(np.concatenate(pair) for pair in pairs))
    if not len(places):
        return places
    worst = widest(places.covariance)
    far = np.linalg.norm(places.place - position[anchor], axis=-1) > OWN_PLACE_M
    order = np.lexsort((worst, places.bounces))
    places = places.take(order[(far & (worst < most))[order]])
    apart = np.linalg.norm(places.place[:, None] - places.place, axis=-1)
    twin = np.tril((apart < SAME_M) & (places.bounces[:, None] == places.bounces), -1).any(1)
    return places.take(np.flatnonzero(~twin))


def said_m(model: FilterModel) -> float:
    """Deviation of a place beyond which nothing is said of others, m."""
    return SAID_M[0 if model.max_bounces < TWO_BOUNCES else 1]


def _single(
    state: DirectState, rows: NDArray[np.intp], line: Array, anchor: int, model: FilterModel, taken: Array
) -> Places:
    """The anchor's images in the lines (S, 2) of other anchors' images."""
    if not len(rows):
        return _no_places(state)
    position = model.anchor_positions[anchor]
    places = mirror(line[rows], position)
    across = line_between(position, places)
    crosses = np.abs(unit(across[:, 0]) @ model.middle - across[:, 1]) < model.radius_m
    here = np.flatnonzero(crosses & (farness(places, taken) > APART_M))
    rows = rows[here]
    if not len(rows):
        return _no_places(state)
    slope = mirror_derivative(line[rows], position) @ _line_slopes(state, rows, line, model)
    return _places(state, places[here], slope, ONE_BOUNCE, rows)


def _double(
    state: DirectState, own: NDArray[np.intp], walls: NDArray[np.intp], line: Array, anchor: int,
    model: FilterModel, taken: Array,
) -> Places:  # fmt: skip
    """The anchor's own images, mirrored once more."""
    first, second = (grid.ravel() for grid in np.meshgrid(own, walls, indexing="ij"))
    position, image, mirrored_at = model.anchor_positions[anchor], state.places[first], line[second]
    places = mirror(mirrored_at, image)
    other = mirror(mirrored_at, np.broadcast_to(position, image.shape))
    # each of three places follows from the other two: the farthest is the double bounce
    nearer = np.maximum(np.linalg.norm(image - position, axis=-1), np.linalg.norm(other - position, axis=-1))
    double = (first != second) & (np.linalg.norm(places - position, axis=-1) > nearer)
    rows = np.flatnonzero(double & (farness(places, taken) > APART_M))
    first, second, image, mirrored_at = first[rows], second[rows], image[rows], mirrored_at[rows]
    normal = unit(mirrored_at[:, 0])
    turned = np.eye(2) - 2 * normal[:, :, None] * normal[:, None, :]
    slope = turned @ _own_slopes(state, first)
    slope = slope + mirror_derivative(mirrored_at, image) @ _line_slopes(state, second, line, model)
    return _places(state, places[rows], slope, TWO_BOUNCES, first)


def _no_places(state: DirectState) -> Places:
    none = np.zeros(0, np.int64)
    return Places(NOTHING, np.zeros((0, 2, len(state.belief.mean))), np.zeros((0, 2, 2)), none, none)


def _places(state: DirectState, place: Array, slope: Array, bounces: int, maker: NDArray[np.intp]) -> Places:
    covariance = slope @ state.belief.covariance @ np.swapaxes(slope, 1, 2) + TIE_M**2 * np.eye(2)
    return Places(place, slope, covariance, np.full(len(place), bounces), maker.astype(np.int64))


def _own_slopes(state: DirectState, rows: NDArray[np.intp]) -> Array:
    """Derivatives (R, 2, N) of images' places by the joint state."""
    slopes = np.zeros((len(rows), 2, len(state.belief.mean)))
    for side in range(2):
        slopes[np.arange(len(rows)), :, MOVING + 2 * rows + side] = state.place_slopes[rows][:, :, side]
    return slopes


def _line_slopes(state: DirectState, rows: NDArray[np.intp], line: Array, model: FilterModel) -> Array:
    """Derivatives (R, 2, N) of the lines halfway between anchors and images by the joint state."""
    back = mirror_derivative(line[rows], model.anchor_positions[state.images.anchor[rows]])
    return np.asarray(np.linalg.inv(back) @ _own_slopes(state, rows))


def farness(place: Array, others: Array) -> Array:
    """Distance (P,) of places (P, 2) from the nearest of others (T, 2), m; infinite where there are none."""
    return np.asarray(np.linalg.norm(place[:, None] - others, axis=-1).min(1, initial=np.inf))


def widest(covariance: Array) -> Array:
    """Largest deviations (...,) of covariances (..., 2, 2)."""
    half = 0.5 * (covariance[..., 0, 0] + covariance[..., 1, 1])
    off = np.hypot(0.5 * (covariance[..., 0, 0] - covariance[..., 1, 1]), covariance[..., 0, 1])
    return np.asarray(np.sqrt(np.maximum(half + off, 0.0)))


def image_there(
    state: DirectState, anchor: int, places: Places, which: int, existence: float, visible: float,
    intensity: float, heard: float, age: int = 0,
) -> DirectState:  # fmt: skip
    """With one image more, whose place follows from the joint belief but for `TIE_M`.

    Parameters
    ----------
    existence, visible, intensity, heard, age
        As in `Images`.
    """
    origin = state.belief.mean[:2].copy()
    away = places.place[which] - origin
    span = float(np.hypot(*away))
    toward = away / span
    turn = np.stack([np.array([-toward[1], toward[0]]) / span, toward])
    polar = np.array([np.arctan2(toward[1], toward[0]), span])
    belief = give_birth(state.belief, polar, turn @ places.slope[which], turn, np.full(2, TIE_M**2))
    fresh = Images(
        np.array([state.next_identity]), np.array([anchor], np.int64), origin[None], np.array([existence]),
        np.array([visible]), np.array([intensity]), np.array([heard]), np.array([age], np.int64),
        np.full((1, 2), np.nan), places.bounces[[which]],
    )  # fmt: skip
    return replace(
        state, belief=belief, images=state.images.joined(fresh), next_identity=state.next_identity + 1
    )
