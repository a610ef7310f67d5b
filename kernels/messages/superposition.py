"""Snapshots of arrays as sums of paths: their responses, and what N x N algebra says of them.

docs/model.md, (M74) to (M76), (M150). Complex numbers are pairs, the last axis of an array.
"""

import taichi as ti

from gridslam.kernels.primitives.functions import cos_of, logarithm_of, sin_of
from gridslam.kernels.primitives.launching import quick

KIND = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
"""Which of the three factors of a path's response is replaced by its derivative."""


@quick
@ti.kernel
def respond(
    wavenumber: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [M] evenly spaced, rad/m
    pulse: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 2]
    anchor: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [A, 2] places of elements, rad
    agent: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [B, 2]
    path: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 3] length, departure, arrival
    delay: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [2, N, M, 2] out: conjugate responses, derivatives
    leaving: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [2, N, A, 2] out
    arriving: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [2, N, B, 2] out
):
    """Conjugates of the three factors of every path's response, and of their derivatives."""
    ti.loop_config(serialize=True)
    for n in range(path.shape[0]):
        count = wavenumber.shape[0]
        gap = (wavenumber[count - 1] - wavenumber[0]) / ti.max(count - 1, 1) * path[n, 0]
        first = wavenumber[0] * path[n, 0]
        turn, now = ti.Vector([cos_of(gap), sin_of(gap)]), ti.Vector([cos_of(first), sin_of(first)])
        for m in range(count):
            here = times(ti.Vector([pulse[m, 0], -pulse[m, 1]]), now)
            delay[0, n, m, 0], delay[0, n, m, 1] = here[0], here[1]
            delay[1, n, m, 0] = -wavenumber[m] * here[1]
            delay[1, n, m, 1] = wavenumber[m] * here[0]
            now = times(now, turn)
        steer(anchor, path[n, 1], n, leaving)
        steer(agent, path[n, 2], n, arriving)


@ti.func
def steer(element: ti.template(), angle, n, out: ti.template()):
    """Conjugate response of elements to a direction, and its derivative."""
    for a in range(element.shape[0]):
        plain, across = steered(element, a, angle)
        out[0, n, a, 0], out[0, n, a, 1] = plain[0], plain[1]
        out[1, n, a, 0], out[1, n, a, 1] = across * plain[1], -across * plain[0]


@quick
@ti.kernel
def climb(
    wavenumber: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [M] evenly spaced, rad/m
    pulse: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 2]
    anchor: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [A, 2] places of elements, rad
    agent: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [B, 2]
    steepness: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [3] root mean square phase slopes; 0: not told
    samples: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [A, B, M, 2]
    steps: ti.i32,
    peak: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [3] in and out: length, departure, arrival
):
    """Climb to the top of |s^H z| by Newton steps, each parameter for itself."""
    ti.loop_config(serialize=True)
    for _ in range(steps):
        plain, slope = ti.Vector.zero(ti.f64, 2), ti.Matrix.zero(ti.f64, 3, 2)
        count = wavenumber.shape[0]
        gap = (wavenumber[count - 1] - wavenumber[0]) / ti.max(count - 1, 1) * peak[0]
        first = wavenumber[0] * peak[0]
        turn = ti.Vector([cos_of(gap), sin_of(gap)])
        for a in range(anchor.shape[0]):
            there, across_there = steered(anchor, a, peak[1])
            for b in range(agent.shape[0]):
                here, across_here = steered(agent, b, peak[2])
                both = times(there, here)
                now = ti.Vector([cos_of(first), sin_of(first)])
                whole, by_delay = ti.Vector.zero(ti.f64, 2), ti.Vector.zero(ti.f64, 2)
                for m in range(count):
                    one = times(now, ti.Vector([pulse[m, 0], -pulse[m, 1]]))
                    one = times(one, ti.Vector([samples[a, b, m, 0], samples[a, b, m, 1]]))
                    whole += one
                    by_delay += wavenumber[m] * one
                    now = times(now, turn)
                whole, by_delay = times(both, whole), times(both, by_delay)
                plain += whole
                for side in ti.static(range(2)):  # the derivative turns by a right angle
                    turned = (-1, 1)[side]
                    slope[0, side] += turned * by_delay[1 - side]
                    slope[1, side] -= turned * across_there * whole[1 - side]
                    slope[2, side] -= turned * across_here * whole[1 - side]
        square = ti.max(plain[0] * plain[0] + plain[1] * plain[1], 1e-300)
        for p in ti.static(range(3)):
            if steepness[p] > 0:
                ratio = (slope[p, 0] * plain[0] + slope[p, 1] * plain[1]) / square
                peak[p] += ratio / (steepness[p] * steepness[p])


