"""Blocks of arguments: arrays that belong together, which kernels take whole and by name.

A kernel's argument ``belief: pack(Belief)`` has ``belief.mean`` and ``belief.covariance``. Nothing is copied.
Types and numbers of axes stand beside the names; within one kernel no name may occur twice.
"""

from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Doubles: TypeAlias = Annotated[NDArray[np.float64], "f64", 1]
Square: TypeAlias = Annotated[NDArray[np.float64], "f64", 2]
Cube: TypeAlias = Annotated[NDArray[np.float64], "f64", 3]
Whole: TypeAlias = Annotated[NDArray[np.int32], "i32", 1]
Wholes: TypeAlias = Annotated[NDArray[np.int32], "i32", 2]
Long: TypeAlias = Annotated[NDArray[np.int64], "i64", 1]
Longs: TypeAlias = Annotated[NDArray[np.int64], "i64", 2]
# where the device has them
Kept: TypeAlias = Annotated[Any, "f64", 2]
KeptCube: TypeAlias = Annotated[Any, "f64", 3]
KeptWholes: TypeAlias = Annotated[Any, "i32", 2]
KeptWholeCube: TypeAlias = Annotated[Any, "i32", 3]
Single: TypeAlias = Annotated[Any, "f32", 2]
Bytes: TypeAlias = Annotated[Any, "u8", 2]

ONLY, MOST_BOUNCES, HEAD, OFFSET, ROOTED, SENDERS = range(6)
"""Places of `Query.choice`: the anchor, -1 for all, one after the other, or `ALREADY_LISTED`; bounces at
most, single ones are always listed; entry of the mean where the lines begin, see `primitives.layout`; first
of the points that samples are drawn by, after the last comes the first; `TAKE_ROOT`, `ROOT_GIVEN` or
`STATE_GIVEN`; how many anchors send: all after these are their images, and listed with them."""
STAY, APPEAR, SHARE = range(3)
"""Places of `Query.weight`: probabilities that a ray stays and that one appears, 1 and 0 list them as they
are; share of the covariance's root that particles are drawn with."""


class Belief(NamedTuple):
    """Gaussian: mean [N] and covariance [N, N]."""

    mean: Doubles
    covariance: Square


class Anchors(NamedTuple):
    """Anchors: x, y, orientation, height above the agent as believed and as told, and which rise makes it
    another, or -1 for none, -2 where other anchors have one [J, 6]; the radio's numbers [J, 12], see
    `primitives.radio`."""

    places: Square
    radio: Square


class Query(NamedTuple):
    """Which paths are listed and how, and what is drawn: see `ONLY` and `STAY`."""

    choice: Whole
    weight: Doubles


class Links(NamedTuple):
    """Existence of surfaces [S] and the one anchor that each serves [S], -1 for all; of rays: lines of sight
    [J], over one surface [J, S], over (last, first) [J, S, S]."""

    surface: Doubles
    owner: Long
    sight: Doubles
    single: Square
    double: Cube


class Draft(NamedTuple):
    """What samples are drawn with: standard normal points [N or more, P]; root of the covariance [N, N],
    lower triangular, in or out; out: share of it, and the mean with its cosine and sine [N, 3], for
    `draw_block`; samples [3 + 3 S (+ J), R], given or ``mean + whole points``; whether the covariance is
    singular [1]."""

    points: Single
    whole: Square
    root: Single
    base: Single
    state: Kept
    failed: Whole


class Listed(NamedTuple):
    """Paths, given or out: bounces, last, first, anchor [L, 4]; existence of the ray, and of all surfaces
    involved [L]; prediction [L, 15], see `tables`; how many there are [1]. L may be more than that."""

    path: Wholes
    existence: Doubles
    surfaces: Doubles
    predicted: Square
    found: Whole


class Clues(NamedTuple):
    """One scan, to score poses by: of anchors x, y (m), height above the agent, u at 1 m, number of samples
    [A, 5], and where its measurements and known single bounces begin and end [A, 4]; measurements [M, 22] and
    known single bounces [S, 9], columns as in `primitives.clues`; p_d from u = 0 on [T]."""

    listener: Square
    own: Wholes
    measured: Square
    known: Square
    chance: Doubles


