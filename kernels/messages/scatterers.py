"""Walls that stay and points that scatter, fitted to what is heard of surfaces (docs/model.md, (M559))."""

import taichi as ti

from gridslam.kernels import DECIDED, UNMEASURED
from gridslam.kernels.primitives.functions import bearing_of, cos_of, dot, logarithm_of, sin_of, wrapped
from gridslam.kernels.primitives.gaussian import mirror_of
from gridslam.kernels.primitives.launching import quick

WALL, POINT, ODDS = 0, 5, 10
"""Columns of a form: of either where its mean (2) and covariance (xx, xy, yy) begin; their log odds."""
BELIEVED, SHIFTED_M = 4.0, 1.0
"""Variances of the line as it is believed, with which a wall begins; deviation of the point's place, m."""
FADING = 1.02
"""Growth of a covariance with each measurement: poses that are off together don't average out."""
MOST_TOLD, MOST_SURPRISED = 3.0, 3.0
"""What one measurement may tell at most, nats, and by how many deviations it may move a form."""
NEAR_M = 0.05
"""Lengths are not taken to be shorter."""


@quick
@ti.kernel
def fit_forms(
    pose: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [3] x, y, heading of the agent
    known: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [3, 3] their covariance
    heard: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [D, 6] distance, AoD, AoA, and their own variances
    place: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [D, 3] x, y, orientation of the anchors
    line: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [D, 5] angle, offset and covariance as they are believed
    form: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [D, 11] in and out: both forms, and their log odds
):
    """Correct both forms of D surfaces by a measurement of each, and their log odds (M560)."""
    ti.loop_config(serialize=True)
    for row in range(form.shape[0]):
        fresh = form[row, 2] == 0 and form[row, 4] == 0 and form[row, 7] == 0 and form[row, 9] == 0
        if fresh:
            begin(row, pose, heard, place, line, form)
        value, slope, lateral = off_wall(row, pose, place, form)
        said = corrected(form, row, WALL, value, slope, lateral, heard, known)
        value, slope, lateral = off_point(row, pose, place, form)
        said -= corrected(form, row, POINT, value, slope, lateral, heard, known)
        if not fresh:
            told = ti.min(ti.max(said, -MOST_TOLD), MOST_TOLD)
            form[row, ODDS] = ti.max(form[row, ODDS] + told, -DECIDED)


@ti.func
def off_wall(row, pose: ti.template(), place: ti.template(), form: ti.template()):
    """Distance, AoD and AoA off a wall, their slopes by it, and its extent across the way over the length."""
    here = ti.Vector([pose[0], pose[1]], dt=ti.f64)
    there = ti.Vector([place[row, 0], place[row, 1]], dt=ti.f64)
    angle, offset = form[row, WALL], form[row, WALL + 1]
    back, by_angle, by_offset = mirror_of(there[0], there[1], angle, offset)
    out, out_by_angle, out_by_offset = mirror_of(here[0], here[1], angle, offset)
    coming, going = back - here, out - there
    length = ti.max(ti.sqrt(dot(coming, coming)), NEAR_M)
    ahead, across = coming / length, turned(coming) / length
    aside = turned(going) / (length * length)
    departing = bearing_of(going[0], going[1]) - place[row, 2]
    arriving = bearing_of(coming[0], coming[1]) - pose[2]
    bend = ti.Vector([dot(across, by_angle), dot(across, by_offset)], dt=ti.f64)
    slope = ti.Matrix(
        [
            [dot(ahead, by_angle), dot(ahead, by_offset)],
            [dot(aside, out_by_angle), dot(aside, out_by_offset)],
            [bend[0] / length, bend[1] / length],
        ],
        dt=ti.f64,
    )
    lateral = extent(form, row, WALL, bend) / length
    return ti.Vector([length, departing, arriving], dt=ti.f64), slope, lateral