@ti.func
def steered(element: ti.template(), a, angle):
    """Conjugate response of one element to a direction, and the derivative of its phase by it (M50)."""
    c, s = cos_of(angle), sin_of(angle)
    scale = 1 / ti.sqrt(ti.cast(element.shape[0], ti.f64))
    phase, across = c * element[a, 0] + s * element[a, 1], c * element[a, 1] - s * element[a, 0]
    return ti.Vector([scale * cos_of(phase), -scale * sin_of(phase)]), across


@quick
@ti.kernel
def superpose(
    delays: ti.types.ndarray(dtype=ti.f64, ndim=5),  # [2, N, 2, N, 2] products of delay factors, (M72)
    leaving: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [2, N, A, 2] as `respond` makes them
    arriving: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [2, N, B, 2]
    delayed: ti.types.ndarray(dtype=ti.f64, ndim=5),  # [2, N, A, B, 2] `delay` times the samples
    weight: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] mean power of each path
    scale: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [3] the noise's power in each sample; that of all
    # samples; their number
    believed: ti.types.ndarray(
        dtype=ti.f64, ndim=2
    ),  # [N, 2] or [0, 2]: amplitudes at which `information` is,
    # else at those found
    gram: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [4 N + 1, 4 N, 2] scratch: products with responses
    half: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [5 N + 1, N, 2] scratch: these solved; the root
    path: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 8] out: amplitude (2), matched (2), own, gradient (3)
    information: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [N, 3, N, 3] out; [0, 3, 0, 3]: not asked for
    sums: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [3] out: log density, power left, samples' worth of that
):
    """Density of the samples, its slope and the information about N paths, by N x N algebra."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        count, noise = weight.shape[0], scale[0]
        multiply_responses(delays, leaving, arriving, gram)
        match_samples(leaving, arriving, delayed, gram)
        log_det = take_root(weight, noise, gram, half)
        solve_all(weight, gram, half)
        samples, explained = scale[2], ti.f64(0.0)
        unexplained = samples
        for n in range(count):
            own = left_over(gram, half, noise, n, n)[0] / noise
            matched = left_over(gram, half, noise, 4 * count, n) / noise
            unexplained -= weight[n] * own
            explained += (half[4 * count, n, 0] ** 2 + half[4 * count, n, 1] ** 2) / noise
            for side in ti.static(range(2)):
                path[n, side] = weight[n] * matched[side]
                path[n, 2 + side] = matched[side]
            path[n, 4] = own
            for p in range(3):
                steep = left_over(gram, half, noise, 4 * count, (1 + p) * count + n) / noise
                across = left_over(gram, half, noise, n, (1 + p) * count + n)[0] / noise
                path[n, 5 + p] = 2 * weight[n] * (matched[0] * steep[0] + matched[1] * steep[1] - across)
        rest = scale[1]
        for n in range(count):
            rest -= 2 * (path[n, 0] * gram[4 * count, n, 0] + path[n, 1] * gram[4 * count, n, 1])
            for m in range(count):
                x = path[n, 0] * path[m, 0] + path[n, 1] * path[m, 1]
                y = path[n, 0] * path[m, 1] - path[n, 1] * path[m, 0]
                rest += x * gram[n, m, 0] - y * gram[n, m, 1]
        sums[0] = -log_det - samples * logarithm_of(noise) - (scale[1] - explained) / noise
        sums[1], sums[2] = rest, unexplained
        if information.shape[0] > 0:
            inform(believed, noise, gram, half, path, information)


@ti.func
def multiply_responses(
    delays: ti.template(), leaving: ti.template(), arriving: ti.template(), gram: ti.template()
):
    """Products of responses and their derivatives: row c N + n, column e N + m for kinds c, e."""
    count = delays.shape[1]
    for n in range(count):
        for m in range(n, count):
            by_leaving, by_arriving = products_of(leaving, n, m), products_of(arriving, n, m)
            for c, e in ti.static(ti.ndrange(4, 4)):
                own, other = ti.static(KIND[c][0]), ti.static(KIND[e][0])
                one = ti.Vector([delays[own, n, other, m, 0], delays[own, n, other, m, 1]])
                one = times(one, entry(by_leaving, KIND[c][1], KIND[e][1]))
                one = times(one, entry(by_arriving, KIND[c][2], KIND[e][2]))
                row, column = c * count + n, e * count + m
                gram[row, column, 0], gram[row, column, 1] = one[0], one[1]
                gram[column, row, 0], gram[column, row, 1] = one[0], -one[1]


@ti.func
def products_of(factor: ti.template(), n, m):
    """Four products of a factor's response and derivative: real parts, then imaginary parts."""
    found = ti.Vector.zero(ti.f64, 8)
    for t in range(factor.shape[2]):
        for c, e in ti.static(ti.ndrange(2, 2)):
            ax, ay, bx, by = factor[c, n, t, 0], factor[c, n, t, 1], factor[e, m, t, 0], factor[e, m, t, 1]
            found[2 * c + e] += ax * bx + ay * by
            found[4 + 2 * c + e] += ay * bx - ax * by
    return found


