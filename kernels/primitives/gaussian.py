"""Paths linearised at the mean of the joint belief, and what it predicts of them; corrected by `corrections`.

State: see `layout`. A path depends on seven of its entries at most, and on what is unknown of its anchor, the
difference of two clocks or a rise, which lengthens its distance and nothing else.
"""

import taichi as ti

from gridslam.kernels.primitives.functions import PI, bearing_of, cos_of, dot, sin_of, slant_of, wrapped
from gridslam.kernels.primitives.layout import (
    ABOVE,
    FACING,
    HEADING,
    LATE,
    OPEN_HEIGHT,
    anchor_of,
    line_entry,
    steepness_of,
    unknown_entry,
)
from gridslam.kernels.primitives.tables import ANCHOR, BOUNCES, FIRST, LAST, LEARNT, LENGTH, UNCLEAR

UNDIRECTED = 1e-9
"""1/m: less than one over any length."""
OF_BOUNCE = (0, 1, 3, 4)
"""Of the entries that a path depends on, what bends a single bounce: x, y, angle and offset of its line."""


@ti.func
def mirror_of(x, y, angle, offset):
    """Mirror image of a point at a line, and its derivatives by the line's angle and offset."""
    nx, ny = cos_of(angle), sin_of(angle)
    gap = nx * x + ny * y - offset
    along = -ny * x + nx * y
    return (
        ti.Vector([x - 2 * gap * nx, y - 2 * gap * ny], dt=ti.f64),
        ti.Vector([-2 * along * nx + 2 * gap * ny, -2 * along * ny - 2 * gap * nx], dt=ti.f64),
        ti.Vector([2 * nx, 2 * ny], dt=ti.f64),
    )


@ti.func
def path_of(mean: ti.template(), head, place, bounces, last, first):
    """Distance, AoD and AoA of a path, and their derivatives by the seven entries of `entry_of`.

    `place` is that of `anchor_of`; the distance changes by a clock as much as
    that does, and by a rise as `steepness_of` says.
    """
    by_first_line, by_last_line = line_entry(head, first), line_entry(head, last)
    zero = ti.Vector([0.0, 0.0], dt=ti.f64)
    image = ti.Vector([place[0], place[1]], dt=ti.f64)
    by_last, by_first, by_c, by_d = zero, zero, zero, zero  # of the image, by angles and offsets
    turn_last, turn_first = ti.f64(0.0), ti.f64(0.0)
    if bounces == 2:
        image, by_first, by_d = mirror_of(image[0], image[1], mean[by_first_line], mean[by_first_line + 1])
        turn_last, turn_first = ti.f64(-2.0), ti.f64(2.0)
    if bounces >= 1:
        angle = mean[by_last_line]
        image, by_last, by_c = mirror_of(image[0], image[1], angle, mean[by_last_line + 1])
        if bounces == 2:
            n = ti.Vector([cos_of(angle), sin_of(angle)], dt=ti.f64)
            by_first = by_first - 2 * dot(n, by_first) * n
            by_d = by_d - 2 * dot(n, by_d) * n
        else:
            turn_last = ti.f64(2.0)
    toward = ti.Vector([image[0] - mean[0], image[1] - mean[1]], dt=ti.f64)
    distance = ti.max(ti.sqrt(dot(toward, toward)), 1e-9)
    length = slant_of(distance * distance, place[ABOVE])
    lean = distance / length  # slope of the one by the other
    toward /= distance
    across = ti.Vector([-toward[1], toward[0]], dt=ti.f64) / distance
    arrival = bearing_of(toward[0], toward[1])
    # a single bounce turns the direction over, others keep it
    sense = ti.cast(-1.0 if bounces == 1 else 1.0, ti.f64)
    departure = sense * arrival + (0.0 if bounces == 1 else PI)
    if bounces >= 1:
        departure += turn_last * mean[by_last_line]
    if bounces == 2:
        departure += turn_first * mean[by_first_line]
    value = ti.Vector(
        [length + place[LATE], wrapped(departure - place[FACING]), wrapped(arrival - mean[HEADING])],
        dt=ti.f64,
    )
    slope = ti.Matrix.zero(ti.f64, 3, 7)
    slope[0, 0], slope[0, 1] = -lean * toward[0], -lean * toward[1]
    slope[2, 0], slope[2, 1], slope[2, 2] = -across[0], -across[1], -1.0
    slope[0, 3], slope[0, 4] = lean * dot(toward, by_last), lean * dot(toward, by_c)
    slope[2, 3], slope[2, 4] = dot(across, by_last), dot(across, by_c)
    slope[0, 5], slope[0, 6] = lean * dot(toward, by_first), lean * dot(toward, by_d)
    slope[2, 5], slope[2, 6] = dot(across, by_first), dot(across, by_d)
    for n in ti.static(range(7)):
        if ti.static(n != 2):
            slope[1, n] = sense * slope[2, n]
    slope[1, 3] += turn_last
    slope[1, 5] += turn_first
    return value, slope