class Cells(NamedTuple):
    """The grid: o of a traversed cell, and of a hit one in V [2, ny nx]; frame [8]: origin x, y, side, factor
    outside, clip, least share, how likely a wall is of another material where it is hit next, depth in which
    a wall is spared by rays that it reflects; a cell's row of `held` [ny, nx], -1 for none; log-likelihoods
    of coefficients in hit cells [H, BINS]; beliefs about those of surfaces [S, BINS]."""

    occupied: Single
    frame: Doubles
    where: Wholes
    held: Single
    reflection: Square


class Casting(NamedTuple):
    """What is cast: A of a path, and whether to send messages [L, 2]; out: corners, normals, possible or not,
    V [L R, 14]; mean V where possible, share of states where it is, mean of the first and second corner [L,
    6]; beliefs over products of coefficients [L or 0, 2 BINS]."""

    factor: Square
    drawn: Kept
    seen: Square
    products: Square


class Slabs(NamedTuple):
    """Of each slab: scratch [SLABS, LINES, LANES] and [SLABS, PLACES, LANES]; sums [3 SLABS, ny nx], zero on
    entry and exit; cells touched [2 SLABS, ny nx + 1], scratch; cells met [SLABS, ny nx], zero on entry and
    exit; in and out: sums of log ratios [SLABS, ny nx], and where there are any [SLABS, groups of CELLS]."""

    line: KeptCube
    place: KeptWholeCube
    sums: Single
    touched: KeptWholes
    met: Bytes
    message: Single
    news: Bytes


class Amplitudes(NamedTuple):
    """Belief of every path's amplitude over the nodes [L, K]; amplitudes of the nodes, or those at 1 m [K];
    p_d over ``0, step, ...`` [T]."""

    probability: Square
    nodes: Doubles
    chance: Doubles


class PathRows(NamedTuple):
    """Paths [L, 4], and their prediction [L, 15], see `tables`."""

    path: Wholes
    predicted: Square


class Drawing(NamedTuple):
    """How particles are drawn: root [N, N] and base [N, 3], standard normal points [N or more, P or more];
    out: particles [3 + 3 S (+ J), P]."""

    root: Single
    base: Single
    points: Single
    state: Single


class Gating(NamedTuple):
    """Scratch of an evaluation: densities of amplitudes [2, M, K]; their ratios to clutter and means [2, L,
    M]; of each pair z, inverse (6), nearest, farthest [L M, 11]."""

    density: Cube
    strength: Cube
    table: Single


class Pairs(NamedTuple):
    """Where the pairs of each path begin [L + 1]; path and measurement [K or more, 2]; z (3), variances (3),
    density, determinant [K or more, 8]; by blocks of particles, at how many each path is possible, and sums
    of each pair's densities [L + K or more, P / BLOCK]."""

    start: Whole
    index: Wholes  # type: ignore[assignment]  # a tuple's method of that name isn't needed
    pair: Square
    blocks: Single


class Ratios(NamedTuple):
    """By path [12, L], by path and measurement [5, L, M], by measurement [5, M]: see `primitives.tables`."""

    odds: Square
    message: Cube
    measured: Square


class Existence(NamedTuple):
    """Existence, in and out: of surfaces [S], lines of sight [J], rays over one surface [J, S] and over two
    [J, S, S]."""

    surface: Doubles
    sight: Doubles
    single: Square
    double: Cube


class Account(NamedTuple):
    """Scratch [N, 6]; out: probability of each association [K or more]; by which anchors are taken to be
    turned [J] rad; in and out: how they fitted [J, 9], see `kernels.SUMS`."""

    scratch: Square
    share: Doubles
    turned: Doubles
    sums: Square


class Messages(NamedTuple):
    """Messages of all paths of a step, in and out: numbers of paths and pairs [2]; paths [room or 0, 4]; A,
    and whether it tells of cells [room, 2]; summary [4, room]; where the pairs of each path begin [room + 1];
    amplitude and probability [2, room]. See `propagation.path_messages`."""

    count: Whole  # type: ignore[assignment]
    noted: Wholes
    factor: Square
    summary: Square
    begin: Whole
    detection: Square