@ti.func
def off_point(row, pose: ti.template(), place: ti.template(), form: ti.template()):
    """Distance, AoD and AoA off a point, their slopes by it; a length bends about it from either end."""
    point = ti.Vector([form[row, POINT], form[row, POINT + 1]], dt=ti.f64)
    going = point - ti.Vector([place[row, 0], place[row, 1]], dt=ti.f64)
    coming = point - ti.Vector([pose[0], pose[1]], dt=ti.f64)
    far, near = ti.max(ti.sqrt(dot(going, going)), NEAR_M), ti.max(ti.sqrt(dot(coming, coming)), NEAR_M)
    going, coming = going / far, coming / near
    departing = bearing_of(going[0], going[1]) - place[row, 2]
    arriving = bearing_of(coming[0], coming[1]) - pose[2]
    by_length, by_out, by_in = going + coming, turned(going) / far, turned(coming) / near
    slope = ti.Matrix([[by_length[0], by_length[1]], [by_out[0], by_out[1]], [by_in[0], by_in[1]]], dt=ti.f64)
    lateral = extent(form, row, POINT, turned(going)) / far + extent(form, row, POINT, turned(coming)) / near
    return ti.Vector([far + near, departing, arriving], dt=ti.f64), slope, lateral


@ti.func
def begin(
    row, pose: ti.template(), heard: ti.template(), place: ti.template(), line: ti.template(),
    form: ti.template(),
):  # fmt: skip
    """A wall as it is believed, and a point on the way to where it was heard from."""
    for n in ti.static(range(5)):
        form[row, WALL + n] = line[row, n] * (1.0 if n < 2 else BELIEVED)
    here = ti.Vector([pose[0], pose[1]], dt=ti.f64)
    there = ti.Vector([place[row, 0], place[row, 1]], dt=ti.f64)
    near, far, angle = here, there, heard[row, 2] + pose[2]
    if heard[row, 5] >= UNMEASURED:
        near, far, angle = there, here, heard[row, 1] + place[row, 2]
    away, apart, length = ti.Vector([cos_of(angle), sin_of(angle)], dt=ti.f64), far - near, heard[row, 0]
    rest = ti.max(length - dot(away, apart), NEAR_M)  # of both ways, which are `length` together
    reach = ti.min(ti.max(0.5 * (length * length - dot(apart, apart)) / rest, NEAR_M), length)
    form[row, POINT], form[row, POINT + 1] = near[0] + reach * away[0], near[1] + reach * away[1]
    form[row, POINT + 2], form[row, POINT + 3], form[row, POINT + 4] = SHIFTED_M**2, 0.0, SHIFTED_M**2
    form[row, ODDS] = 0.0


@ti.func
def turned(vector):
    """A quarter turn to the left."""
    return ti.Vector([-vector[1], vector[0]], dt=ti.f64)


@ti.func
def extent(form: ti.template(), row, at, way):
    """Variance of a form along some way."""
    return (
        way[0] * way[0] * form[row, at + 2]
        + 2 * way[0] * way[1] * form[row, at + 3]
        + way[1] * way[1] * form[row, at + 4]
    )


@ti.func
def corrected(
    form: ti.template(), row, at, value, slope, lateral, heard: ti.template(), known: ti.template()
):  # fmt: skip
    """Correct one form, one quantity after the other, whose errors are apart; the log of their density."""
    xx, xy, yy = form[row, at + 2], form[row, at + 3], form[row, at + 4]
    place, far = 0.5 * (known[0, 0] + known[1, 1]), ti.max(value[0], NEAR_M)
    shift, log = ti.Vector([0.0, 0.0], dt=ti.f64), ti.f64(0.0)
    for q in ti.static(range(3)):
        noise, gap = heard[row, 3 + q], heard[row, q] - value[q]
        if noise < UNMEASURED:
            if ti.static(q == 0):
                noise += place + 0.5 * lateral * lateral
            else:
                noise += place / (far * far)
                gap = wrapped(gap)
            if ti.static(q == 2):
                noise += known[2, 2]
            u, v = xx * slope[q, 0] + xy * slope[q, 1], xy * slope[q, 0] + yy * slope[q, 1]
            whole = slope[q, 0] * u + slope[q, 1] * v + noise
            missed = gap - slope[q, 0] * shift[0] - slope[q, 1] * shift[1]
            log -= 0.5 * missed * missed / whole + 0.5 * logarithm_of(whole)
            most = MOST_SURPRISED * ti.sqrt(whole)
            moved = ti.min(ti.max(missed, -most), most) / whole
            shift += moved * ti.Vector([u, v], dt=ti.f64)
            xx, xy, yy = xx - u * u / whole, xy - u * v / whole, yy - v * v / whole
    form[row, at] += shift[0]
    form[row, at + 1] += shift[1]
    form[row, at + 2], form[row, at + 3], form[row, at + 4] = FADING * xx, FADING * xy, FADING * yy
    return log
