"""Mirrors, surfaces and virtual anchors, paths and their derivatives ([Li2025adaptive], section II).

A surface is an infinite line. Inside the package it is written by the angle of its normal and its
offset, ``{q : q . (cos a, sin a) = r}``; users see the surface feature vector (SFV), the mirror image
of the origin, ``p_s = 2 r (cos a, sin a)``. The line form has no singularity when a surface passes
through the origin, and its two numbers mean the same wherever the wall stands.

All functions broadcast over leading axes; points have shape ``(..., 2)`` and are in metres.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

COLLINEAR_M = 1e-6
"""Offset below which pieces of walls share one surface."""
STEEPEST = 1 - 2.0**-10
"""Sine of the elevation up to which a horizontal array sees azimuths (exact in single precision, too)."""


def wrap(angle: Array | float) -> Array:
    """Angle in (-pi, pi], rad."""
    return -np.remainder(np.pi - np.asarray(angle, dtype=np.float64), 2 * np.pi) + np.pi


def direction(start: Array, end: Array) -> Array:
    """Angle of the direction from `start` to `end`, rad in (-pi, pi]."""
    step = np.asarray(end) - np.asarray(start)
    return np.arctan2(step[..., 1], step[..., 0])


def gap_to_origin(low: Array, high: Array) -> float:
    """How far the origin lies beside a box between two corners (2,), m; 0 if the box holds it."""
    return float(np.hypot(*np.maximum(np.maximum(low, -high), 0.0)))


def moved_lines(line: Array, by: Array) -> tuple[Array, Array]:
    """Lines (S, 2) moved by (2,) m, of whatever sign, and their derivatives (S, 2, 2) by those before."""
    slope = np.zeros((len(line), 2, 2))
    slope[:, 0, 0] = slope[:, 1, 1] = 1.0
    slope[:, 1, 0] = unit(line[:, 0] + 0.5 * np.pi) @ by
    return np.column_stack([line[:, 0], line[:, 1] + unit(line[:, 0]) @ by]), slope


def unit(angle: Array | float) -> Array:
    """Unit vector of an angle, shape ``(..., 2)``."""
    vector = np.empty((*np.shape(angle), 2))
    vector[..., 0], vector[..., 1] = np.cos(angle), np.sin(angle)
    return vector


def dot(one: Array, other: Array) -> Array:
    """Inner product of vectors (..., 2), a fifth of the time of a sum over so short an axis."""
    return np.asarray(one[..., 0] * other[..., 0] + one[..., 1] * other[..., 1])


def mirror(line: Array, point: Array) -> Array:
    """Mirror image of `point` at `line` = (normal angle, offset): h_va of [Li2025adaptive]."""
    line, point = np.asarray(line, dtype=np.float64), np.asarray(point, dtype=np.float64)
    normal = unit(line[..., 0])
    return point + 2 * (line[..., 1] - dot(normal, point))[..., None] * normal


def mirror_derivative(line: Array, point: Array) -> Array:
    """Derivative of `mirror` by (normal angle, offset), shape ``(..., 2, 2)`` [coordinate, parameter]."""
    normal = unit(line[..., 0])
    tangent = np.empty_like(normal)
    tangent[..., 0], tangent[..., 1] = -normal[..., 1], normal[..., 0]
    height = line[..., 1] - dot(normal, point)
    along = dot(tangent, point)
    by_angle = 2 * height[..., None] * tangent - 2 * along[..., None] * normal
    slope = np.empty((*by_angle.shape, 2))
    slope[..., 0], slope[..., 1] = by_angle, 2 * normal
    return slope


def line_between(point: Array, image: Array) -> Array:
    """The line at which `point` is mirrored into `image`: h_sfv of [Li2025adaptive] in line form."""
    angle = direction(point, image)
    middle = 0.5 * (np.asarray(point) + np.asarray(image))
    line = np.empty((*np.shape(angle), 2))
    line[..., 0], line[..., 1] = angle, dot(middle, unit(angle))
    return line


def line_through(start: Array, end: Array) -> Array:
    """The line through two points, as (normal angle, offset >= 0)."""
    angle = direction(start, end) + 0.5 * np.pi
    return canonical(np.stack([angle, dot(np.asarray(start), unit(angle))], axis=-1))


def canonical(line: Array) -> Array:
    """A line (..., 2), rad and m, with offset >= 0 and a wrapped angle."""
    line = np.asarray(line, dtype=np.float64)
    flip = line[..., 1] < 0
    return np.stack([wrap(line[..., 0] + np.pi * flip), np.abs(line[..., 1])], axis=-1)


def sfv(line: Array) -> Array:
    """Surface feature vector, the mirror image of the origin, m."""
    line = np.asarray(line)
    return 2 * line[..., 1, None] * unit(line[..., 0])


def line_of_sfv(vector: Array) -> Array:
    """The line of a surface feature vector; the origin itself has none (offset 0, angle 0)."""
    vector = np.asarray(vector, dtype=np.float64)
    return np.stack(
        [np.arctan2(vector[..., 1], vector[..., 0]), 0.5 * np.hypot(*np.moveaxis(vector, -1, 0))], -1
    )


def sfv_covariance(line: Array, covariance: Array) -> Array:
    """Covariance of the SFV from that of (angle, offset), shape ``(..., 2, 2)``, m^2."""
    jacobian = mirror_derivative(np.asarray(line), np.zeros(2))
    return jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)


def slant(level: Array | float, height: Array | float) -> Array:
    """Length of a path over vertical walls whose picture from above is `level` long, m.

    docs/model.md, (M221). Its slope by `level` is their ratio, the cosine of the elevation.

    Parameters
    ----------
    level : (...) m
    height : (...) m
        Of the anchor above the agent.
    """
    return np.asarray(np.hypot(level, height))


def level_of(length: Array | float, height: Array | float) -> Array:
    """The inverse of `slant`: 0 where a length can't reach the height."""
    length = np.asarray(length, np.float64)
    return np.sqrt(np.maximum((length - height) * (length + height), 0.0))


