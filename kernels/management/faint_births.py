"""What earlier measurements, left unexplained, make of the lines of new surfaces; docs/model.md, (M251)."""

import taichi as ti

from gridslam.kernels import HEARD_BY_ANOTHER
from gridslam.kernels.management.births import known_std
from gridslam.kernels.primitives.blocks import Anchors, Belief, Borne, Left
from gridslam.kernels.primitives.corrections import inverse_of
from gridslam.kernels.primitives.functions import (
    cos_of,
    decay_of,
    logarithm_of,
    mirrored,
    sin_of,
    slant_of,
    wrapped,
)
from gridslam.kernels.primitives.gaussian import path_of
from gridslam.kernels.primitives.launching import copying
from gridslam.kernels.primitives.layout import ABOVE, HEADING, HEIGHT
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.radio import (
    AT_1M,
    FALSE_ALARMS,
    SAMPLES,
    amplitude_of,
    clutter_of,
    detection_of,
    lean_of,
    log_rician,
)
from gridslam.kernels.primitives.tables import (
    AMPLITUDE,
    AOA,
    AOD,
    DISTANCE,
    LEFT_AMPLITUDE,
    LEFT_ANCHOR,
    LEFT_STD,
    LEFT_VALUE,
)
from gridslam.kernels.propagation.coefficients import BINS

NEAR_M, NEAR_RAD = 0.6, 0.6
"""By how much distance and angles of an earlier measurement may miss what a new line predicts, roughly."""
MOST_LOG, LEAST_DOUBT = 25.0, 1e-9
"""Largest log ratio of one measurement; least probability of a miss."""
LEAST, MOST, MOST_BORNE = 1e-100, 1e100, 5.184705528587072e21
"""Between which products over steps stay; the largest that counts, e^50."""
LOG_TURN_CUBED = 5.513631199228036
SILENT, EITHER = 0, 1
"""In products: if nothing was the line's, and if anything may have been."""


@ti.func
def bounce_of(line, place, x, y, heading):
    """Value of a single bounce, and its derivatives by pose (3) and line (2)."""
    state = ti.Vector([x, y, 0.0, 0.0, heading, line[0], line[1]], dt=ti.f64)
    value, slope = path_of(state, HEADING + 1, place, 1, 0, 0)
    by = ti.Matrix.zero(ti.f64, 3, 5)
    for i in ti.static(range(3)):
        for n in ti.static(range(5)):
            by[i, n] = slope[i, n]
    return value, by


@ti.func
def place_of(places: ti.template(), anchor):
    """An anchor as `path_of` takes it, with its clock and height known."""
    x, y, facing, height = places[anchor, 0], places[anchor, 1], places[anchor, 2], places[anchor, HEIGHT]
    return ti.Vector([x, y, facing, 0.0, height, 0.0], dt=ti.f64)


@ti.func
def missed_by(measured, value):
    """By how much a measurement of distance, AoD and AoA misses what is predicted."""
    gap = measured - value
    return ti.Vector([gap[0], wrapped(gap[1]), wrapped(gap[2])], dt=ti.f64)


@ti.func
def is_near(gap):
    """Whether it is missed by little enough to be looked at."""
    return ti.abs(gap[0]) < NEAR_M and ti.abs(gap[1]) < NEAR_RAD and ti.abs(gap[2]) < NEAR_RAD


@ti.func
def left_of(left: ti.template(), h):
    """Distance, AoD and AoA of what was left over."""
    distance, departure, arrival = ti.static(LEFT_VALUE, LEFT_VALUE + AOD, LEFT_VALUE + AOA)
    return ti.Vector([left.rows[h, distance], left.rows[h, departure], left.rows[h, arrival]], dt=ti.f64)


