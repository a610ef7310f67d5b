"""Log-likelihood of sampled signals under learned features, and its gradient; docs/model.md, (M123), (M124).

A feature is a point with an extra length and a power. The line of sight is projected out of all features, so
that neither its existence nor its power enters here. Points are taken `SIDE` at a time: every number that
scratch holds is a vector of as many, one for each of them.
"""

import taichi as ti

from gridslam.kernels.primitives.functions import turn_of, wrapped
from gridslam.kernels.primitives.launching import quick

LEAST_M = 0.1
"""Shorter ways are taken to be as long as this."""
LANES, SIDE = 16, 8
"""Stretches into which points are cut, each with a scratch of its own; points side by side."""
Side, Outputs = ti.types.vector(SIDE, ti.f64), ti.types.vector(4, ti.f32)
LENGTH, GAIN, Y, SIGHT, Y_LENGTH, Y_ANGLE, SIGHT_LENGTH, SIGHT_ANGLE = 0, 1, 2, 4, 5, 7, 9, 10
"""What scratch holds of each feature: length, root of the power, matched output y (re, im), product k with
the line of sight, and slopes of both by length and angle. The line of sight (row D) has the noise's power in
place of a gain, and its energy in place of k."""
AHEAD, PLAIN, SOLVED, ROOT, SLOPE, ARRAY = 11, 13, 14, 16, 17, 21
"""Then its direction (x, y), the length without extra, L^-1 t or w (re, im), 1 / L_nn, slopes of A by x, y,
extra length and power, and of every antenna the response (re, im) and its slope by angle."""
INVERSE, WHOLE, PRODUCT, BY_LENGTH, BY_ANGLE, BLOCKS = 1, 2, 3, 4, 5, 6
"""Blocks of D rows in gram, after the root L of G: L^-1, G^-1, K, its slopes by length and angle of rows."""


@ti.func
def none():
    """A zero for each of the points side by side."""
    return ti.Vector([ti.f64(0.0)] * SIDE)


@ti.func
def column(points: ti.template(), p, entry):
    """An entry of the points from `p` on; the last stands for those that are missing."""
    last = points.shape[0] - 1
    return ti.Vector([points[ti.min(p + i, last), entry] for i in range(SIDE)])


@ti.func
def matched_outputs(table: ti.template(), step: ti.template(), p, m, row, share):
    """An antenna's matched outputs re, im and their slopes, linear between two rows."""
    re, im, by_re, by_im = none(), none(), none(), none()
    for i in ti.static(range(SIDE)):
        t = step[ti.min(p + i, step.shape[0] - 1)]
        one, two = table[t, m, row[i]], table[t, m, row[i] + 1]
        both = one + ti.cast(share[i], ti.f32) * (two - one)
        re[i], im[i], by_re[i], by_im[i] = both[0], both[1], both[2], both[3]
    return re, im, by_re, by_im


@ti.func
def place_features(
    p, lane, points: ti.template(), features: ti.template(), anchor: ti.template(), element: ti.template(),
    table: ti.template(), step: ti.template(), reach: ti.template(), scratch: ti.template(),
    sloped: ti.template(),
):  # fmt: skip
    """Lengths, responses and matched outputs of the line of sight (row D) and of all features."""
    count = features.shape[0]
    heading = column(points, p, 2)
    turn_x, turn_y = ti.cos(heading), ti.sin(heading)
    for n in range(count + 1):
        px, py, extra, power = anchor[0], anchor[1], ti.f64(0.0), ti.f64(0.0)
        if n < count:
            px, py, extra, power = features[n, 0], features[n, 1], features[n, 2], features[n, 3]
        x, y = px - column(points, p, 0), py - column(points, p, 1)
        plain = ti.max(ti.sqrt(x * x + y * y), LEAST_M)
        x, y, length = x / plain, y / plain, plain + extra
        along, across = x * turn_x + y * turn_y, y * turn_x - x * turn_y
        place = length * reach[0]
        row = ti.cast(ti.min(ti.max(place, 0.0), table.shape[2] - 2), ti.i32)
        re, im, by_re, by_im, bend_re, bend_im = none(), none(), none(), none(), none(), none()
        for m in range(element.shape[0]):
            c, s = turn_of(wrapped(along * element[m, 0] + across * element[m, 1]))
            slope = along * element[m, 1] - across * element[m, 0]
            a, b, by_a, by_b = matched_outputs(table, step, p, m, row, place - row)
            u, v = c * a + s * b, c * b - s * a  # conj(response) Y
            re += u
            im += v
            by_re += c * by_a + s * by_b
            by_im += c * by_b - s * by_a
            bend_re += slope * v  # -j slope conj(response) Y
            bend_im -= slope * u
            scratch[lane, n, ARRAY + 3 * m], scratch[lane, n, ARRAY + 3 * m + 1] = c, s
            scratch[lane, n, ARRAY + 3 * m + 2] = slope
        over = 1 / length
        scratch[lane, n, LENGTH] = length
        scratch[lane, n, GAIN] = ti.sqrt(power) * ti.select(length < reach[1], ti.f64(1.0), ti.f64(0.0))
        scratch[lane, n, AHEAD], scratch[lane, n, AHEAD + 1], scratch[lane, n, PLAIN] = x, y, plain
        scratch[lane, n, Y], scratch[lane, n, Y + 1] = re * over, im * over
        if ti.static(sloped):
            scratch[lane, n, Y_LENGTH] = (by_re - re * over) * over
            scratch[lane, n, Y_LENGTH + 1] = (by_im - im * over) * over
            scratch[lane, n, Y_ANGLE], scratch[lane, n, Y_ANGLE + 1] = bend_re * over, bend_im * over
    far = scratch[lane, count, LENGTH]
    scratch[lane, count, GAIN], scratch[lane, count, SIGHT] = (
        column(points, p, 3),
        element.shape[0] / (far * far),
    )


