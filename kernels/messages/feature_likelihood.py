"""Log-likelihood of sampled signals under learned features, and its gradient; docs/model.md, (M123), (M124).

A feature is a point with an extra length and a power. The line of sight is projected out of all features, so
that neither its existence nor its power enters here.
"""

import taichi as ti

from gridslam.kernels.primitives.blocks import Solver
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.packing import pack

LEAST_M = 0.1
"""Shorter ways are taken to be as long as this."""
LANES = 64
"""Stretches into which particles are cut, each with a scratch of its own."""


@ti.func
def look_up(table: ti.template(), one, two, place, column):
    """Entry of a table over distances, linear between two rows; `place` counts rows."""
    last = table.shape[2] - 2
    row = ti.min(ti.max(ti.cast(ti.floor(place), ti.i32), 0), last)
    part = place - row
    return (1 - part) * table[one, two, row, column] + part * table[one, two, row + 1, column]


@ti.func
def look_up_even(table: ti.template(), place, column):
    """The same of a table over lengths of either sign; column 0 is even, column 1 odd."""
    far = ti.abs(place)
    row = ti.min(ti.cast(ti.floor(far), ti.i32), table.shape[0] - 2)
    part = far - row
    value = (1 - part) * table[row, column] + part * table[row + 1, column]
    return value if column == 0 or place >= 0 else -value


@ti.func
def place_features(
    p, lane, points: ti.template(), features: ti.template(), anchor: ti.template(), element: ti.template(),
    table: ti.template(), t, per_m, longest, scratch: ti.template(),
):  # fmt: skip
    """Lengths, responses and matched outputs of the line of sight (row D) and of all features.

    A row of the scratch is [length, gain s, y re, y im, k, slope of y by length re, im, by angle re, im,
    slope of k by length, by angle, unit vector x, y, length without bias], then re, im and slope of the
    response of every element. Returns |h_lo^H z|^2 and |h_lo|^2.
    """
    count, elements = features.shape[0], element.shape[0]
    turn_x, turn_y = ti.cos(points[p, 2]), ti.sin(points[p, 2])
    for r in range(count + 1):
        n = count - r  # the line of sight first: all others need it
        x, y, extra, power = anchor[0], anchor[1], ti.f64(0.0), ti.f64(0.0)
        if n < count:
            x, y, extra, power = features[n, 0], features[n, 1], features[n, 2], features[n, 3]
        x -= points[p, 0]
        y -= points[p, 1]
        plain = ti.max(ti.sqrt(x * x + y * y), LEAST_M)
        x, y = x / plain, y / plain
        length = plain + extra
        along, across = x * turn_x + y * turn_y, y * turn_x - x * turn_y
        scratch[lane, n, 0] = length
        scratch[lane, n, 1] = ti.sqrt(power) if length < longest else 0.0
        scratch[lane, n, 11], scratch[lane, n, 12], scratch[lane, n, 13] = x, y, plain
        re, im, by_re, by_im = (
            ti.f64(0.0),
            ti.f64(0.0),
            ti.f64(0.0),
            ti.f64(0.0),
        )
        bend_re, bend_im = ti.f64(0.0), ti.f64(0.0)
        place = length * per_m
        for m in range(elements):
            phase = along * element[m, 0] + across * element[m, 1]
            slope = along * element[m, 1] - across * element[m, 0]
            c, s = ti.cos(phase), ti.sin(phase)
            scratch[lane, n, 14 + 3 * m] = c
            scratch[lane, n, 15 + 3 * m] = s
            scratch[lane, n, 16 + 3 * m] = slope
            a, b = look_up(table, t, m, place, 0), look_up(table, t, m, place, 1)
            da, db = look_up(table, t, m, place, 2), look_up(table, t, m, place, 3)
            u, v = c * a + s * b, c * b - s * a  # conj(response) Y
            re += u
            im += v
            by_re += c * da + s * db
            by_im += c * db - s * da
            bend_re += slope * v  # -j slope conj(response) Y
            bend_im -= slope * u
        scratch[lane, n, 2], scratch[lane, n, 3] = re / length, im / length
        scratch[lane, n, 5] = (by_re - re / length) / length
        scratch[lane, n, 6] = (by_im - im / length) / length
        scratch[lane, n, 7], scratch[lane, n, 8] = bend_re / length, bend_im / length
    sight, out_re, out_im = scratch[lane, count, 0], scratch[lane, count, 2], scratch[lane, count, 3]
    energy = elements / (sight * sight)
    return ti.Vector([sight, out_re, out_im, energy])


