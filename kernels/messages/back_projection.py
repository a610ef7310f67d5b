"""What unexplained samples say for a feature at each of many places; docs/model.md, (M132).

Steps are taken `STEPS` at a time, side by side in vectors.
"""

import taichi as ti

from gridslam.kernels.messages.feature_responses import LEAST_M
from gridslam.kernels.primitives.functions import turn_of, wrapped
from gridslam.kernels.primitives.launching import quick

POWERS = 7
"""Powers that are tried at every place."""
CHUNK, STEPS = 64, 8
"""Places that one task takes, and steps side by side."""
Output = ti.types.vector(2, ti.f32)


@ti.func
def entry(points: ti.template(), k, column):
    """An entry of the points from `k` on, in single precision; the last stands for those that are missing."""
    last = points.shape[0] - 1
    return ti.Vector([ti.cast(points[ti.min(k + i, last), column], ti.f32) for i in range(STEPS)])


@ti.func
def outputs(table: ti.template(), k, row, part, m):
    """An antenna's matched outputs at so many steps, linear between two rows."""
    re, im = ti.Vector([ti.f32(0.0)] * STEPS), ti.Vector([ti.f32(0.0)] * STEPS)
    for i in ti.static(range(STEPS)):
        t = ti.min(k + i, table.shape[0] - 1)
        one, two = table[t, row[i], m], table[t, row[i] + 1, m]
        both = one + part[i] * (two - one)
        re[i], im[i] = both[0], both[1]
    return re, im


@quick
@ti.kernel
def back_project(
    candidates: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [Q, 3] x, y, extra length (m)
    points: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [K, 4] x, y (m), heading (rad), noise power
    element: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 2] 2 pi / wavelength times place, own frame
    table: ti.types.ndarray(dtype=Output, ndim=3),  # [K, T, N] matched outputs of what is unexplained
    per_m: ti.f64,  # rows of the table per metre
    longest: ti.f64,  # no feature is heard from farther off, m
    power: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [POWERS]
    out: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [Q, 2] out: gain in log-likelihood, and with which power
):
    """Gain of one more feature over all steps, for the best of the powers; single precision but for sums."""
    ti.loop_config(block_dim=1)
    for chunk in range((candidates.shape[0] + CHUNK - 1) // CHUNK):
        for q in range(chunk * CHUNK, ti.min((chunk + 1) * CHUNK, candidates.shape[0])):
            at_x, at_y = ti.cast(candidates[q, 0], ti.f32), ti.cast(candidates[q, 1], ti.f32)
            gain, volume = ti.Vector([ti.f64(0.0)] * POWERS), ti.Vector([ti.f64(1.0)] * POWERS)
            for block in range((points.shape[0] + STEPS - 1) // STEPS):
                k = block * STEPS
                x, y = at_x - entry(points, k, 0), at_y - entry(points, k, 1)
                plain = ti.max(ti.sqrt(x * x + y * y), ti.cast(LEAST_M, ti.f32))
                length = plain + ti.cast(candidates[q, 2], ti.f32)
                turn_x, turn_y = turn_of(wrapped(entry(points, k, 2)))
                along, across = (x * turn_x + y * turn_y) / plain, (y * turn_x - x * turn_y) / plain
                place = ti.min(length, ti.cast(longest, ti.f32)) * ti.cast(per_m, ti.f32)
                row = ti.min(ti.cast(place, ti.i32), table.shape[1] - 2)
                re, im = ti.Vector([ti.f32(0.0)] * STEPS), ti.Vector([ti.f32(0.0)] * STEPS)
                for m in range(element.shape[0]):
                    ahead, beside = ti.cast(element[m, 0], ti.f32), ti.cast(element[m, 1], ti.f32)
                    c, s = turn_of(wrapped(along * ahead + across * beside))
                    a, b = outputs(table, k, row, place - row, m)
                    re += c * a + s * b
                    im += c * b - s * a
                over = 1 / (length * length)
                for i in ti.static(range(STEPS)):
                    if k + i >= points.shape[0] or length[i] >= ti.cast(longest, ti.f32):
                        over[i] = 0.0
                square, level = (re * re + im * im) * over, over * element.shape[0] / entry(points, k, 3)
                for g in ti.static(range(POWERS)):
                    share = 1 + ti.cast(power[g], ti.f32) * level
                    gain[g] += power[g] * (square / share).sum()
                    for i in ti.static(range(STEPS)):
                        volume[g] *= share[i]
            out[q, 0] = -1e30
            for g in ti.static(range(POWERS)):
                total = gain[g] - ti.log(volume[g])
                if total > out[q, 0]:
                    out[q, 0], out[q, 1] = total, power[g]
