"""Which measurements may have come from which paths, and what the evaluation needs of each such pair."""

import taichi as ti

from gridslam.kernels.functions import cos_of, sin_of, wrapped
from gridslam.kernels.launching import quick

ROOT_TURN = 2.5066282746310002


@ti.func
def angle_std(angle, across, along, amplitude):
    """sigma of an angle seen by an array with mean square extents (along x, along y), rad."""
    s, c = sin_of(angle), cos_of(angle)
    return 1 / (8.885765876316732 * amplitude * ti.sqrt(ti.max(s * s * across + c * c * along, 1e-30)))


@quick
@ti.kernel
def gate(
    predicted: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, 12] value (3) and spread (9) of every path
    worth: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [L] paths below a millionth are left out
    heard: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 6] z; its deviations: 0 by Fisher, -1 not measured
    strength: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [2, L, M] amplitude's ratio to clutter, its mean
    radio: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [13] see `inference.evaluation.gate`
    start: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [L + 1] out: where the pairs of each path begin
    index: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L M, 2] out: path and measurement
    pair: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L M, 9] out: z, variances, density, 0, determinant
    table: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [L M, 11] out: z, inverse (6), nearest, farthest
):
    """Pick the pairs whose distance and angles lie within reach of what is predicted, path by path."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        widest, margin, slack = radio[8], radio[9], radio[10]
        unmeasured, faintest = radio[11], radio[12]
        known = 0
        start[0] = 0
        for row in range(predicted.shape[0]):
            for m in range(heard.shape[0]):
                ratio = strength[0, row, m]
                if worth[row] > 1e-6 and ratio > 0:
                    amplitude = ti.max(strength[1, row, m], faintest)
                    std = ti.Vector([radio[0] / amplitude, 0.0, 0.0], dt=ti.f64)
                    if radio[1] > 0:
                        std[0] = radio[1]
                    std[1] = angle_std(predicted[row, 1], radio[2], radio[3], amplitude)
                    std[2] = angle_std(predicted[row, 2], radio[4], radio[5], amplitude)
                    near, absent = True, ti.cast(1.0, ti.f64)
                    variance = ti.Vector([0.0, 0.0, 0.0], dt=ti.f64)
                    for q in ti.static(range(3)):
                        own, gap = heard[m, 3 + q], ti.cast(0.0, ti.f64)
                        if own > 0:
                            std[q] = own
                        if own >= 0:
                            gap = heard[m, q] - predicted[row, q]
                            if ti.static(q > 0):
                                gap = wrapped(gap)
                        variance[q] = ti.max(std[q], 1e-6) ** 2
                        if own < 0 or variance[q] >= unmeasured:
                            # a factor left out on both sides: its clutter density cancels
                            flat = radio[6] if ti.static(q == 0) else ROOT_TURN * ROOT_TURN
                            absent *= ROOT_TURN * ti.sqrt(unmeasured) / flat
                            variance[q] = unmeasured
                            std[q] = 0.0
                        reach = widest * ti.sqrt(predicted[row, 3 + 4 * q] + std[q] * std[q])
                        reach += margin if ti.static(q == 0) else slack
                        if not (ti.abs(gap) < reach):
                            near = False
                    if near:
                        total = ti.Matrix.zero(ti.f64, 3, 3)
                        for i in ti.static(range(3)):
                            for j in ti.static(range(3)):
                                total[i, j] = radio[7] * predicted[row, 3 + 3 * i + j]
                            total[i, i] += variance[i]
                        a, b, c = total[0, 0], total[1, 1], total[2, 2]
                        d, e, f = total[0, 1], total[0, 2], total[1, 2]
                        i00, i11, i22 = b * c - f * f, a * c - e * e, a * b - d * d
                        i01, i02, i12 = e * f - c * d, d * f - b * e, d * e - a * f
                        determinant = a * i00 + d * i01 + e * i02
                        reach = ti.min(widest * ti.sqrt(a), 1e5)
                        index[known, 0], index[known, 1] = row, m
                        for q in ti.static(range(3)):
                            pair[known, q], pair[known, 3 + q] = heard[m, q], variance[q]
                            table[known, q] = ti.cast(heard[m, q], ti.f32)
                        pair[known, 6], pair[known, 7], pair[known, 8] = ratio * absent, 0.0, determinant
                        table[known, 3] = ti.cast(i00 / determinant, ti.f32)
                        table[known, 4] = ti.cast(i11 / determinant, ti.f32)
                        table[known, 5] = ti.cast(i22 / determinant, ti.f32)
                        table[known, 6] = ti.cast(i01 / determinant, ti.f32)
                        table[known, 7] = ti.cast(i02 / determinant, ti.f32)
                        table[known, 8] = ti.cast(i12 / determinant, ti.f32)
                        table[known, 9] = ti.cast(ti.max(heard[m, 0] - reach, -1e5), ti.f32)
                        table[known, 10] = ti.cast(heard[m, 0] + reach, ti.f32)
                        known += 1
            start[row + 1] = known