@ti.func
def array_product(lane, n, m, elements, scratch: ti.template()):
    """Re of the product of two array responses, and its slope by the first one's angle."""
    value, slope = ti.f64(0.0), ti.f64(0.0)
    for i in range(elements):
        c, s = scratch[lane, n, 14 + 3 * i], scratch[lane, n, 15 + 3 * i]
        a, b = scratch[lane, m, 14 + 3 * i], scratch[lane, m, 15 + 3 * i]
        value += c * a + s * b
        slope += scratch[lane, n, 16 + 3 * i] * (c * b - s * a)
    return ti.Vector([value, slope])


@ti.func
def project(lane, count, elements, los, pulse: ti.template(), per_m, scratch: ti.template()):
    """Take the line of sight out of all matched outputs."""
    for n in range(count):
        length = scratch[lane, n, 0]
        ra = array_product(lane, n, count, elements, scratch)
        rs = look_up_even(pulse, (length - los[0]) * per_m, 0)
        by = look_up_even(pulse, (length - los[0]) * per_m, 1)
        both = length * los[0]
        k, slope = rs * ra[0] / both, (by - rs / length) * ra[0] / both
        bend = rs * ra[1] / both
        scratch[lane, n, 4], scratch[lane, n, 9], scratch[lane, n, 10] = k, slope, bend
        for part in ti.static(range(2)):
            share = los[1 + part] / los[3]
            scratch[lane, n, 2 + part] -= k * share
            scratch[lane, n, 5 + part] -= slope * share
            scratch[lane, n, 7 + part] -= bend * share


@ti.func
def factorise(
    lane, count, elements, energy, noise, pulse: ti.template(), per_m, scratch: ti.template(),
    gram: ti.template(), solved: ti.template(),
):  # fmt: skip
    """Cholesky root of G into the lower triangle, L^-1 t into `solved`; returns A."""
    total = ti.f64(0.0)
    for n in range(count):
        s = scratch[lane, n, 1]
        re, im = s * scratch[lane, n, 2] / noise, s * scratch[lane, n, 3] / noise
        for m in range(n + 1):
            value = ti.f64(0.0)
            if s > 0 and scratch[lane, m, 1] > 0:
                ra = array_product(lane, n, m, elements, scratch)
                place = (scratch[lane, n, 0] - scratch[lane, m, 0]) * per_m
                value = look_up_even(pulse, place, 0) * ra[0] / (scratch[lane, n, 0] * scratch[lane, m, 0])
                value -= scratch[lane, n, 4] * scratch[lane, m, 4] / energy
                value *= s * scratch[lane, m, 1] / noise
            if m == n:
                value = ti.max(value, 0.0) + 1
            for i in range(m):
                value -= gram[lane, n, i] * gram[lane, m, i]
            if m < n:
                value /= gram[lane, m, m]
                re -= value * solved[lane, m, 0]
                im -= value * solved[lane, m, 1]
            else:
                value = ti.sqrt(ti.max(value, 1e-12))
                re, im = re / value, im / value
                total += re * re + im * im - 2 * ti.log(value)
            gram[lane, n, m] = value
        solved[lane, n, 0], solved[lane, n, 1] = re, im
    return total


@quick
@ti.kernel
def evaluate_features(
    points: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [P, 4] x, y (m), heading (rad), noise power
    features: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [D, 4] x, y, extra length (m), power
    anchor: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] m
    element: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 2] 2 pi / wavelength times place, own frame
    table: ti.types.ndarray(dtype=ti.f32, ndim=4),  # [1, N, T, 4] matched outputs re, im; slopes re, im
    pulse: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [T, 2] correlation of the pulse over length, slope
    per_m: ti.f64,  # rows of the tables per metre
    longest: ti.f64,  # no feature is heard from farther off, m
    solver: pack(Solver),
    out: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [P, 3] out: A, |h_lo^H z|^2, |h_lo|^2
):
    """A of (M123) and the line of sight's matched output, for every particle."""
    ti.loop_config(block_dim=1)
    for lane in range(LANES):
        each = (points.shape[0] + LANES - 1) // LANES
        for p in range(lane * each, ti.min((lane + 1) * each, points.shape[0])):
            count, elements = features.shape[0], element.shape[0]
            los = place_features(
                p, lane, points, features, anchor, element, table, 0, per_m, longest, solver.scratch
            )
            project(lane, count, elements, los, pulse, per_m, solver.scratch)
            out[p, 0] = factorise(
                lane,
                count,
                elements,
                los[3],
                points[p, 3],
                pulse,
                per_m,
                solver.scratch,
                solver.gram,
                solver.solved,
            )
            out[p, 1] = los[1] * los[1] + los[2] * los[2]
            out[p, 2] = los[3]