def lean(length: Array | float, height: Array | float) -> Array:
    """Cosine of the elevation at which paths of a length run, at least that of `STEEPEST`."""
    return np.sqrt(1 - np.minimum(np.abs(height) / np.maximum(length, 1e-3), STEEPEST) ** 2)


def elevations(length: Array, height: Array, straight: NDArray[np.bool_]) -> Array:
    """How far above the horizontal paths (L,) leave the anchor, and come from at the agent, (L, 2) rad.

    docs/model.md, (M301).

    Parameters
    ----------
    length, height : (L,) m
        Height of the anchor, or of its image in floor or ceiling, above the agent.
    straight : (L,) bool
        Whether the path goes over walls alone: else it leaves as it arrives, up or down.
    """
    arrival = np.arcsin(np.clip(height / np.maximum(length, 1e-9), -1.0, 1.0))
    return np.stack([np.where(straight, -arrival, arrival), arrival], -1)


@dataclass(frozen=True)
class Segments:
    """Finite wall pieces.

    Attributes
    ----------
    start, end : (W, 2) float64, m
    reflection : (W,) float64
        Amplitude reflection coefficient.
    surface : (W,) int
        Infinite line on which the piece lies; a window and the wall around it share one.
    wall : (W,) int
        Index of the scene's wall entry.
    curve : (W,) int
        The same for a facet of a curved wall, -1 for a piece of a straight one.
    """

    start: Array
    end: Array
    reflection: Array
    surface: NDArray[np.intp]
    wall: NDArray[np.intp]
    curve: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.start)

    def take(self, rows: NDArray[np.bool_]) -> Segments:
        """The pieces chosen by a mask (W,)."""
        return Segments(*(getattr(self, f.name)[rows] for f in fields(self)))

    @property
    def line(self) -> Array:
        """Line of every piece, (W, 2): normal angle (rad) and offset (m)."""
        return line_through(self.start, self.end)


