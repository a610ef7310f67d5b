"""Initialise a new surface in the belief: correlated with the state it follows from, corrected by an AoD."""

import taichi as ti

from gridslam.kernels import FAINTEST, USUAL_REFLECTION
from gridslam.kernels.management.births import known_std
from gridslam.kernels.primitives.blocks import Anchors, Belief, Newborn
from gridslam.kernels.primitives.functions import (
    bearing_of,
    cos_of,
    decay_of,
    dot,
    double_bounce,
    level_of,
    mirrored,
    sin_of,
    single_bounce,
    wrapped,
)
from gridslam.kernels.primitives.gaussian import entry_of, mirror_of, path_of
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.layout import (
    ABOVE,
    FACING,
    HEADING,
    LATE,
    OPEN_HEIGHT,
    anchor_of,
    line_entry,
    lines_in,
    steepness_of,
    unknown_entry,
)
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.radio import AT_1M, SAMPLES, lean_of, log_rician
from gridslam.kernels.primitives.tables import AMPLITUDE, AOA, AOD, DISTANCE, OWN_STD
from gridslam.kernels.propagation.coefficients import BINS

REACH, TRIALS = 4.0, 41
"""Deviations and number of directions of arrival that are tried for a new line, coarse and then fine."""
IMPOSSIBLE = 1e3
"""Misfit of a direction from which no path leads to the anchor."""
IGNORED = 1e6
"""Deviation from which on an AoD is ignored, as that of an array without extent."""
VAGUE = 1e-6
"""Share of a density that every coefficient has at least."""


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
def correct_by_departure(
    mean: ti.template(), covariance: ti.template(), head, spread: ti.template(), departure, std, place,
    bounces, last, first, back,
):  # fmt: skip
    """Correct the belief by an AoD, of a path linearised before the newest line was moved `back`."""
    size, newest = mean.shape[0], lines_in(head, mean.shape[0]) - 1
    value, slope = path_of(mean, head, place, bounces, last, first)
    entry = entry_of(head, bounces, last, first)
    at = 3 if last == newest else 5
    gap = wrapped(departure - value[1] - slope[1, at] * back[0] - slope[1, at + 1] * back[1])
    core = std * std
    for i in range(size):
        total = ti.f64(0.0)
        for e in ti.static(range(7)):
            total += covariance[i, entry[e]] * slope[1, e]
        spread[i] = total
    for e in ti.static(range(7)):
        core += slope[1, e] * spread[entry[e]]
    for i in range(size):
        before = mean[i]
        mean[i] = before + spread[i] * gap / core
        for j in range(size):
            so_far = covariance[i, j]
            covariance[i, j] = so_far - spread[i] * spread[j] / core


@ti.func
def unexplained(
    mean: ti.template(), head, place, bounces, last, first, scan: ti.template(), m, std: ti.template(), q
):  # fmt: skip
    """By how many deviations a line misses distance or angle q that it's made of: what linearising cost."""
    value, _slope = path_of(mean, head, place, bounces, last, first)
    by_distance = ti.abs(scan[m, DISTANCE] - value[0]) / std[0]
    return ti.max(by_distance, ti.abs(wrapped(scan[m, q] - value[q])) / std[q])


@ti.func
def by_unknown(place, length):
    """Slope of a distance by what is unknown of its anchor: 1 by a clock, its steepness by a rise."""
    slope = ti.f64(1.0)
    if place[OPEN_HEIGHT] > 0.5:
        slope = steepness_of(place, length)
    return slope


@ti.func
def share_unknown(joint: ti.template(), covariance: ti.template(), slope, unknown, share):
    """Correlate the new line with all else by what is unknown of its anchor, which shortens its path."""
    size = covariance.shape[0]
    for i in range(size):
        for r in ti.static(range(2)):
            cross = joint[size + r, i] - share * slope[r, 3] * covariance[unknown, i]
            joint[size + r, i], joint[i, size + r] = cross, cross