@ti.func
def correlated(pulse: ti.template(), place):
    """Correlation of the pulse over lengths of either sign, even, and its slope, odd."""
    even, odd = none(), none()
    for i in ti.static(range(SIDE)):
        far = ti.abs(place[i])
        row = ti.min(ti.cast(far, ti.i32), pulse.shape[0] - 2)
        share = far - row
        even[i] = (1 - share) * pulse[row, 0] + share * pulse[row + 1, 0]
        slope = (1 - share) * pulse[row, 1] + share * pulse[row + 1, 1]
        odd[i] = slope if place[i] >= 0 else -slope
    return even, odd


@ti.func
def products(lane, n, m, elements, pulse: ti.template(), per_m, scratch: ti.template()):
    """Product of two responses, and its slopes by length and angle of either."""
    straight, turn, other = none(), none(), none()
    for e in range(elements):
        at = ARRAY + 3 * e
        c, s, a, b = (
            scratch[lane, n, at],
            scratch[lane, n, at + 1],
            scratch[lane, m, at],
            scratch[lane, m, at + 1],
        )
        straight += c * a + s * b
        turn += scratch[lane, n, at + 2] * (c * b - s * a)
        other -= scratch[lane, m, at + 2] * (c * b - s * a)
    one, two = 1 / scratch[lane, n, LENGTH], 1 / scratch[lane, m, LENGTH]
    even, odd = correlated(pulse, (scratch[lane, n, LENGTH] - scratch[lane, m, LENGTH]) * per_m)
    value, both = even * straight * one * two, one * two
    by_one, by_two = odd * straight * both - value * one, -odd * straight * both - value * two
    return value, by_one, by_two, even * turn * both, even * other * both


@ti.func
def project(lane, count, elements, pulse: ti.template(), per_m, scratch: ti.template()):
    """Take the line of sight out of all matched outputs."""
    for n in range(count):
        value, by_length, _, by_angle, _ = products(lane, n, count, elements, pulse, per_m, scratch)
        scratch[lane, n, SIGHT], scratch[lane, n, SIGHT_LENGTH] = value, by_length
        scratch[lane, n, SIGHT_ANGLE] = by_angle
        for part in ti.static(range(2)):
            share = scratch[lane, count, Y + part] / scratch[lane, count, SIGHT]
            scratch[lane, n, Y + part] -= value * share
            scratch[lane, n, Y_LENGTH + part] -= by_length * share
            scratch[lane, n, Y_ANGLE + part] -= by_angle * share


@ti.func
def multiply(
    lane, count, elements, pulse: ti.template(), per_m, scratch: ti.template(), gram: ti.template(),
    sloped: ti.template(),
):  # fmt: skip
    """K without the line of sight where L will be; with its slopes in blocks of their own."""
    over = 1 / scratch[lane, count, SIGHT]
    for n in range(count):
        for m in range(n + 1):
            value, by_one, by_two, turn, other = products(lane, n, m, elements, pulse, per_m, scratch)
            k, own = scratch[lane, n, SIGHT] * over, scratch[lane, m, SIGHT] * over
            value -= k * scratch[lane, m, SIGHT]
            gram[lane, n, m] = value
            if ti.static(sloped):
                gram[lane, PRODUCT * count + n, m] = value
                gram[lane, PRODUCT * count + m, n] = value
                gram[lane, BY_LENGTH * count + m, n] = by_two - scratch[lane, m, SIGHT_LENGTH] * k
                gram[lane, BY_LENGTH * count + n, m] = by_one - scratch[lane, n, SIGHT_LENGTH] * own
                gram[lane, BY_ANGLE * count + m, n] = other - scratch[lane, m, SIGHT_ANGLE] * k
                gram[lane, BY_ANGLE * count + n, m] = turn - scratch[lane, n, SIGHT_ANGLE] * own