def crossing(start: Array, end: Array, line: Array) -> Array:
    """Fraction of the way from `start` to `end` at which `line` is crossed (inf or nan if parallel)."""
    normal = unit(line[..., 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        return (line[..., 1] - dot(normal, start)) / dot(normal, end - start)


def distance_to_segments(points: Array, start: Array, end: Array) -> Array:
    """Distance of every point to every segment, shape ``points.shape[:-1] + (W,)``, m."""
    points = np.asarray(points)[..., None, :]
    span = end - start
    along = dot(points - start, span) / np.maximum(dot(span, span), 1e-300)
    foot = start + np.clip(along, 0, 1)[..., None] * span
    return np.linalg.norm(points - foot, axis=-1)


@dataclass(frozen=True)
class Course:
    """Paths from anchors over up to two lines to an agent ([Li2025adaptive], section II).

    Attributes
    ----------
    distance : (L,) m
    level : (L,) m
        How long the path is seen from above.
    departure, arrival : (L,) rad
        World direction in which the path leaves the anchor; direction from the agent to where it comes from.
    last_point, first_point : (L, 2) m
        Interaction points on the last and the first surface (equal for a single bounce, NaN for LOS).
    valid : (L,) bool
        The interaction points lie strictly inside their legs and in order.
    """

    distance: Array
    level: Array
    departure: Array
    arrival: Array
    last_point: Array
    first_point: Array
    valid: NDArray[np.bool_]


@dataclass(frozen=True)
class PathGeometry(Course):
    """Paths and their derivatives.

    Attributes
    ----------
    jacobian : (L, 3, 7)
        Derivative of (distance, AoD, AoA) by (agent x, y, heading, last line angle, offset, first line
        angle, offset). The AoA is taken relative to the heading, so its derivative by it is -1.
    """

    jacobian: Array


def course(
    agent: Array, anchor: Array, last: Array, first: Array, bounces: NDArray[np.intp],
    height: Array | float = 0.0,
) -> Course:  # fmt: skip
    """Distance, directions and interaction points of paths.

    Parameters
    ----------
    agent, anchor : (L, 2) m
    last, first : (L, 2)
        Lines hit last and first (normal angle, offset); ignored where `bounces` says so.
    bounces : (L,) int
        0 line of sight, 1 single bounce (uses `last`), 2 double bounce.
    height : (L,) m
        Of the anchor above the agent.
    """
    single, double = bounces == 1, bounces == 2
    reflected = single | double
    image_first = np.where(double[:, None], mirror(first, anchor), anchor)
    image = np.where(reflected[:, None], mirror(last, image_first), anchor)
    away = agent - image
    level = np.maximum(np.sqrt(dot(away, away)), 1e-9)
    toward = -away / level[:, None]
    arrival = np.arctan2(toward[:, 1], toward[:, 0])
    departure = np.where(
        single,
        2 * last[:, 0] - arrival,
        np.where(double, 2 * first[:, 0] - 2 * last[:, 0] + arrival + np.pi, arrival + np.pi),
    )

    fraction = crossing(agent, image, last)
    with np.errstate(invalid="ignore"):
        last_point = agent + fraction[:, None] * (image - agent)
        fraction_first = crossing(last_point, image_first, first)
        first_point = last_point + fraction_first[:, None] * (image_first - last_point)
        inside = (fraction > 0) & (fraction < 1)
        inside_first = (fraction_first > 0) & (fraction_first < 1)
    valid = np.where(double, inside & inside_first, np.where(single, inside, True))
    last_point = np.where(reflected[:, None], last_point, np.nan)
    first_point = np.where(double[:, None], first_point, last_point)
    return Course(slant(level, height), level, wrap(departure), arrival, last_point, first_point, valid)


def trace(
    agent: Array, anchor: Array, last: Array, first: Array, bounces: NDArray[np.intp],
    height: Array | float = 0.0,
) -> PathGeometry:  # fmt: skip
    """As `course`, of the same arguments, with derivatives (L, 3, 7)."""
    single, double = bounces == 1, bounces == 2
    path = course(agent, anchor, last, first, bounces, height)
    toward = unit(path.arrival)
    image_first = np.where(double[:, None], mirror(first, anchor), anchor)
    by_last = mirror_derivative(last, image_first) * (single | double)[:, None, None]
    normal = unit(last[:, 0])
    flip = np.eye(2) - 2 * normal[:, :, None] * normal[:, None, :]
    by_first = flip @ mirror_derivative(first, anchor) * double[:, None, None]
    across = np.stack([-toward[:, 1], toward[:, 0]], axis=-1) / path.level[:, None]
    jacobian = np.zeros((len(agent), 3, 7))
    for block, derivative in ((slice(3, 5), by_last), (slice(5, 7), by_first)):
        jacobian[:, 0, block] = np.einsum("li,lij->lj", toward, derivative)
        jacobian[:, 2, block] = np.einsum("li,lij->lj", across, derivative)
    jacobian[:, 0, 0:2] = -toward
    jacobian[:, 0] *= (path.level / path.distance)[:, None]
    jacobian[:, 2, 0:2] = -across
    jacobian[:, 1] = np.where(single[:, None], -jacobian[:, 2], jacobian[:, 2])
    jacobian[:, 1, 3] += np.where(single, 2.0, np.where(double, -2.0, 0.0))
    jacobian[:, 1, 5] += np.where(double, 2.0, 0.0)
    jacobian[:, 2, 2] = -1.0
    return PathGeometry(**vars(path), jacobian=jacobian)


def surfaces_of(start: Array, end: Array) -> NDArray[np.intp]:
    """Number of the infinite line on which each piece (P, 2) lies (P,), in order of first appearance."""
    return np.array(_surfaces_of(start.tobytes(), end.tobytes()))


@lru_cache(maxsize=64)
def _surfaces_of(start_bytes: bytes, end_bytes: bytes) -> NDArray[np.intp]:
    """`surfaces_of` the same pieces, as bytes; kept, since `check` asks for every reading of a table."""
    start, end = (np.frombuffer(raw).reshape(-1, 2) for raw in (start_bytes, end_bytes))
    surface = np.full(len(start), -1, dtype=np.intp)
    # a long piece fixes a line best
    for piece in np.argsort(-np.linalg.norm(end - start, axis=1), kind="stable"):
        if surface[piece] < 0:
            angle, offset = line_through(start[piece], end[piece])
            normal = np.array([np.cos(angle), np.sin(angle)])
            gap = np.maximum(np.abs(start @ normal - offset), np.abs(end @ normal - offset))
            surface[(gap <= COLLINEAR_M) & (surface < 0)] = piece
    _, first, number = np.unique(surface, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number].astype(np.intp)
