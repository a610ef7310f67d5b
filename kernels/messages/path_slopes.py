"""Slopes and curvature of the likelihood by lengths and angles of paths; docs/model.md, (M126)-(M128).

With L the root of noise and paths, all that is asked for are products of columns of L^-1 H^H [H', H, z].
"""

import taichi as ti

from gridslam.kernels.primitives.functions import PI, logarithm_of
from gridslam.kernels.primitives.launching import quick

NOISE, ENERGY, SIZE = 0, 1, 2
"""Columns of `facts`."""


@ti.func
def factorise(a, start, count, noise, gram: ti.template(), power: ti.template(), lower: ti.template()):
    """L, with 1 / L_nn on its diagonal; returns the log of its determinant's square."""
    log = ti.f64(0.0)
    for n in range(count):
        one = ti.sqrt(power[start + n])
        for m in range(n):
            value = one * ti.sqrt(power[start + m]) * gram[a, n, m]
            for j in range(m):
                value -= lower[n, j] * lower[m, j]
            lower[n, m] = value * lower[m, m]
        value = power[start + n] * gram[a, n, n] + noise
        for j in range(n):
            value -= lower[n, j] * lower[n, j]
        lower[n, n] = 1 / ti.sqrt(value)
        log += logarithm_of(value)
    return log


@ti.func
def fill(
    a, start, count, gram: ti.template(), matched: ti.template(), power: ti.template(), solved: ti.template()
):  # fmt: skip
    """Products of the paths' responses, times roots of their powers, with all columns."""
    for n in range(count):
        root = ti.sqrt(power[start + n])
        for i in range(2 * count):
            solved[i, n] = root * gram[a, n, count + i]
        for i in range(count):
            solved[2 * count + i, n] = root * gram[a, n, i]
        for part in range(2):
            solved[3 * count + part, n] = root * matched[a, n, part]


@ti.func
def solve(count, lower: ti.template(), solved: ti.template()):
    """L^-1 times all columns."""
    for i in range(3 * count + 2):
        for n in range(count):
            value = solved[i, n]
            for j in range(n):
                value -= lower[n, j] * solved[i, j]
            solved[i, n] = value * lower[n, n]


@ti.func
def product(i, k, count, solved: ti.template()):
    """Scalar product of two columns."""
    total = ti.f64(0.0)
    for j in range(count):
        total += solved[i, j] * solved[k, j]
    return total


@ti.func
def whitened(a, row, i, count, over, matched: ti.template(), solved: ti.template()):
    """Product of a response, or slope, with the samples, in units of what is expected of them; re, im."""
    re = matched[a, row, 0] - product(i, 3 * count, count, solved)
    im = matched[a, row, 1] - product(i, 3 * count + 1, count, solved)
    return over * re, over * im


@quick
@ti.kernel
def slope_paths(
    gram: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [A, 3 C, 3 C] responses, slopes by length, by angle
    matched: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [A, 3 C, 2] with the samples, re, im
    first: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [A + 1] of every anchor's numbers
    power: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [p / 2] of all anchors' paths
    facts: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [A, 3] noise power; energy of the samples, their number
    lower: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [C, C] scratch
    solved: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [3 C + 2, C] scratch: columns, one below the other
    amplitude: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [p / 2, 2] out: of all paths, re, im
    score: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [p] out
    curvature: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [p, p] out: each anchor's own block alone
    density: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [A] out: log of the samples'
):
    """Score, information and log-likelihood of every anchor's samples; serial: they are few."""
    ti.loop_config(serialize=True)
    for a in range(first.shape[0] - 1):
        start, count, noise = first[a], (first[a + 1] - first[a]) // 2, facts[a, NOISE]
        log, half = factorise(a, start // 2, count, noise, gram, power, lower), start // 2
        fill(a, half, count, gram, matched, power, solved)
        solve(count, lower, solved)
        fit, over = facts[a, ENERGY], 1 / noise
        for part in range(2):
            fit -= product(3 * count + part, 3 * count + part, count, solved)
        log += (facts[a, SIZE] - count) * logarithm_of(noise) + facts[a, SIZE] * logarithm_of(ti.f64(PI))
        density[a] = -fit * over - log
        for row in range(3 * count):
            i = ti.select(row < count, 2 * count + row, row - count)  # responses, then their slopes
            n = row % count
            re, im = whitened(a, row, i, count, over, matched, solved)
            if row < count:
                amplitude[half + n, 0], amplitude[half + n, 1] = power[half + n] * re, power[half + n] * im
            else:
                volume = over * (gram[a, row, n] - product(i, 2 * count + n, count, solved))
                echo = amplitude[half + n, 0] * re + amplitude[half + n, 1] * im
                score[start + i] = 2 * echo - 2 * power[half + n] * volume
        for i in range(2 * count):
            n = ti.select(i < count, i, i - count)
            re, im = 2 * over * amplitude[half + n, 0], 2 * over * amplitude[half + n, 1]
            for k in range(i + 1):
                m = ti.select(k < count, k, k - count)
                both = re * amplitude[half + m, 0] + im * amplitude[half + m, 1]
                value = both * (gram[a, count + i, count + k] - product(i, k, count, solved))
                curvature[start + i, start + k], curvature[start + k, start + i] = value, value