@ti.func
def entry_of(head, bounces, last, first):
    """Entries of the state that a path depends on; unused ones repeat the first (their derivative is 0)."""
    a, b = (line_entry(head, last) if bounces >= 1 else 0), (line_entry(head, first) if bounces == 2 else 0)
    return ti.Vector([0, 1, HEADING, a, (a + 1 if a > 0 else 0), b, (b + 1 if b > 0 else 0)])


@ti.func
def spread_of(slope, entry, covariance: ti.template()):
    """Covariance of the path's parameters, 3 x 3, but for what is unknown of its anchor."""
    total = ti.Matrix.zero(ti.f64, 3, 3)
    for m in range(7):
        for n in range(7):
            p = covariance[entry[m], entry[n]]
            for i in ti.static(range(3)):
                for j in ti.static(range(3)):
                    total[i, j] += slope[i, m] * p * slope[j, n]
    return total


@ti.func
def spread_by_clocks(slope, entry, clock, covariance: ti.template()):
    """What the difference of two clocks at entry `clock` adds to it: distance has the derivative 1 by it."""
    total = ti.Matrix.zero(ti.f64, 3, 3)
    total[0, 0] += covariance[clock, clock]
    for m in range(7):
        p = covariance[clock, entry[m]]
        for j in ti.static(range(3)):
            total[0, j] += p * slope[j, m]
            total[j, 0] += p * slope[j, m]
    return total


@ti.func
def spread_by_rise(slope, entry, rise, steepness, covariance: ti.template()):
    """What a rise at entry `rise` adds to it, by which distance has the derivative `steepness`."""
    total = ti.Matrix.zero(ti.f64, 3, 3)
    total[0, 0] += steepness * steepness * covariance[rise, rise]
    for m in range(7):
        p = steepness * covariance[rise, entry[m]]
        for j in ti.static(range(3)):
            total[0, j] += p * slope[j, m]
            total[j, 0] += p * slope[j, m]
    return total


@ti.func
def spread_by_unknown(slope, entry, unknown, place, length, covariance: ti.template()):
    """The one or the other, by the anchor's place and the path's length."""
    total = ti.Matrix.zero(ti.f64, 3, 3)
    if place[OPEN_HEIGHT] > 0.5:
        total = spread_by_rise(slope, entry, unknown, steepness_of(place, length), covariance)
    else:
        total = spread_by_clocks(slope, entry, unknown, covariance)
    return total


@ti.func
def bend_of(slope, length, covariance: ti.template()):
    """What a line of sight's derivatives leave out: mean and covariance, docs/model.md, (M291).

    They follow from its derivatives by x and y, its length and the covariance of x and y.
    """
    mean, spread = ti.Vector.zero(ti.f64, 3), ti.Matrix.zero(ti.f64, 3, 3)
    across = ti.Vector([slope[2, 0], slope[2, 1]], dt=ti.f64)
    # one over the length seen from above; at the anchor's very place no derivative has a direction
    near = ti.max(ti.sqrt(dot(across, across)), UNDIRECTED)
    across /= near
    along = ti.Vector([across[1], -across[0]], dt=ti.f64)
    lean = slope[0, 0] * along[0] + slope[0, 1] * along[1]
    xx, xy, yy = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    rr = along[0] ** 2 * xx + 2 * along[0] * along[1] * xy + along[1] ** 2 * yy
    tt = across[0] ** 2 * xx + 2 * across[0] * across[1] * xy + across[1] ** 2 * yy
    rt = along[0] * across[0] * xx + along[1] * across[1] * yy
    rt += (along[0] * across[1] + along[1] * across[0]) * xy
    width = ti.sqrt(xx + yy)  # nearer than that, the series says nothing
    length, near = ti.max(length, width), ti.min(near, 1 / width)
    by_r, by_t = (1 - lean * lean) / length, 1 / length  # second derivatives of the length
    mean[0] = 0.5 * (by_r * rr + by_t * tt)
    mean[1] = mean[2] = -rt * near * near
    spread[0, 0] = 0.5 * (by_r * by_r * rr * rr + by_t * by_t * tt * tt) + by_r * by_t * rt * rt
    both = -(by_r * rr + by_t * tt) * rt * near * near
    turned = (rt * rt + rr * tt) * near**4
    for i in ti.static(range(1, 3)):
        spread[0, i] = spread[i, 0] = both
        for j in ti.static(range(1, 3)):
            spread[i, j] = turned
    return mean, spread