@ti.func
def factorise(lane, count, scratch: ti.template(), gram: ti.template()):
    """Cholesky root of G in place of K, and L^-1 t; returns A."""
    total, quiet = none(), 1 / scratch[lane, count, GAIN]
    for n in range(count):
        gain = scratch[lane, n, GAIN] * quiet
        re, im = gain * scratch[lane, n, Y], gain * scratch[lane, n, Y + 1]
        for m in range(n):
            value = gram[lane, n, m] * gain * scratch[lane, m, GAIN]
            for j in range(m):
                value -= gram[lane, n, j] * gram[lane, m, j]
            value *= scratch[lane, m, ROOT]
            re -= value * scratch[lane, m, SOLVED]
            im -= value * scratch[lane, m, SOLVED + 1]
            gram[lane, n, m] = value
        value = ti.max(gram[lane, n, n] * gain * scratch[lane, n, GAIN], 0.0) + 1
        for j in range(n):
            value -= gram[lane, n, j] * gram[lane, n, j]
        root = ti.sqrt(ti.max(value, 1e-12))
        re, im = re / root, im / root
        total += re * re + im * im - 2 * ti.log(root)
        gram[lane, n, n], scratch[lane, n, ROOT] = root, 1 / root
        scratch[lane, n, SOLVED], scratch[lane, n, SOLVED + 1] = re, im
    return total


@ti.func
def invert(lane, count, first, scratch: ti.template(), gram: ti.template()):
    """w = G^-1 t in place of L^-1 t, and G^-1 for the features from `first` on."""
    for back in range(count):
        n = count - 1 - back
        re, im = scratch[lane, n, SOLVED], scratch[lane, n, SOLVED + 1]
        for j in range(n + 1, count):
            re -= gram[lane, j, n] * scratch[lane, j, SOLVED]
            im -= gram[lane, j, n] * scratch[lane, j, SOLVED + 1]
        scratch[lane, n, SOLVED] = re * scratch[lane, n, ROOT]
        scratch[lane, n, SOLVED + 1] = im * scratch[lane, n, ROOT]
    for n in range(count):
        row = INVERSE * count + n
        gram[lane, row, n] = scratch[lane, n, ROOT]
        for m in range(n):
            value = none()
            for j in range(m, n):
                value -= gram[lane, n, j] * gram[lane, INVERSE * count + j, m]
            gram[lane, row, m] = value * scratch[lane, n, ROOT]
    for n in range(first, count):
        for m in range(n + 1):
            value = none()
            for j in range(INVERSE * count + n, (INVERSE + 1) * count):
                value += gram[lane, j, n] * gram[lane, j, m]
            gram[lane, WHOLE * count + n, m] = value
            gram[lane, WHOLE * count + m, n] = value


@ti.func
def differentiate(lane, count, first, scratch: ti.template(), gram: ti.template()):
    """Slopes of A by places, extra lengths and powers of the features from `first` on, into scratch."""
    for n in range(first, count):
        wr, wi = scratch[lane, n, SOLVED], scratch[lane, n, SOLVED + 1]
        by_gain = wr * scratch[lane, n, Y] + wi * scratch[lane, n, Y + 1]
        by_length = wr * scratch[lane, n, Y_LENGTH] + wi * scratch[lane, n, Y_LENGTH + 1]
        by_angle = wr * scratch[lane, n, Y_ANGLE] + wi * scratch[lane, n, Y_ANGLE + 1]
        for m in range(count):
            weight = wr * scratch[lane, m, SOLVED] + wi * scratch[lane, m, SOLVED + 1]
            weight = (weight + gram[lane, WHOLE * count + n, m]) * scratch[lane, m, GAIN]
            by_gain -= weight * gram[lane, PRODUCT * count + n, m]
            by_length -= weight * gram[lane, BY_LENGTH * count + n, m]
            by_angle -= weight * gram[lane, BY_ANGLE * count + n, m]
        s, over = scratch[lane, n, GAIN], 2 / scratch[lane, count, GAIN]
        x, y = scratch[lane, n, AHEAD], scratch[lane, n, AHEAD + 1]
        along, across = over * s * by_length, over * s * by_angle / scratch[lane, n, PLAIN]
        scratch[lane, n, SLOPE], scratch[lane, n, SLOPE + 1] = along * x - across * y, along * y + across * x
        scratch[lane, n, SLOPE + 2] = along
        scratch[lane, n, SLOPE + 3] = ti.select(s > 0, over * by_gain / (2 * ti.max(s, 1e-300)), none())