@ti.func
def entry(found, c: ti.template(), e: ti.template()):
    """One of the four."""
    return ti.Vector([found[2 * c + e], found[4 + 2 * c + e]])


@ti.func
def match_samples(
    leaving: ti.template(), arriving: ti.template(), delayed: ti.template(), gram: ti.template()
):
    """Products of responses and derivatives with the samples: the last row."""
    count = leaving.shape[1]
    last = 4 * count
    for n in range(count):
        plain, by_delay = ti.Vector.zero(ti.f64, 2), ti.Vector.zero(ti.f64, 2)
        by_leaving, by_arriving = ti.Vector.zero(ti.f64, 2), ti.Vector.zero(ti.f64, 2)
        for a in range(leaving.shape[2]):
            part, steep, turned = (
                ti.Vector.zero(ti.f64, 2),
                ti.Vector.zero(ti.f64, 2),
                ti.Vector.zero(ti.f64, 2),
            )
            for b in range(arriving.shape[2]):
                one = ti.Vector([delayed[0, n, a, b, 0], delayed[0, n, a, b, 1]])
                own = pair(arriving, 0, n, b)
                part += times(own, one)
                turned += times(pair(arriving, 1, n, b), one)
                steep += times(own, ti.Vector([delayed[1, n, a, b, 0], delayed[1, n, a, b, 1]]))
            own = pair(leaving, 0, n, a)
            plain += times(own, part)
            by_delay += times(own, steep)
            by_leaving += times(pair(leaving, 1, n, a), part)
            by_arriving += times(own, turned)
        for side in ti.static(range(2)):
            gram[last, n, side], gram[last, count + n, side] = plain[side], by_delay[side]
            gram[last, 2 * count + n, side] = by_leaving[side]
            gram[last, 3 * count + n, side] = by_arriving[side]


@ti.func
def pair(factor: ti.template(), c: ti.template(), n, t):
    """A complex number of a factor."""
    return ti.Vector([factor[c, n, t, 0], factor[c, n, t, 1]])


@ti.func
def times(one, other):
    """Product of two complex numbers."""
    return ti.Vector([one[0] * other[0] - one[1] * other[1], one[0] * other[1] + one[1] * other[0]])