@ti.func
def corrected(
    b, anchor, belief: ti.template(), anchors: ti.template(), scan: ti.template(), born: ti.template()
):
    """A line and its covariance by the measurement that bears it, at the pose that is believed."""
    m, place = born.measurement[b], place_of(anchors.places, anchor)
    line = ti.Vector([born.line[b, 0], born.line[b, 1]], dt=ti.f64)
    value, slope = bounce_of(line, place, belief.mean[0], belief.mean[1], belief.mean[HEADING])
    lean = lean_of(scan[m, DISTANCE], place[ABOVE])
    std = known_std(anchors.radio, anchor, scan, m, scan[m, AMPLITUDE], lean)
    entry = ti.Vector([0, 1, HEADING])
    spread, by_line = ti.Matrix.zero(ti.f64, 3, 3), ti.Matrix.zero(ti.f64, 3, 2)
    for i in ti.static(range(3)):
        spread[i, i] += std[i] ** 2
        by_line[i, 0], by_line[i, 1] = slope[i, 3], slope[i, 4]
        for j in ti.static(range(3)):
            for p in ti.static(range(3)):
                for q in ti.static(range(3)):
                    spread[i, j] += slope[i, p] * belief.covariance[entry[p], entry[q]] * slope[j, q]
    weighed = inverse_of(spread)[0] @ by_line
    information = by_line.transpose() @ weighed
    information[0, 0] += 1e-9
    information[1, 1] += 1e-9
    covariance = information.inverse()
    gap = missed_by(ti.Vector([scan[m, DISTANCE], scan[m, AOD], scan[m, AOA]], dt=ti.f64), value)
    return line + covariance @ (weighed.transpose() @ gap), covariance


@ti.func
def log_ratio(h, back, line, covariance, anchors: ti.template(), left: ti.template()):
    """Log density of a measurement at a line over clutter's, amplitudes left out; and whether it is near."""
    anchor = ti.cast(left.rows[h, LEFT_ANCHOR], ti.i32)
    place, log, near = place_of(anchors.places, anchor), ti.f64(0.0), False
    value, slope = bounce_of(line, place, left.pose[back, 0], left.pose[back, 1], left.pose[back, 2])
    gap = missed_by(left_of(left, h), value)
    if is_near(gap):
        near = True
        spread = ti.Matrix.zero(ti.f64, 3, 3)
        for i in ti.static(range(3)):
            spread[i, i] += left.rows[h, LEFT_STD + i] ** 2
            for j in ti.static(range(3)):
                for p in ti.static(range(3)):
                    for q in ti.static(range(3)):
                        spread[i, j] += slope[i, p] * left.spread[back, p, q] * slope[j, q]
                for p in ti.static(range(2)):
                    for q in ti.static(range(2)):
                        spread[i, j] += slope[i, 3 + p] * covariance[p, q] * slope[j, 3 + q]
        inverse, determinant = inverse_of(spread)
        log = -0.5 * (gap.dot(inverse @ gap) + logarithm_of(determinant) + LOG_TURN_CUBED)
        clutter = clutter_of(anchors.radio, anchor, left.rows[h, LEFT_AMPLITUDE])
        log -= logarithm_of(anchors.radio[anchor, FALSE_ALARMS] * clutter)
    return log, near


@ti.func
def upright(line):
    """A line's normal and offset."""
    return ti.Vector([cos_of(line[0]), sin_of(line[0]), line[1]], dt=ti.f64)


@ti.func
def length_of(wall, place, x, y):
    """Length of a single bounce, below 0 where agent and anchor stand on two sides of the line."""
    here = wall[0] * x + wall[1] * y - wall[2]
    there = wall[0] * place[0] + wall[1] * place[1] - wall[2]
    ix, iy = mirrored(place[0], place[1], wall[0], wall[1], wall[2])
    length = slant_of((ix - x) ** 2 + (iy - y) ** 2, place[ABOVE])
    return ti.select(here * there > 0, length, -length)


@ti.func
def any_near(line, anchors: ti.template(), left: ti.template()):
    """Whether anything that was left over lies roughly where a single bounce over a line is predicted."""
    found, wall = False, upright(line)
    for back in range(left.pose.shape[0]):
        for h in range(left.begin[back], ti.select(found, 0, left.begin[back + 1])):
            place = place_of(anchors.places, ti.cast(left.rows[h, LEFT_ANCHOR], ti.i32))
            length = ti.abs(length_of(wall, place, left.pose[back, 0], left.pose[back, 1]))
            if ti.abs(left.rows[h, LEFT_VALUE] - length) < NEAR_M:
                value, _ = bounce_of(line, place, left.pose[back, 0], left.pose[back, 1], left.pose[back, 2])
                found = found or is_near(missed_by(left_of(left, h), value))
    return found


