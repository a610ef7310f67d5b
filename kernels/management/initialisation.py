"""Initialise a new surface in the belief: correlated with the state it follows from, corrected by an AoD."""

import taichi as ti

from gridslam.kernels import FAINTEST, USUAL_REFLECTION
from gridslam.kernels.management.births import known_std
from gridslam.kernels.management.new_lines import known_line, likeliest_arrival, line_at
from gridslam.kernels.primitives.blocks import Anchors, Belief, Newborn
from gridslam.kernels.primitives.functions import decay_of, level_of, wrapped
from gridslam.kernels.primitives.gaussian import OF_BOUNCE, bend_of_bounce, entry_of, path_of
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.layout import (
    ABOVE,
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
from gridslam.kernels.primitives.radio import AT_1M, SAMPLES, amplitude_of, lean_of, log_rician
from gridslam.kernels.primitives.tables import AMPLITUDE, AOA, AOD, DISTANCE, OWN_STD
from gridslam.kernels.propagation.coefficients import BINS

IGNORED = 1e6
"""Deviation from which on an AoD is ignored, as that of an array without extent."""
VAGUE = 1e-6
"""Share of a density that every coefficient has at least."""


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
def correlate_line(out: ti.template(), belief: ti.template(), slope, entry):
    """The belief, and how the new line, as a function of `entry` of it, is correlated with all of it."""
    size = belief.mean.shape[0]
    for i in range(size):
        out.fresh[i] = belief.mean[i]
        for j in range(size):
            out.joint[i, j] = belief.covariance[i, j]
        for r in ti.static(range(2)):
            cross = ti.f64(0.0)
            for e in ti.static((0, 1, 2, 5, 6)):
                cross += slope[r, e] * belief.covariance[entry[e], i]
            out.joint[size + r, i], out.joint[i, size + r] = cross, cross


@ti.func
def spread_line(joint: ti.template(), size, slope, entry, distance_std, angle_std):
    """Covariance of the new line: by its distance and angle, and by the entries that it follows from."""
    for r in ti.static(range(2)):
        for q in ti.static(range(2)):
            own = slope[r, 3] * slope[q, 3] * distance_std**2 + slope[r, 4] * slope[q, 4] * angle_std**2
            for e in ti.static((0, 1, 2, 5, 6)):
                own += joint[size + ti.max(r, q), entry[e]] * slope[ti.min(r, q), e]
            joint[size + r, size + q] = own


@ti.func
def share_unknown(joint: ti.template(), covariance: ti.template(), slope, unknown, share):
    """Correlate the new line with all else by what is unknown of its anchor, which shortens its path."""
    size = covariance.shape[0]
    for i in range(size):
        for r in ti.static(range(2)):
            cross = joint[size + r, i] - share * slope[r, 3] * covariance[unknown, i]
            joint[size + r, i], joint[i, size + r] = cross, cross


@ti.func
def spread_by_unknown(joint: ti.template(), size, slope, unknown, place, distance):
    """What is unknown of its anchor adds to the covariance of the new line."""
    for r in ti.static(range(2)):
        for q in ti.static(range(2)):
            so_far = joint[size + r, size + q]
            own = joint[size + ti.max(r, q), unknown] * slope[ti.min(r, q), 3]
            joint[size + r, size + q] = so_far - by_unknown(place, distance) * own


@ti.func
def append_line(
    out: ti.template(), belief: ti.template(), line, slope, entry, unknown, place, distance, distance_std,
    angle_std,
):  # fmt: skip
    """The belief with the new line, of such an angle and offset, as linearised in `entry` of the state."""
    size = belief.mean.shape[0]
    correlate_line(out, belief, slope, entry)
    if unknown >= 0:
        share_unknown(out.joint, belief.covariance, slope, unknown, by_unknown(place, distance))
    spread_line(out.joint, size, slope, entry, distance_std, angle_std)
    if unknown >= 0:
        spread_by_unknown(out.joint, size, slope, unknown, place, distance)
    out.fresh[size], out.fresh[size + 1] = line[0], line[1]


@ti.func
def move_line(mean: ti.template(), size, by):
    """Angle and offset of the new line, moved; the heading, which was corrected with it, wrapped."""
    angle, offset, heading = mean[size], mean[size + 1], mean[HEADING]
    mean[size], mean[size + 1] = angle + by[0], offset + by[1]
    mean[HEADING] = wrapped(heading)


@ti.func
def allow_for_bend(mean: ti.template(), covariance: ti.template(), head, place, measured, slope):
    """What derivatives leave out of a new line's own single bounce, docs/model.md, (M577).

    The line is moved until its path is as long as measured, which tells its length that much less exactly.
    """
    newest = lines_in(head, mean.shape[0]) - 1
    value, by_state = path_of(mean, head, place, 1, newest, newest)
    entry, block = entry_of(head, 1, newest, newest), ti.Matrix.zero(ti.f64, 4, 4)
    for i in ti.static(range(4)):
        for j in ti.static(range(4)):
            block[i, j] = covariance[entry[OF_BOUNCE[i]], entry[OF_BOUNCE[j]]]
    angle, offset = mean[entry[3]], mean[entry[4]]
    bent, bend = bend_of_bounce(by_state, value[0] - place[LATE], place, angle, offset, block)
    for r in ti.static(range(2)):
        before = mean[entry[3 + r]]
        mean[entry[3 + r]] = before + slope[r, 3] * (measured - value[0] - bent[0])
        for q in ti.static(range(2)):
            so_far = covariance[entry[3 + r], entry[3 + q]]
            covariance[entry[3 + r], entry[3 + q]] = so_far + slope[r, 3] * slope[q, 3] * bend[0, 0]


@ti.func
def believe_coefficient(coefficient: ti.template(), amplitude, full, samples):
    """Belief over the new line's coefficient by its path's amplitude alone, which is `full` where it is 1."""
    total = ti.f64(0.0)
    for n in range(BINS):
        density = ti.f64(1.0)
        if amplitude >= 0:
            density = decay_of(log_rician(amplitude, full * (n + 0.5) / BINS, samples)) + VAGUE
        coefficient[n] = density
        total += density
    for n in range(BINS):
        share = coefficient[n]
        coefficient[n] = share / total


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
        place = anchor_of(anchors.places, belief.mean, head, anchor)
        distance = scan[m, DISTANCE] - place[LATE]  # a length, whatever clocks made of it
        lossless = amplitude_of(anchors.radio[anchor, AT_1M], distance)
        lean, level = lean_of(distance, place[ABOVE]), level_of(distance, place[ABOVE])
        strength = ti.max(scan[m, AMPLITUDE] if scan[m, AMPLITUDE] >= 0 else 0.5 * lossless, FAINTEST)
        std = known_std(anchors.radio, anchor, scan, m, strength, lean)
        # where to linearise
        arrives, angle, angle_std = scan[m, OWN_STD + AOA] >= 0, scan[m, AOA], std[2]
        departs = arrives and scan[m, OWN_STD + AOD] >= 0 and std[1] < IGNORED
        if departs:
            wide = ti.sqrt(std[2] * std[2] + belief.covariance[HEADING, HEADING])
            line = known_line(belief.mean, known, surface)
            angle = likeliest_arrival(belief.mean, place, line, last, first, level, scan, m, std, wide)
        off = wrapped(scan[m, AOA] - angle)
        if not arrives:
            angle, angle_std, off = scan[m, AOD], std[1], 0.0
        # the line as a function of state and measurement
        normal, offset, slope = line_at(
            angle, arrives, belief.mean, place, known, last, first, level, lean
        )  # fmt: skip
        entry = ti.Vector([0, 1, HEADING, 0, 0, known, (known + 1 if surface >= 0 else 0)])
        unknown = unknown_entry(anchors.places, head, anchor)
        append_line(
            out, belief, (normal, offset), slope, entry, unknown, place, distance, std[0], angle_std
        )  # fmt: skip
        # corrected by the AoD, and moved from where it was linearised to the AoA that was measured
        back = ti.Vector([slope[0, 4] * off, slope[1, 4] * off], dt=ti.f64)
        bounces = 1 if surface < 0 else 2
        ends = (newest if last < 0 else last), (newest if first < 0 else first)
        if departs:
            correct_by_departure(
                out.fresh, out.joint, head, out.spread, scan[m, AOD], std[1], place, bounces, *ends, back
            )  # fmt: skip
        move_line(out.fresh, size, back)
        place = anchor_of(anchors.places, out.fresh, head, anchor)
        out.missed[0] = unexplained(
            out.fresh, head, place, bounces, *ends, scan, m, std, (2 if arrives else 1)
        )  # fmt: skip
        if surface < 0:
            allow_for_bend(out.fresh, out.joint, head, place, scan[m, DISTANCE], slope)
        full = lossless * (1.0 if surface < 0 else USUAL_REFLECTION)
        believe_coefficient(out.coefficient, scan[m, AMPLITUDE], full, anchors.radio[anchor, SAMPLES])