@quick
@ti.kernel
def differentiate_features(
    points: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [Q, 4] x, y (m), heading (rad), noise power
    step: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [Q] which table a point belongs to
    features: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [D, 4] x, y, extra length (m), power
    anchor: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] m
    element: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 2] 2 pi / wavelength times place, own frame
    table: ti.types.ndarray(dtype=ti.f32, ndim=4),  # [K, N, T, 4] matched outputs re, im; slopes re, im
    pulse: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [T, 2] correlation of the pulse over length, slope
    per_m: ti.f64,  # rows of the tables per metre
    longest: ti.f64,  # no feature is heard from farther off, m
    first: ti.i32,  # slopes are found from this feature on; rows before it stay as they are
    solver: pack(Solver),
    out: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [Q, D + 1, 4] out: slopes by the features; last row: A
):
    """Slopes of A by every feature's place, extra length and power, (M124), for every point."""
    ti.loop_config(block_dim=1)
    for lane in range(LANES):
        each = (points.shape[0] + LANES - 1) // LANES
        for p in range(lane * each, ti.min((lane + 1) * each, points.shape[0])):
            count, elements, noise = features.shape[0], element.shape[0], points[p, 3]
            los = place_features(
                p, lane, points, features, anchor, element, table, step[p], per_m, longest, solver.scratch
            )
            project(lane, count, elements, los, pulse, per_m, solver.scratch)
            out[p, count, 0] = factorise(
                lane, count, elements, los[3], noise, pulse, per_m, solver.scratch, solver.gram, solver.solved
            )
            # w = G^-1 t takes the place of L^-1 t
            for back in range(count):
                n = count - 1 - back
                for part in ti.static(range(2)):
                    value = solver.solved[lane, n, part]
                    for i in range(n + 1, count):
                        value -= solver.gram[lane, i, n] * solver.solved[lane, i, part]
                    solver.solved[lane, n, part] = value / solver.gram[lane, n, n]
            # the inverse root below the root, then G^-1 row by row as it is needed
            for n in range(count):
                for m in range(n + 1):
                    value = ti.cast(1.0 if m == n else 0.0, ti.f64)
                    for i in range(m, n):
                        value -= solver.gram[lane, n, i] * solver.gram[lane, count + i, m]
                    solver.gram[lane, count + n, m] = value / solver.gram[lane, n, n]
            for n in range(first, count):
                s, length = solver.scratch[lane, n, 1], solver.scratch[lane, n, 0]
                wr, wi = solver.solved[lane, n, 0], solver.solved[lane, n, 1]
                by_length = (
                    2 * s / noise * (wr * solver.scratch[lane, n, 5] + wi * solver.scratch[lane, n, 6])
                )
                by_angle = 2 * s / noise * (wr * solver.scratch[lane, n, 7] + wi * solver.scratch[lane, n, 8])
                by_gain = 2 / noise * (wr * solver.scratch[lane, n, 2] + wi * solver.scratch[lane, n, 3])
                for m in range(count):
                    inverse = ti.f64(0.0)
                    for i in range(ti.max(n, m), count):
                        inverse += solver.gram[lane, count + i, n] * solver.gram[lane, count + i, m]
                    weight = (
                        wr * solver.solved[lane, m, 0] + wi * solver.solved[lane, m, 1] + inverse
                    ) / noise
                    ra = array_product(lane, n, m, elements, solver.scratch)
                    place = (length - solver.scratch[lane, m, 0]) * per_m
                    rs, by = look_up_even(pulse, place, 0), look_up_even(pulse, place, 1)
                    both, k = length * solver.scratch[lane, m, 0], solver.scratch[lane, m, 4] / los[3]
                    gain = solver.scratch[lane, m, 1]
                    by_gain -= 2 * weight * gain * (rs * ra[0] / both - solver.scratch[lane, n, 4] * k)
                    weight *= 2 * s * gain
                    by_length -= weight * ((by - rs / length) * ra[0] / both - solver.scratch[lane, n, 9] * k)
                    by_angle -= weight * (rs * ra[1] / both - solver.scratch[lane, n, 10] * k)
                x, y = solver.scratch[lane, n, 11], solver.scratch[lane, n, 12]
                by_angle /= solver.scratch[lane, n, 13]
                out[p, n, 0] = by_length * x - by_angle * y
                out[p, n, 1] = by_length * y + by_angle * x
                out[p, n, 2] = by_length
                out[p, n, 3] = by_gain / (2 * s) if s > 0 else 0.0