@ti.func
def hear(
    j, back, line, covariance, step, anchors: ti.template(), left: ti.template(), chance: ti.template(),
    product: ti.template(), row,
):  # fmt: skip
    """Probability by coefficient that an anchor missed a line at a step; with the ratios of what it heard."""
    length = length_of(upright(line), place_of(anchors.places, j), left.pose[back, 0], left.pose[back, 1])
    unit = amplitude_of(anchors.radio[j, AT_1M], length) / BINS
    for n in range(BINS):
        missed = ti.max(1 - detection_of(unit * (n + 0.5), chance, step), LEAST_DOUBT)
        product[row, SILENT, n] = product[row, EITHER, n] = missed if length > 0 else 1.0
    for h in range(left.begin[back], left.begin[back + 1]):
        heard = left.rows[h, LEFT_ANCHOR] == j and length > 0
        if heard and ti.abs(left.rows[h, LEFT_VALUE] - length) < NEAR_M:
            log, near = log_ratio(h, back, line, covariance, anchors, left)
            for n in range(BINS if near else 0):
                amplitude, samples = left.rows[h, LEFT_AMPLITUDE], anchors.radio[j, SAMPLES]
                loud = log + log_rician(amplitude, unit * (n + 0.5), samples)
                either = product[row, EITHER, n] + decay_of(ti.min(loud, MOST_LOG))
                product[row, EITHER, n] = either


@copying("belief", "pose", "spread", "begin", "line", "measurement")
@ti.kernel
def bear_out(
    anchor: ti.i32,  # that the births are of
    step: ti.f64,  # amplitude from one entry of the table of p_d to the next
    chance: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [T] p_d from u = 0 on
    belief: pack(Belief),
    anchors: pack(Anchors),
    scan: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 10] see `AnchorScan.table`
    left: pack(Left),
    born: pack(Borne),
):
    """How much likelier what was left over is if a line has been there for some steps, by its coefficient."""
    ti.loop_config(serialize=True)
    for b in range(born.line.shape[0]):
        steps, count, often = left.pose.shape[0], anchors.places.shape[0], ti.f64(0.0)
        first = ti.Vector([born.line[b, 0], born.line[b, 1]], dt=ti.f64)
        own, doubt = corrected(b, anchor, belief, anchors, scan, born)
        world, now = count, count + 1  # rows: the product over anchors; what an anchor says at a step
        for n in range(BINS):
            born.gain[b, n] = 0.0
            for j in range(count):
                born.product[j, SILENT, n] = born.product[j, EITHER, n] = 1.0
        for back in range(steps if any_near(first, anchors, left) else 0):
            for n in range(BINS):
                born.product[world, SILENT, n] = born.product[world, EITHER, n] = 1.0
            for j in range(count):
                hear(j, back, own, doubt, step, anchors, left, chance, born.product, now)
                claimed = ti.f64(0.0)
                for n in range(BINS):
                    claimed = ti.max(claimed, 1 - born.product[now, SILENT, n] / born.product[now, EITHER, n])
                    for kind in ti.static((SILENT, EITHER)):
                        so_far = born.product[j, kind, n] * born.product[now, kind, n]
                        so_far = ti.min(ti.max(so_far, LEAST), MOST)
                        born.product[j, kind, n] = so_far
                        share = so_far if j == anchor else 1 - HEARD_BY_ANOTHER + HEARD_BY_ANOTHER * so_far
                        whole = born.product[world, kind, n] * share
                        born.product[world, kind, n] = ti.min(whole, MOST)
                often += claimed
            for n in range(BINS):
                either, silent = born.product[world, EITHER, n], born.product[world, SILENT, n]
                total = born.gain[b, n] + (ti.min(either, MOST_BORNE) - ti.min(silent, MOST_BORNE)) / steps
                born.gain[b, n] = total
        born.seen[b] = ti.cast(often + 0.5, ti.i64)
