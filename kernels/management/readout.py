"""Estimates for users: surfaces with their feature vectors, and the paths that exist."""

import taichi as ti

from gridslam.kernels.primitives.blocks import Belief, Description, Links, SurfaceRows
from gridslam.kernels.primitives.functions import cos_of, sin_of
from gridslam.kernels.primitives.gaussian import path_of
from gridslam.kernels.primitives.launching import copying
from gridslam.kernels.primitives.layout import LATE, anchor_of, line_entry
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.radio import amplitude_of
from gridslam.kernels.primitives.tables import (
    ANCHOR,
    BOUNCES,
    BY_COEFFICIENTS,
    COEFFICIENT_VARIANCE,
    CORNERS,
    EXISTS,
    FIRST,
    FROM_ANCHOR,
    LAST,
    LINE,
    LINE_COVARIANCE,
    MEAN_COEFFICIENT,
    OVER_FIRST,
    OVER_LAST,
    RAY_POSSIBLE,
    SFV,
    SFV_COVARIANCE,
    STRETCH,
)
from gridslam.kernels.propagation.coefficients import BINS
from gridslam.kernels.propagation.paths import draw_path, stand_at
from gridslam.kernels.propagation.rays import enter_path, listed

BELIEVED = 0.5
"""Existence from which on a path is listed."""
NAN = 0x7FF8, 48
"""High word of NaN, and its shift: fast math can't compute a NaN."""
PI_HIGH, PI_LOW = 3.1415927410125732, 8.742277657347586e-08
"""Pi is their difference: constants alone have single precision."""


@ti.func
def tell_surface(
    s, mean: ti.template(), covariance: ti.template(), head, extent: ti.template(), reflection: ti.template(),
    table: ti.template(),
):  # fmt: skip
    """Write one surface's row."""
    pi = ti.cast(PI_HIGH, ti.f64) - ti.cast(PI_LOW, ti.f64)
    at = line_entry(head, s)
    angle, offset = mean[at], mean[at + 1]
    cosine, sine = cos_of(angle), sin_of(angle)
    turned = offset < 0  # the same line with the normal the other way round
    sign = ti.select(turned, -1.0, 1.0)
    by_angle, own = covariance[at, at], covariance[at + 1, at + 1]
    both = sign * covariance[at, at + 1]
    angle += ti.select(turned, pi, 0 * pi)
    table[s, LINE] = angle - 2 * pi * ti.floor(angle / (2 * pi) + 0.5)
    table[s, LINE + 1] = ti.abs(offset)
    table[s, LINE_COVARIANCE], table[s, LINE_COVARIANCE + 1] = by_angle, both
    table[s, LINE_COVARIANCE + 2], table[s, LINE_COVARIANCE + 3] = both, own
    table[s, SFV], table[s, SFV + 1] = 2 * offset * cosine, 2 * offset * sine
    # derivatives of the mirror image of the origin by the line as it was
    ax, ay, bx, by = -2 * offset * sine, 2 * offset * cosine, 2 * cosine, 2 * sine
    cross = covariance[at, at + 1]
    table[s, SFV_COVARIANCE] = ax * ax * by_angle + 2 * ax * bx * cross + bx * bx * own
    table[s, SFV_COVARIANCE + 1] = ax * ay * by_angle + (ax * by + ay * bx) * cross + bx * by * own
    table[s, SFV_COVARIANCE + 2] = table[s, SFV_COVARIANCE + 1]
    table[s, SFV_COVARIANCE + 3] = ay * ay * by_angle + 2 * ay * by * cross + by * by * own
    first, second = 0 * pi, 0 * pi
    for n in range(BINS):
        level = (ti.cast(n, ti.f64) + 0.5) / BINS
        first += level * reflection[s, n]
        second += level * level * reflection[s, n]
    table[s, MEAN_COEFFICIENT], table[s, COEFFICIENT_VARIANCE] = first, second - first * first
    low, high = extent[s, 0], extent[s, 1]
    table[s, STRETCH] = ti.select(turned, -high, low)
    table[s, STRETCH + 1] = ti.select(turned, -low, high)


@ti.func
def tell_path(
    row, existence, mean: ti.template(), head, path: ti.template(), places: ti.template(),
    identity: ti.template(), at_1m, table: ti.template(), drawn: ti.template(), number: ti.template(),
    quantity: ti.template(),
):  # fmt: skip
    """Write one path's row: by which surfaces, and its parameters; `drawn` has its corners.

    Row `row` of `path` (room, 4), `drawn` (room, 13), `number` (room, 3) and `quantity` (room, 13), as
    `blocks.Description` has them; `existence` is that of ray and surfaces, `mean` (N,) the belief's, `head`
    its entry where the lines begin, `places` (J, 6) of anchors, `identity` (S,) and `table` (S, 16) of
    surfaces, `at_1m` the amplitude of a line of sight 1 m long.
    """
    bounces, last, first, anchor = path[row, BOUNCES], path[row, LAST], path[row, FIRST], path[row, ANCHOR]
    place = anchor_of(places, mean, head, anchor)
    value, _slope = path_of(mean, head, place, bounces, last, first)
    coefficient = ti.f64(1.0)
    number[row, FROM_ANCHOR], number[row, OVER_LAST], number[row, OVER_FIRST] = anchor, -1, -1
    if bounces > 0:
        number[row, OVER_LAST], number[row, OVER_FIRST] = identity[last], identity[first]
        by_first = table[first, MEAN_COEFFICIENT] if bounces == 2 else 1.0
        coefficient = table[last, MEAN_COEFFICIENT] * by_first
    for i in ti.static(range(3)):
        quantity[row, i] = value[i]
    quantity[row, BY_COEFFICIENTS] = amplitude_of(at_1m, value[0] - place[LATE]) * coefficient
    quantity[row, EXISTS] = existence
    for n in ti.static(range(8)):
        quantity[row, CORNERS + n] = drawn[row, n]
        if ti.static(2 <= n < 6) and bounces < (1 if ti.static(n < 4) else 2):
            quantity[row, CORNERS + n] = ti.bit_cast(ti.cast(NAN[0], ti.i64) << NAN[1], ti.f64)


@copying("belief", "links", "extent", "reflection")
@ti.kernel
def describe(
    head: ti.i32,  # entry where the lines begin: see `layout`
    bounces: ti.i32,  # of a path at most
    at_1m: ti.f64,  # amplitude of a line of sight 1 m long
    belief: pack(Belief),
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 6] anchors: see `blocks`
    links: pack(Links),
    surfaces: pack(SurfaceRows),
    out: pack(Description),
):
    """Describe all surfaces, and the believed paths that are possible, at the mean of the belief."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        count, n = links.surface.shape[0], 0
        for s in range(count):
            tell_surface(
                s, belief.mean, belief.covariance, head, surfaces.extent, surfaces.reflection, out.table
            )
        stand_at(belief.mean, head, out.state)
        for anchor in range(places.shape[0]):
            for kind in range(3 if bounces > 1 else 2):
                for s in range(1 if kind == 0 else count):
                    for r in range(count if kind == 2 else 1):
                        there, chance, together = listed(kind, s, r, anchor, links)
                        if there and chance * together > BELIEVED:
                            enter_path(out.path, n, kind, s, r, anchor)
                            draw_path(out.state, out.path, places, n, 0, out.drawn)
                            if out.drawn[n, RAY_POSSIBLE] > 0.5:
                                tell_path(
                                    n, chance * together, belief.mean, head, out.path, places,
                                    surfaces.identity, at_1m, out.table, out.drawn, out.number, out.quantity,
                                )  # fmt: skip
                                n += 1
        out.found[0] = n
