"""Responses and matched outputs of learned features at points, and their products; docs/model.md, (M123).

A feature is a point with an extra length and a power. The line of sight is projected out of all features, so
that neither its existence nor its power enters here. Points are taken `SIDE` at a time: every number that
scratch holds is a vector of as many, one for each of them.
"""

import taichi as ti

from gridslam.kernels.primitives.functions import turn_of, wrapped

MIRRORED = 1e-9
"""Phase by which antennas may miss their mirror images."""
LEAST_M = 0.1
"""Shorter ways are taken to be as long as this."""
LANES, SIDE = 16, 8
"""Stretches into which points are cut, each with a scratch of its own; points side by side."""
Side, Outputs = ti.types.vector(SIDE, ti.f64), ti.types.vector(4, ti.f32)
LENGTH, GAIN, Y, SIGHT, Y_LENGTH, Y_ANGLE, SIGHT_LENGTH, SIGHT_ANGLE = 0, 1, 2, 4, 5, 7, 9, 10
"""What scratch holds of each feature: length, folded as tables are, root of the power, matched output y
(re, im), product k with the line of sight, and slopes of both by length and angle. The line of sight (row D)
has the noise's power in place of a gain, and its energy in place of k."""
AHEAD, PLAIN, SOLVED, ROOT, SLOPE, OVER, ARRAY = 11, 13, 14, 16, 17, 21, 22
"""Then its direction (x, y), the length without extra, L^-1 t or w (re, im), 1 / L_nn, slopes of A by x, y,
extra length and power, 1 / length, and of every antenna the response over the length (re, im) and the slope
of its phase by angle. Where antennas mirror each other one stands for both, times the root of 2."""
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
def pairs_of(element: ti.template()):
    """How many antennas stand for all: half of them, if the last mirror the first, and so on; else all."""
    count, paired = element.shape[0], element.shape[0] % 2 == 0
    for m in range(count):
        for axis in ti.static(range(2)):
            if ti.abs(element[m, axis] + element[count - 1 - m, axis]) > MIRRORED:
                paired = False
    return count // 2 if paired else count


@ti.func
def place_features(
    p, lane, pairs, points: ti.template(), features: ti.template(), anchor: ti.template(),
    element: ti.template(), table: ti.template(), step: ti.template(), reach: ti.template(),
    scratch: ti.template(), sloped: ti.template(),
):  # fmt: skip
    """Lengths, responses and matched outputs of the line of sight (row D) and of all features.

    At `SIDE` points from `p` on, into row `lane` of scratch, by `pairs` antennas as of `pairs_of`; `sloped`:
    whether slopes of matched outputs are written. All else, with its shapes, is as of
    `feature_likelihood.evaluate_features`.
    """
    count, root = features.shape[0], ti.sqrt(ti.f64(element.shape[0]) / pairs)
    per_fold = reach[0] / (table.shape[2] - 1)
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
        over, folds = 1 / length, ti.floor(length * per_fold)
        folded = length - folds / per_fold
        place = folded * reach[0]
        row = ti.cast(ti.min(place, table.shape[2] - 2), ti.i32)
        re, im, by_re, by_im, bend_re, bend_im = none(), none(), none(), none(), none(), none()
        for m in range(pairs):
            c, s = turn_of(wrapped(along * element[m, 0] + across * element[m, 1]))
            slope = along * element[m, 1] - across * element[m, 0]
            for side in ti.static(range(2)):
                if side == 0 or pairs < element.shape[0]:
                    antenna, turned = m, s
                    if ti.static(side == 1):
                        antenna, turned = element.shape[0] - 1 - m, -s
                    a, b, by_a, by_b = matched_outputs(table, step, p, antenna, row, place - row)
                    u, v = c * a + turned * b, c * b - turned * a  # conj(response) Y
                    re += u
                    im += v
                    by_re += c * by_a + turned * by_b
                    by_im += c * by_b - turned * by_a
                    bend = slope if ti.static(side == 0) else -slope
                    bend_re += bend * v  # -j slope conj(response) Y
                    bend_im -= bend * u
            share = over * root
            scratch[lane, n, ARRAY + 3 * m], scratch[lane, n, ARRAY + 3 * m + 1] = c * share, s * share
            scratch[lane, n, ARRAY + 3 * m + 2] = slope
        scratch[lane, n, LENGTH], scratch[lane, n, OVER] = folded, over
        scratch[lane, n, GAIN] = ti.sqrt(power) * ti.select(length < reach[1], ti.f64(1.0), ti.f64(0.0))
        scratch[lane, n, AHEAD], scratch[lane, n, AHEAD + 1], scratch[lane, n, PLAIN] = x, y, plain
        scratch[lane, n, Y], scratch[lane, n, Y + 1] = re * over, im * over
        if ti.static(sloped):
            scratch[lane, n, Y_LENGTH] = (by_re - re * over) * over
            scratch[lane, n, Y_LENGTH + 1] = (by_im - im * over) * over
            scratch[lane, n, Y_ANGLE], scratch[lane, n, Y_ANGLE + 1] = bend_re * over, bend_im * over
    far = scratch[lane, count, PLAIN]
    scratch[lane, count, GAIN], scratch[lane, count, SIGHT] = (
        column(points, p, 3),
        element.shape[0] / (far * far),
    )


@ti.func
def correlated(pulse: ti.template(), place):
    """Correlation of the pulse over lengths of either sign, even, and its slope, odd."""
    even, odd, even_next, odd_next = none(), none(), none(), none()
    far = ti.abs(place)
    row = ti.cast(ti.min(far, pulse.shape[0] - 2), ti.i32)
    for i in ti.static(range(SIDE)):
        even[i], odd[i] = pulse[row[i], 0], pulse[row[i], 1]
        even_next[i], odd_next[i] = pulse[row[i] + 1, 0], pulse[row[i] + 1, 1]
    share = far - row
    slope = odd + share * (odd_next - odd)
    return even + share * (even_next - even), ti.select(place >= 0, slope, -slope)


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
    one, two = scratch[lane, n, OVER], scratch[lane, m, OVER]
    even, odd = correlated(pulse, (scratch[lane, n, LENGTH] - scratch[lane, m, LENGTH]) * per_m)
    value, bend = even * straight, odd * straight
    return value, bend - value * one, -bend - value * two, even * turn, even * other


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