@ti.func
def take_root(weight: ti.template(), noise, gram: ti.template(), half: ti.template()):
    """Cholesky root of I + R G R / noise, into the last N rows, and the log of its determinant."""
    count, log_det = weight.shape[0], ti.f64(0.0)
    first = 4 * count + 1
    for n in range(count):
        for k in range(n + 1):
            scale = ti.sqrt(weight[n] * weight[k]) / noise
            x, y = gram[n, k, 0] * scale, gram[n, k, 1] * scale
            for i in range(k):
                ax, ay, bx, by = (
                    half[first + n, i, 0],
                    half[first + n, i, 1],
                    half[first + k, i, 0],
                    half[first + k, i, 1],
                )
                x -= ax * bx + ay * by
                y -= ay * bx - ax * by
            if n == k:
                x = ti.sqrt(1 + x)
                log_det += 2 * logarithm_of(x)
                y = 0.0
            else:
                x /= half[first + k, k, 0]
                y /= half[first + k, k, 0]
            half[first + n, k, 0], half[first + n, k, 1] = x, y
    return log_det


@ti.func
def solve_all(weight: ti.template(), gram: ti.template(), half: ti.template()):
    """The root's solutions for products of the paths with all responses, and with the samples."""
    count = weight.shape[0]
    first, last = 4 * count + 1, 4 * count
    for n in range(count + 1):  # four kinds side by side; the last row is that of the samples
        for k in range(count):
            scale = ti.sqrt(weight[k])
            x, y = ti.Vector.zero(ti.f64, 4), ti.Vector.zero(ti.f64, 4)
            for c in ti.static(range(4)):
                if n < count:
                    x[c], y[c] = scale * gram[k, c * count + n, 0], scale * gram[k, c * count + n, 1]
                elif ti.static(c == 3):
                    x[c], y[c] = scale * gram[last, k, 0], scale * gram[last, k, 1]
            for i in range(k):
                ax, ay = half[first + k, i, 0], half[first + k, i, 1]
                for c in ti.static(range(4)):
                    bx, by = half[c * count + n, i, 0], half[c * count + n, i, 1]
                    x[c] -= ax * bx - ay * by
                    y[c] -= ax * by + ay * bx
            for c in ti.static(range(4)):
                if n < count or c == 3:
                    half[c * count + n, k, 0] = x[c] / half[first + k, k, 0]
                    half[c * count + n, k, 1] = y[c] / half[first + k, k, 0]


@ti.func
def left_over(gram: ti.template(), half: ti.template(), noise, row, column):
    """A product that the paths don't explain: of two responses, or (last row) of one with the samples."""
    x, y = gram[row, column, 0], gram[row, column, 1]
    one, other = row, column
    if row == gram.shape[1]:
        one, other = column, row
    u, v = ti.f64(0.0), ti.f64(0.0)
    for k in range(half.shape[1]):
        ax, ay, bx, by = half[one, k, 0], half[one, k, 1], half[other, k, 0], half[other, k, 1]
        u += ax * bx + ay * by
        v += ax * by - ay * bx
    return ti.Vector([x - u / noise, y - v / noise])


@ti.func
def inform(
    believed: ti.template(), noise, gram: ti.template(), half: ti.template(), path: ti.template(),
    information: ti.template(),
):  # fmt: skip
    """Information of the samples about the paths' parameters (M76)."""
    count = path.shape[0]
    for n in range(count):
        for m in range(n, count):
            ax, ay, bx, by = path[n, 0], path[n, 1], path[m, 0], path[m, 1]
            if believed.shape[0] > 0:
                ax, ay, bx, by = believed[n, 0], believed[n, 1], believed[m, 0], believed[m, 1]
            x, y = ax * bx + ay * by, ax * by - ay * bx
            u, v = ti.Matrix.zero(ti.f64, 3, 3), ti.Matrix.zero(ti.f64, 3, 3)
            for k in range(count):
                for p in ti.static(range(3)):
                    cx, cy = half[(1 + p) * count + n, k, 0], half[(1 + p) * count + n, k, 1]
                    for q in ti.static(range(3)):
                        dx, dy = half[(1 + q) * count + m, k, 0], half[(1 + q) * count + m, k, 1]
                        u[p, q] += cx * dx + cy * dy
                        v[p, q] += cx * dy - cy * dx
            for p, q in ti.static(ti.ndrange(3, 3)):
                row, column = (1 + p) * count + n, (1 + q) * count + m
                both = x * (gram[row, column, 0] - u[p, q] / noise) - y * (
                    gram[row, column, 1] - v[p, q] / noise
                )
                information[n, p, m, q] = 2 * both / noise
                information[m, q, n, p] = 2 * both / noise
