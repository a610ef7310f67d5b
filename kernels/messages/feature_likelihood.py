"""Log-likelihood of sampled signals under learned features, and its gradient; docs/model.md, (M123), (M124).

The line of sight is projected out of all features, so that neither its existence nor its power enters here.
"""

import taichi as ti

from gridslam.kernels.messages.feature_responses import (
    AHEAD,
    BY_ANGLE,
    BY_LENGTH,
    GAIN,
    INVERSE,
    LANES,
    PLAIN,
    PRODUCT,
    ROOT,
    SIDE,
    SIGHT,
    SLOPE,
    SOLVED,
    WHOLE,
    Y_ANGLE,
    Y_LENGTH,
    Outputs,
    Side,
    Y,
    multiply,
    none,
    pairs_of,
    place_features,
    project,
)
from gridslam.kernels.primitives.launching import quick


@ti.func
def factorise(lane, count, scratch: ti.template(), gram: ti.template()):
    """Cholesky root of G in place of K, and L^-1 t; returns A.

    Two rows by two columns at a time, so that what is loaded is used twice.
    """
    total, quiet = none(), 1 / scratch[lane, count, GAIN]
    for half in range((count + 1) // 2):
        n, q = 2 * half, ti.min(2 * half + 1, count - 1)  # the last row may be alone
        one, two = scratch[lane, n, GAIN] * quiet, scratch[lane, q, GAIN] * quiet
        re, im = one * scratch[lane, n, Y], one * scratch[lane, n, Y + 1]
        re_two, im_two = two * scratch[lane, q, Y], two * scratch[lane, q, Y + 1]
        for before in range(half):
            m = 2 * before
            left, right = scratch[lane, m, GAIN], scratch[lane, m + 1, GAIN]
            a, b = gram[lane, n, m] * one * left, gram[lane, n, m + 1] * one * right
            c, d = gram[lane, q, m] * two * left, gram[lane, q, m + 1] * two * right
            for j in range(m):
                upper, lower = gram[lane, n, j], gram[lane, q, j]
                first, second = gram[lane, m, j], gram[lane, m + 1, j]
                a -= upper * first
                b -= upper * second
                c -= lower * first
                d -= lower * second
            root, over, between = scratch[lane, m, ROOT], scratch[lane, m + 1, ROOT], gram[lane, m + 1, m]
            a *= root
            c *= root
            b = (b - a * between) * over
            d = (d - c * between) * over
            solved, then = scratch[lane, m, SOLVED], scratch[lane, m + 1, SOLVED]
            re -= a * solved + b * then
            re_two -= c * solved + d * then
            solved, then = scratch[lane, m, SOLVED + 1], scratch[lane, m + 1, SOLVED + 1]
            im -= a * solved + b * then
            im_two -= c * solved + d * then
            gram[lane, n, m], gram[lane, n, m + 1] = a, b
            gram[lane, q, m], gram[lane, q, m + 1] = c, d
        value = ti.max(gram[lane, n, n] * one * scratch[lane, n, GAIN], 0.0) + 1
        between = gram[lane, q, n] * two * scratch[lane, n, GAIN]
        other = ti.max(gram[lane, q, q] * two * scratch[lane, q, GAIN], 0.0) + 1
        for j in range(n):
            upper, lower = gram[lane, n, j], gram[lane, q, j]
            value -= upper * upper
            between -= upper * lower
            other -= lower * lower
        root = ti.sqrt(ti.max(value, 1e-12))
        over = 1 / root
        re, im = re * over, im * over
        total += re * re + im * im - 2 * ti.log(root)
        gram[lane, n, n], scratch[lane, n, ROOT] = root, over
        scratch[lane, n, SOLVED], scratch[lane, n, SOLVED + 1] = re, im
        if q > n:
            between *= over
            root = ti.sqrt(ti.max(other - between * between, 1e-12))
            over = 1 / root
            re_two, im_two = (re_two - between * re) * over, (im_two - between * im) * over
            total += re_two * re_two + im_two * im_two - 2 * ti.log(root)
            gram[lane, q, n], gram[lane, q, q], scratch[lane, q, ROOT] = between, root, over
            scratch[lane, q, SOLVED], scratch[lane, q, SOLVED + 1] = re_two, im_two
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
        pairs = pairs_of(element)
        blocks = (points.shape[0] + SIDE - 1) // SIDE
        each = (blocks + LANES - 1) // LANES
        for block in range(lane * each, ti.min((lane + 1) * each, blocks)):
            p, count = block * SIDE, features.shape[0]
            place_features(
                p, lane, pairs, points, features, anchor, element, table, step, reach, scratch, False
            )
            project(lane, count, pairs, pulse, reach[0], scratch)
            multiply(lane, count, pairs, pulse, reach[0], scratch, gram, False)
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
        pairs = pairs_of(element)
        blocks = (points.shape[0] + SIDE - 1) // SIDE
        each = (blocks + LANES - 1) // LANES
        for block in range(lane * each, ti.min((lane + 1) * each, blocks)):
            p, count = block * SIDE, features.shape[0]
            place_features(
                p, lane, pairs, points, features, anchor, element, table, step, reach, scratch, True
            )
            project(lane, count, pairs, pulse, reach[0], scratch)
            multiply(lane, count, pairs, pulse, reach[0], scratch, gram, True)
            value = factorise(lane, count, scratch, gram)
            invert(lane, count, first, scratch, gram)
            differentiate(lane, count, first, scratch, gram)
            for i in ti.static(range(SIDE)):
                if p + i < points.shape[0]:
                    out[p + i, count, 0] = value[i]
                    for n in range(first, count):
                        for e in ti.static(range(4)):
                            out[p + i, n, e] = scratch[lane, n, SLOPE + e][i]
