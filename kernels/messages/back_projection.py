"""What unexplained samples say for a feature at each of many places; docs/model.md, (M132).

Places are taken `PLACES` at a time, side by side in vectors: a lesson's first looks have few steps.
"""

import taichi as ti

from gridslam.kernels.messages.feature_responses import LEAST_M
from gridslam.kernels.primitives.functions import turn_of, wrapped
from gridslam.kernels.primitives.launching import quick

POWERS = 7
"""Powers that are tried at every place."""
PLACES, VECTORS = 8, 4
"""Places side by side, and so many times that of one task."""
Output = ti.types.vector(2, ti.f32)


@ti.func
def entry(candidates: ti.template(), q, column):
    """An entry of the candidates from `q` on, in single precision; the last stands for those missing."""
    last = candidates.shape[0] - 1
    return ti.Vector([ti.cast(candidates[ti.min(q + i, last), column], ti.f32) for i in range(PLACES)])


@ti.func
def outputs(table: ti.template(), k, row, part, m):
    """An antenna's matched outputs at a step for so many places, linear between two rows."""
    re, im = ti.Vector([ti.f32(0.0)] * PLACES), ti.Vector([ti.f32(0.0)] * PLACES)
    for i in ti.static(range(PLACES)):
        one, two = table[k, row[i], m], table[k, row[i] + 1, m]
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
    """Gain of one more feature over all steps, for the best of the powers; volumes in double precision."""
    ti.loop_config(block_dim=1)
    for task in range((candidates.shape[0] + PLACES * VECTORS - 1) // (PLACES * VECTORS)):
        for vector in range(task * VECTORS, (task + 1) * VECTORS):
            q = vector * PLACES
            if q < candidates.shape[0]:
                at_x, at_y, extra = entry(candidates, q, 0), entry(candidates, q, 1), entry(candidates, q, 2)
                reach, rows = ti.cast(longest, ti.f32), ti.cast(per_m, ti.f32)
                gain, volume = ti.Matrix.zero(ti.f32, POWERS, PLACES), ti.Matrix.one(ti.f64, POWERS, PLACES)
                for k in range(points.shape[0]):
                    x, y = at_x - ti.cast(points[k, 0], ti.f32), at_y - ti.cast(points[k, 1], ti.f32)
                    plain = ti.max(ti.sqrt(x * x + y * y), ti.cast(LEAST_M, ti.f32))
                    length = plain + extra
                    turn_x, turn_y = turn_of(wrapped(ti.cast(points[k, 2], ti.f32)))
                    x, y = x / plain, y / plain
                    along, across = x * turn_x + y * turn_y, y * turn_x - x * turn_y
                    place = ti.min(length, reach) * rows
                    row = ti.min(ti.cast(place, ti.i32), table.shape[1] - 2)
                    over = ti.select(length < reach, 1 / (length * length), ti.f32(0.0))
                    part = place - row
                    re, im = ti.Vector([ti.f32(0.0)] * PLACES), ti.Vector([ti.f32(0.0)] * PLACES)
                    for m in range(element.shape[0]):
                        ahead, beside = ti.cast(element[m, 0], ti.f32), ti.cast(element[m, 1], ti.f32)
                        c, s = turn_of(wrapped(along * ahead + across * beside))
                        a, b = outputs(table, k, row, part, m)
                        re += c * a + s * b
                        im += c * b - s * a
                    square = (re * re + im * im) * over
                    level = over * (element.shape[0] / ti.cast(points[k, 3], ti.f32))
                    for g in ti.static(range(POWERS)):
                        share = 1 + ti.cast(power[g], ti.f32) * level
                        more = square / share
                        for i in ti.static(range(PLACES)):
                            gain[g, i] += more[i]
                            volume[g, i] *= share[i]
                for i in ti.static(range(PLACES)):
                    if q + i < candidates.shape[0]:
                        out[q + i, 0] = -1e30
                        for g in ti.static(range(POWERS)):
                            total = power[g] * gain[g, i] - ti.log(volume[g, i])
                            if total > out[q + i, 0]:
                                out[q + i, 0], out[q + i, 1] = total, power[g]
