"""What unexplained samples say for a feature at each of many places; docs/model.md, (M132)."""

import taichi as ti

from gridslam.kernels.messages.feature_likelihood import LEAST_M, look_up
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
    table: ti.types.ndarray(dtype=ti.f32, ndim=4),  # [K, N, T, 4] matched outputs of what is unexplained
    per_m: ti.f64,  # rows of the table per metre
    longest: ti.f64,  # no feature is heard from farther off, m
    power: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [POWERS]
    out: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [Q, 2] out: gain in log-likelihood, and with which power
):
    """Gain of one more feature over all steps, for the best of the powers."""
    ti.loop_config(block_dim=1)
    for chunk in range((candidates.shape[0] + CHUNK - 1) // CHUNK):
        for q in range(chunk * CHUNK, ti.min((chunk + 1) * CHUNK, candidates.shape[0])):
            gain, volume = (
                ti.Vector([ti.cast(0.0, ti.f64)] * POWERS),
                ti.Vector([ti.cast(1.0, ti.f64)] * POWERS),
            )
            for k in range(points.shape[0]):
                x, y = candidates[q, 0] - points[k, 0], candidates[q, 1] - points[k, 1]
                plain = ti.max(ti.sqrt(x * x + y * y), LEAST_M)
                length = plain + candidates[q, 2]
                if length < longest:
                    x, y = x / plain, y / plain
                    turn_x, turn_y = ti.cos(points[k, 2]), ti.sin(points[k, 2])
                    along, across = x * turn_x + y * turn_y, y * turn_x - x * turn_y
                    re, im = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
                    for m in range(element.shape[0]):
                        phase = along * element[m, 0] + across * element[m, 1]
                        c, s = ti.cos(phase), ti.sin(phase)
                        a = look_up(table, k, m, length * per_m, 0)
                        b = look_up(table, k, m, length * per_m, 1)
                        re += c * a + s * b
                        im += c * b - s * a
                    square = (re * re + im * im) / (length * length)
                    level = element.shape[0] / (length * length * points[k, 3])
                    for g in ti.static(range(POWERS)):
                        share = 1 + power[g] * level
                        gain[g] += power[g] * square / share
                        volume[g] *= share
            out[q, 0] = -1e30
            for g in ti.static(range(POWERS)):
                total = gain[g] - ti.log(volume[g])
                if total > out[q, 0]:
                    out[q, 0], out[q, 1] = total, power[g]