@quick
@ti.kernel
def initialise_surface(
    head: ti.i32,  # entry where the lines begin: see `layout`
    anchor: ti.i32,
    m: ti.i32,  # the measurement
    last: ti.i32,  # known surface hit last, first; -1: the new one
    first: ti.i32,
    belief: pack(Belief),
    anchors: pack(Anchors),
    scan: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 10] see `AnchorScan.table`
    out: pack(Newborn),
):
    """Append the line that explains a measurement, and correct it by the AoD.

    The line bends much within what an AoA of some ten degrees allows, so it is linearised at the direction of
    arrival that explains AoA and AoD best, not at the one that was measured. Without an AoA it is made of
    distance and AoD, at what was measured.
    """
    ti.loop_config(serialize=True)
    for _ in range(ti.min(scan.shape[0], 1)):
        size, surface = belief.mean.shape[0], ti.max(last, first)
        newest, known = lines_in(head, size), (line_entry(head, surface) if surface >= 0 else 0)
        bounces = 1 if surface < 0 else 2
        place = anchor_of(anchors.places, belief.mean, head, anchor)
        unknown = unknown_entry(anchors.places, head, anchor)
        wall = ti.Vector([0.0, 0.0, 0.0], dt=ti.f64)
        if surface >= 0:
            wall[0], wall[1], wall[2] = (
                cos_of(belief.mean[known]),
                sin_of(belief.mean[known]),
                belief.mean[known + 1],
            )
        distance = scan[m, DISTANCE] - place[LATE]  # a length, whatever clocks made of it
        amplitude = scan[m, AMPLITUDE]
        at_1m = anchors.radio[anchor, AT_1M] / ti.max(distance, 1e-3)
        strength = ti.max(amplitude if amplitude >= 0 else 0.5 * at_1m, FAINTEST)
        lean, level = lean_of(distance, place[ABOVE]), level_of(distance, place[ABOVE])
        std = known_std(anchors.radio, anchor, scan, m, strength, lean)
        # where to linearise
        arrives, angle, angle_std = scan[m, OWN_STD + AOA] >= 0, scan[m, AOA], std[2]
        departs = arrives and scan[m, OWN_STD + AOD] >= 0 and std[1] < IGNORED
        wide = ti.sqrt(std[2] * std[2] + belief.covariance[HEADING, HEADING])
        for stage in range(2 if departs else 0):
            reach = wide * (REACH if stage == 0 else 2 * REACH / TRIALS)
            middle, best, least = angle, angle, ti.f64(1e30)
            for k in range(TRIALS):
                trial = middle + reach * (2 * ti.cast(k, ti.f64) / (TRIALS - 1) - 1)
                misfit = misfit_of(trial, belief.mean, place, wall, last, first, level, scan, m, std, wide)
                if misfit < least:
                    best, least = trial, misfit
            angle = best
        off = wrapped(scan[m, AOA] - angle)
        if not arrives:
            angle, angle_std, off = scan[m, AOD], std[1], 0.0
        normal, offset, slope = line_at(
            angle, arrives, belief.mean, place, known, last, first, level, lean
        )  # fmt: skip
        back = ti.Vector([slope[0, 4] * off, slope[1, 4] * off], dt=ti.f64)
        # the line as a function of state and measurement
        entry = ti.Vector([0, 1, HEADING, 0, 0, known, (known + 1 if surface >= 0 else 0)])
        for i in range(size):
            out.fresh[i] = belief.mean[i]
            for j in range(size):
                out.joint[i, j] = belief.covariance[i, j]
            for r in ti.static(range(2)):
                cross = ti.f64(0.0)
                for e in ti.static((0, 1, 2, 5, 6)):
                    cross += slope[r, e] * belief.covariance[entry[e], i]
                out.joint[size + r, i], out.joint[i, size + r] = cross, cross
        if unknown >= 0:
            share_unknown(out.joint, belief.covariance, slope, unknown, by_unknown(place, distance))
        for r in ti.static(range(2)):
            for q in ti.static(range(2)):
                own = slope[r, 3] * slope[q, 3] * std[0] ** 2 + slope[r, 4] * slope[q, 4] * angle_std**2
                for e in ti.static((0, 1, 2, 5, 6)):
                    own += out.joint[size + ti.max(r, q), entry[e]] * slope[ti.min(r, q), e]
                out.joint[size + r, size + q] = own
        if unknown >= 0:
            for r in ti.static(range(2)):
                for q in ti.static(range(2)):
                    so_far = out.joint[size + r, size + q]
                    own = out.joint[size + ti.max(r, q), unknown] * slope[ti.min(r, q), 3]
                    out.joint[size + r, size + q] = so_far - by_unknown(place, distance) * own
        out.fresh[size], out.fresh[size + 1] = normal, offset
        ends = (newest if last < 0 else last), (newest if first < 0 else first)
        if departs:
            correct_by_departure(
                out.fresh,
                out.joint,
                head,
                out.spread,
                scan[m, AOD],
                std[1],
                place,
                bounces,
                ends[0],
                ends[1],
                back,
            )
        moved_angle, moved_offset = out.fresh[size], out.fresh[size + 1]
        out.fresh[size], out.fresh[size + 1] = moved_angle + back[0], moved_offset + back[1]
        heading = out.fresh[HEADING]
        out.fresh[HEADING] = wrapped(heading)
        out.missed[0] = unexplained(
            out.fresh, head, anchor_of(anchors.places, out.fresh, head, anchor), bounces, ends[0], ends[1],
            scan, m, std, (2 if arrives else 1),
        )  # fmt: skip
        # its coefficient, by the amplitude alone
        total, other = ti.f64(0.0), (1.0 if surface < 0 else USUAL_REFLECTION)
        for n in range(BINS):
            density = ti.f64(1.0)
            if amplitude >= 0:
                strong = at_1m * other * (n + 0.5) / BINS
                density = decay_of(log_rician(amplitude, strong, anchors.radio[anchor, SAMPLES])) + VAGUE
            out.coefficient[n] = density
            total += density
        for n in range(BINS):
            share = out.coefficient[n]
            out.coefficient[n] = share / total
