"""What unexplained samples say for a feature at each of many places; docs/model.md, (M132)."""

import taichi as ti

from gridslam.kernels.messages.feature_likelihood import LEAST_M
from gridslam.kernels.primitives.launching import quick

POWERS = 7
"""Powers that are tried at every place."""
CHUNK = 64
"""Places that one task takes."""


@quick
@ti.kernel
def back_project(
    candidates: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [Q, 3] x, y, extra length (m)
    points: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [K, 4] x, y (m), heading (rad), noise power
    element: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 2] 2 pi / wavelength times place, own frame
    table: ti.types.ndarray(dtype=ti.f32, ndim=4),  # [K, T, N, 2] matched outputs of what is unexplained
    per_m: ti.f64,  # rows of the table per metre
    longest: ti.f64,  # no feature is heard from farther off, m
    power: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [POWERS]
    out: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [Q, 2] out: gain in log-likelihood, and with which power
):
    """Gain of one more feature over all steps, for the best of the powers; single precision but for sums."""
    ti.loop_config(block_dim=1)
    for chunk in range((candidates.shape[0] + CHUNK - 1) // CHUNK):
        each = ti.Vector([ti.f32(0.0)] * POWERS)
        for g in ti.static(range(POWERS)):
            each[g] = ti.cast(power[g], ti.f32)
        for q in range(chunk * CHUNK, ti.min((chunk + 1) * CHUNK, candidates.shape[0])):
            gain = ti.Vector([ti.f32(0.0)] * POWERS)
            volume = ti.Vector([ti.f64(1.0)] * POWERS)
            for k in range(points.shape[0]):
                x = ti.cast(candidates[q, 0] - points[k, 0], ti.f32)
                y = ti.cast(candidates[q, 1] - points[k, 1], ti.f32)
                plain = ti.max(ti.sqrt(x * x + y * y), ti.cast(LEAST_M, ti.f32))
                length = plain + ti.cast(candidates[q, 2], ti.f32)
                if length < ti.cast(longest, ti.f32):
                    heading = ti.cast(points[k, 2], ti.f32)
                    turn_x, turn_y = ti.cos(heading), ti.sin(heading)
                    along, across = (x * turn_x + y * turn_y) / plain, (y * turn_x - x * turn_y) / plain
                    place = length * ti.cast(per_m, ti.f32)
                    row = ti.min(ti.cast(place, ti.i32), table.shape[1] - 2)
                    part = place - row
                    re, im = ti.f32(0.0), ti.f32(0.0)
                    for m in range(element.shape[0]):
                        phase = along * ti.cast(element[m, 0], ti.f32) + across * ti.cast(
                            element[m, 1], ti.f32
                        )
                        c, s = ti.cos(phase), ti.sin(phase)
                        a = table[k, row, m, 0] + part * (table[k, row + 1, m, 0] - table[k, row, m, 0])
                        b = table[k, row, m, 1] + part * (table[k, row + 1, m, 1] - table[k, row, m, 1])
                        re += c * a + s * b
                        im += c * b - s * a
                    over = 1 / (length * length)
                    square = (re * re + im * im) * over
                    level = over * element.shape[0] / ti.cast(points[k, 3], ti.f32)
                    for g in ti.static(range(POWERS)):
                        share = 1 + each[g] * level
                        gain[g] += each[g] * square / share
                        volume[g] *= share
            out[q, 0] = -1e30
            for g in ti.static(range(POWERS)):
                total = gain[g] - ti.log(volume[g])
                if total > out[q, 0]:
                    out[q, 0], out[q, 1] = total, power[g]