@ti.func
def bend_of_bounce(slope, length, place, angle, offset, block):
    """What a single bounce's derivatives leave out: mean and covariance, docs/model.md, (M552).

    `block` (4, 4) is the covariance of x, y and the line. The anchor's image runs on a circle with the line's
    angle, which one measurement hardly tells where the line is close to the anchor.
    """
    mean, spread = ti.Vector.zero(ti.f64, 3), ti.Matrix.zero(ti.f64, 3, 3)
    across = ti.Vector([-slope[2, 0], -slope[2, 1]], dt=ti.f64)
    near = ti.max(ti.sqrt(dot(across, across)), UNDIRECTED)
    across /= near
    along = ti.Vector([across[1], -across[0]], dt=ti.f64)  # from the agent to the anchor's image
    lean = ti.max(-slope[0, 0] * along[0] - slope[0, 1] * along[1], UNDIRECTED)
    n = ti.Vector([cos_of(angle), sin_of(angle)], dt=ti.f64)
    t = ti.Vector([-n[1], n[0]], dt=ti.f64)
    away = n[0] * place[0] + n[1] * place[1]
    turned = 2 * (2 * away - offset) * n - 4 * (t[0] * place[0] + t[1] * place[1]) * t  # twice by the angle
    by_r, by_t = ti.Vector.zero(ti.f64, 4), ti.Vector.zero(ti.f64, 4)  # what moves the image along and across
    for k in ti.static(range(4)):
        by_r[k], by_t[k] = slope[0, OF_BOUNCE[k]] / lean, slope[2, OF_BOUNCE[k]] / near
    wide = ti.sqrt(by_r.dot(block @ by_r) + by_t.dot(block @ by_t))
    length, near = ti.max(length, wide), ti.min(near, 1 / wide)
    by_length = (1 - lean * lean) / length * by_r.outer_product(by_r) + by_t.outer_product(by_t) / length
    by_angle = -near * near * (by_r.outer_product(by_t) + by_t.outer_product(by_r))
    by_length[2, 2] += lean * dot(along, turned)
    by_angle[2, 2] += near * dot(across, turned)
    for one in ti.static(range(2)):  # by angle and offset
        by_length[2 + one, 3 - one] += lean * 2 * dot(along, t)
        by_angle[2 + one, 3 - one] += near * 2 * dot(across, t)
    first, second = by_length @ block, by_angle @ block
    mean[0], mean[2] = 0.5 * first.trace(), 0.5 * second.trace()
    spread[0, 0], spread[2, 2] = 0.5 * (first @ first).trace(), 0.5 * (second @ second).trace()
    spread[0, 2] = spread[2, 0] = 0.5 * (first @ second).trace()
    mean[1], spread[1, 1] = -mean[2], spread[2, 2]  # a single bounce turns the direction over
    spread[0, 1] = spread[1, 0] = -spread[0, 2]
    spread[1, 2] = spread[2, 1] = -spread[2, 2]
    return mean, spread


@ti.func
def predict_by(
    mean: ti.template(), covariance: ti.template(), head, path: ti.template(), places: ti.template(), row,
    out: ti.template(),
):  # fmt: skip
    """Predict one path, docs/model.md, (M21), and how well its length is known, (M541)."""
    bounces, last, first, anchor = path[row, BOUNCES], path[row, LAST], path[row, FIRST], path[row, ANCHOR]
    place = anchor_of(places, mean, head, anchor)
    value, slope = path_of(mean, head, place, bounces, last, first)
    entry = entry_of(head, bounces, last, first)
    spread, unknown = spread_of(slope, entry, covariance), unknown_entry(places, head, anchor)
    out[row, LENGTH] = value[0] - place[LATE]
    for i in ti.static(range(3)):
        out[row, i] = value[i]
        for j in ti.static(range(3)):
            out[row, 3 + 3 * i + j] = spread[i, j]
    out[row, UNCLEAR] = out[row, LEARNT] = spread[0, 0]
    if unknown >= 0:
        more = spread_by_unknown(slope, entry, unknown, place, value[0] - place[LATE], covariance)
        for i in ti.static(range(3)):
            for j in ti.static(range(3)):
                total = out[row, 3 + 3 * i + j] + more[i, j]
                out[row, 3 + 3 * i + j] = total
        if place[OPEN_HEIGHT] > 0.5:  # a rise lengthens the path itself
            out[row, UNCLEAR] = out[row, LEARNT] = spread[0, 0] + more[0, 0]
        else:
            out[row, LEARNT] = spread[0, 0] + 0.5 * (more[0, 0] - covariance[unknown, unknown])
