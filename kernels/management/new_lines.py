"""Where a measurement puts a new line: the direction that it is made of, angle, offset and derivatives."""

import taichi as ti

from gridslam.kernels.primitives.functions import (
    bearing_of,
    cos_of,
    dot,
    double_bounce,
    mirrored,
    sin_of,
    single_bounce,
    wrapped,
)
from gridslam.kernels.primitives.gaussian import mirror_of
from gridslam.kernels.primitives.layout import FACING, HEADING
from gridslam.kernels.primitives.tables import AOA, AOD

REACH, TRIALS = 4.0, 41
"""Deviations and number of directions of arrival that are tried for a new line, coarse and then fine."""
IMPOSSIBLE = 1e3
"""Misfit of a direction from which no path leads to the anchor."""


@ti.func
def misfit_of(
    arrival, mean: ti.template(), place, known, last, first, level, scan: ti.template(), m, std, wide
):  # fmt: skip
    """How badly a direction of arrival explains AoA and AoD; `known` is the normal and offset of a line."""
    px, py, bearing = mean[0], mean[1], mean[HEADING] + arrival
    vx, vy = px + level * cos_of(bearing), py + level * sin_of(bearing)
    sx, sy = place[0], place[1]
    if last >= 0:
        vx, vy = mirrored(vx, vy, known[0], known[1], known[2])
    if first >= 0:
        sx, sy = mirrored(sx, sy, known[0], known[1], known[2])
    span = ti.max(ti.sqrt((vx - sx) ** 2 + (vy - sy) ** 2), 1e-12)
    nx, ny = (vx - sx) / span, (vy - sy) / span
    c = 0.5 * (nx * (vx + sx) + ny * (vy + sy))
    _tx, _ty, wx, wy, good = single_bounce(px, py, place[0], place[1], nx, ny, c)
    if last >= 0:
        _tx, _ty, wx, wy, good = double_bounce(
            px, py, place[0], place[1], known[0], known[1], known[2], nx, ny, c
        )
    elif first >= 0:
        _tx, _ty, wx, wy, good = double_bounce(
            px, py, place[0], place[1], nx, ny, c, known[0], known[1], known[2]
        )
    by_arrival = wrapped(arrival - scan[m, AOA]) / wide
    by_departure = wrapped(scan[m, AOD] + place[FACING] - bearing_of(wx, wy)) / std[1]
    return by_arrival**2 + by_departure**2 + IMPOSSIBLE * (1 - good)


@ti.func
def reflected(point, moved, mean: ti.template(), known):
    """A point behind a known line, and its derivatives, to which those by the line are added."""
    image, by_angle, by_offset = mirror_of(point[0], point[1], mean[known], mean[known + 1])
    nx, ny = cos_of(mean[known]), sin_of(mean[known])
    turned = moved
    for e in ti.static(range(5)):
        along = 2 * (nx * moved[0, e] + ny * moved[1, e])
        turned[0, e] -= along * nx
        turned[1, e] -= along * ny
    for i in ti.static(range(2)):
        turned[i, 5], turned[i, 6] = by_angle[i], by_offset[i]
    return image, turned


@ti.func
def line_at(angle, arrives, mean: ti.template(), place, known, last, first, level, lean):
    """The new line's angle and offset, and their derivatives by x, y, heading, length, angle, known line.

    The angle is an AoA if it `arrives`, else an AoD: the same path from its other end. `level` is the length
    seen from above, `lean` the slope of the length by it.
    """
    bearing, near, far = mean[HEADING] + angle, last, first
    image, source = ti.Vector([mean[0], mean[1]], dt=ti.f64), ti.Vector([place[0], place[1]], dt=ti.f64)
    moved, left = ti.Matrix.zero(ti.f64, 2, 7), ti.Matrix.zero(ti.f64, 2, 7)  # of image, and of source
    if arrives:
        moved[0, 0], moved[1, 1] = 1.0, 1.0
    else:
        bearing, near, far, image, source = place[FACING] + angle, first, last, source, image
        left[0, 0], left[1, 1] = 1.0, 1.0
    u = ti.Vector([cos_of(bearing), sin_of(bearing)], dt=ti.f64)
    across = ti.Vector([-u[1], u[0]], dt=ti.f64)
    image += level * u
    for i in ti.static(range(2)):
        moved[i, 3], moved[i, 4] = u[i] / lean, level * across[i]
        moved[i, 2] = level * across[i] if arrives else 0.0
    if near >= 0:
        image, moved = reflected(image, moved, mean, known)
    if far >= 0:
        source, left = reflected(source, left, mean, known)
    span = ti.max(ti.sqrt(dot(image - source, image - source)), 1e-12)
    normal, middle = (image - source) / span, 0.5 * (image + source)
    tangent, slope = ti.Vector([-normal[1], normal[0]], dt=ti.f64), ti.Matrix.zero(ti.f64, 2, 7)
    for e in ti.static(range(7)):
        gap = ti.Vector([moved[0, e] - left[0, e], moved[1, e] - left[1, e]], dt=ti.f64)
        both = ti.Vector([moved[0, e] + left[0, e], moved[1, e] + left[1, e]], dt=ti.f64)
        slope[0, e] = dot(tangent, gap) / span
        slope[1, e] = slope[0, e] * dot(tangent, middle) + 0.5 * dot(normal, both)
    return bearing_of(normal[0], normal[1]), dot(normal, middle), slope


@ti.func
def known_line(mean: ti.template(), entry, surface):
    """Normal and offset of a known surface; zeros where there is none."""
    line = ti.Vector([0.0, 0.0, 0.0], dt=ti.f64)
    if surface >= 0:
        line[0], line[1], line[2] = cos_of(mean[entry]), sin_of(mean[entry]), mean[entry + 1]
    return line


@ti.func
def likeliest_arrival(
    mean: ti.template(), place, known, last, first, level, scan: ti.template(), m, std, wide
):  # fmt: skip
    """Direction of arrival that explains AoA and AoD best, searched for coarsely and then finely."""
    angle = scan[m, AOA]
    for stage in range(2):
        reach = wide * (REACH if stage == 0 else 2 * REACH / TRIALS)
        middle, best, least = angle, angle, ti.f64(1e30)
        for k in range(TRIALS):
            trial = middle + reach * (2 * ti.cast(k, ti.f64) / (TRIALS - 1) - 1)
            misfit = misfit_of(trial, mean, place, known, last, first, level, scan, m, std, wide)
            if misfit < least:
                best, least = trial, misfit
        angle = best
    return angle