class Drawn(NamedTuple):
    """Rays as cast [room R, 14], and means of each path [room, 6]."""

    drawn: Kept
    seen: Square


class Coefficients(NamedTuple):
    """Beliefs about coefficients, in and out: of surfaces [S, BINS]; a cell's row of `held` [ny, nx]; of hit
    cells [H or more, BINS]; H [1]; scratch: mean of every surface [S], its latest anchor [S]."""

    surface: Square
    where: Wholes
    held: Single
    used: Whole
    usual: Doubles
    latest: Whole


class Hits(NamedTuple):
    """Where surfaces were hit, in and out: tangential coordinate of the latest hit [S]; stretch that was hit,
    if any was [S, 2]; detections, one per anchor at most, if its paths follow each other [S]; from where (2)
    to where (2) the paths go that hit lowest (4) and highest [S, 8], with their other bounce unfolded."""

    foot: Doubles
    extent: Square
    times: Long
    outermost: Square


class SurfaceRows(NamedTuple):
    """Stretch of each surface that was hit [S, 2], belief over its coefficient [S, BINS], identity [S]."""

    extent: Square
    reflection: Square
    identity: Long


class Description(NamedTuple):
    """Scratch [3 + 3 S, 1]; out: line (2) and covariance (4), SFV (2) and covariance (4), coefficient and
    variance, extent (2), of the line with offset >= 0 [S, 16]; paths [room, 4]; scratch, see `draw_path`
    [room, 13]; anchor, identities of last and first [room, 3]; distance with clocks, AoD, AoA, amplitude by
    coefficients, existence of ray and surfaces, corners (8), NaN for bounces that there aren't [room, 13];
    number of paths [1]. There is room for one more than there can be."""

    state: Square
    table: Square
    path: Wholes
    drawn: Square
    number: Longs
    quantity: Square
    found: Whole


class BirthRows(NamedTuple):
    """Scratch [M, A H], anchor by anchor; out: how many births there are, and of each its measurement, known
    surfaces and anchor [1 + M A H, 4]; line at the mean, and births over clutter, as mean numbers [M A H, 3]:
    see `tables`."""

    ratio: Square
    born: Wholes
    proposal: Square


class Sketch(NamedTuple):
    """Scratch for one ray at a time: [1 or more, LINES, LANES], [1 or more, PLACES, LANES], [3 + 3 (S + 1),
    1], [1, 4], [1, 14]."""

    line: KeptCube
    place: KeptWholeCube
    state: Square
    path: Wholes
    drawn: Square


class Newborn(NamedTuple):
    """Scratch [N + 2]; out: mean and covariance with the new line [N + 2], [N + 2, N + 2]; belief over its
    coefficient [BINS]; by how many deviations it misses its own distance or angle [1]."""

    spread: Doubles
    fresh: Doubles
    joint: Square
    coefficient: Doubles
    missed: Doubles


class Left(NamedTuple):
    """What earlier steps left unexplained: poses after the latest steps, the latest first [W, 3], and their
    covariances [W, 3, 3]; where each step's measurements begin [W + 1]; of each its anchor, distance, AoD and
    AoA (3), their deviations (3), amplitude [H, 8]."""

    pose: Square
    spread: Cube
    begin: Whole
    rows: Square


class Borne(NamedTuple):
    """Lines [B, 2] and which measurement bears each [B]; out: by how much likelier what was left over is, by
    coefficient [B, BINS], and how often each was heard [B]; scratch [J + 2, 2, BINS]."""

    line: Square
    measurement: Whole
    gain: Square
    seen: Long
    product: Cube


class Ascent(NamedTuple):
    """Adam's steps [7], see `kernels.messages.feature_ascent`; in and out: its means, and room for slopes
    [3, n, 4]; the best features so far [D, 4], and A there [1]. Out: A where each step begins [steps]."""

    plan: Doubles
    slopes: Cube
    best: Square
    highest: Doubles
    value: Doubles