@quick
@ti.kernel
def evaluate_features(
    points: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [P, 4] x, y (m), heading (rad), noise power
    step: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [P] which table a point belongs to
    features: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [D, 4] x, y, extra length (m), power
    anchor: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] m
    element: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 2] 2 pi / wavelength times place, own frame
    table: ti.types.ndarray(dtype=Outputs, ndim=3),  # [K, N, T] matched outputs re, im; slopes re, im
    pulse: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [T, 2] correlation of the pulse over length, slope
    reach: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] rows of tables per metre; longest path heard, m
    scratch: ti.types.ndarray(dtype=Side, ndim=3),  # [LANES, D + 1, ARRAY + 3 N]
    gram: ti.types.ndarray(dtype=Side, ndim=3),  # [LANES, D, D]
    out: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [P, 3] out: A, |h_lo^H z|^2, |h_lo|^2
):
    """A of (M123) and the line of sight's matched output, for every particle."""
    ti.loop_config(block_dim=1)
    for lane in range(LANES):
        blocks = (points.shape[0] + SIDE - 1) // SIDE
        each = (blocks + LANES - 1) // LANES
        for block in range(lane * each, ti.min((lane + 1) * each, blocks)):
            p, count, elements = block * SIDE, features.shape[0], element.shape[0]
            place_features(p, lane, points, features, anchor, element, table, step, reach, scratch, False)
            project(lane, count, elements, pulse, reach[0], scratch)
            multiply(lane, count, elements, pulse, reach[0], scratch, gram, False)
            value = factorise(lane, count, scratch, gram)
            re, im = scratch[lane, count, Y], scratch[lane, count, Y + 1]
            square, energy = re * re + im * im, scratch[lane, count, SIGHT]
            for i in ti.static(range(SIDE)):
                if p + i < points.shape[0]:
                    out[p + i, 0], out[p + i, 1], out[p + i, 2] = value[i], square[i], energy[i]


@quick
@ti.kernel
def differentiate_features(
    points: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [P, 4] x, y (m), heading (rad), noise power
    step: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [P] which table a point belongs to
    features: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [D, 4] x, y, extra length (m), power
    anchor: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] m
    element: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 2] 2 pi / wavelength times place, own frame
    table: ti.types.ndarray(dtype=Outputs, ndim=3),  # [K, N, T] matched outputs re, im; slopes re, im
    pulse: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [T, 2] correlation of the pulse over length, slope
    reach: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] rows of tables per metre; longest path heard, m
    first: ti.i32,  # slopes are found from this feature on; rows before it stay as they are
    scratch: ti.types.ndarray(dtype=Side, ndim=3),  # [LANES, D + 1, ARRAY + 3 N]
    gram: ti.types.ndarray(dtype=Side, ndim=3),  # [LANES, BLOCKS D, D]
    out: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [P, D + 1, 4] out: slopes by the features; last row: A
):
    """Slopes of A by every feature's place, extra length and power, (M124), for every point."""
    ti.loop_config(block_dim=1)
    for lane in range(LANES):
        blocks = (points.shape[0] + SIDE - 1) // SIDE
        each = (blocks + LANES - 1) // LANES
        for block in range(lane * each, ti.min((lane + 1) * each, blocks)):
            p, count, elements = block * SIDE, features.shape[0], element.shape[0]
            place_features(p, lane, points, features, anchor, element, table, step, reach, scratch, True)
            project(lane, count, elements, pulse, reach[0], scratch)
            multiply(lane, count, elements, pulse, reach[0], scratch, gram, True)
            value = factorise(lane, count, scratch, gram)
            invert(lane, count, first, scratch, gram)
            differentiate(lane, count, first, scratch, gram)
            for i in ti.static(range(SIDE)):
                if p + i < points.shape[0]:
                    out[p + i, count, 0] = value[i]
                    for n in range(first, count):
                        for e in ti.static(range(4)):
                            out[p + i, n, e] = scratch[lane, n, SLOPE + e][i]
