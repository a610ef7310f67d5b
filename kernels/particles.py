"""Particles of the joint belief: mean and root of the covariance applied to fixed normal points."""

import taichi as ti

from gridslam.kernels import PATH_BLOCK
from gridslam.kernels.device import SPREAD
from gridslam.kernels.functions import turn_of, wrapped
from gridslam.kernels.launching import quick

BLOCK = PATH_BLOCK
AGENT = 5
"""Entries of the agent's state; velocities (2 and 3) aren't drawn, since no path depends on them."""


@quick
@ti.kernel
def draw(
    root: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [N, N] of the covariance, lower triangular
    base: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [N, 3] mean, and its cosine and sine
    points: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [N or more, P] standard normal
    state: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [3 + 3 S, P] out: x, y, heading; normals and offsets
):
    """State ``base + root points`` of every particle, lines by their normals."""
    for item in range(ti.cast(points.shape[1] / BLOCK, ti.i32) * SPREAD):  # SPIR-V can't bound by a //
        if item % SPREAD == 0:
            at = item // SPREAD * BLOCK
            size = root.shape[0]
            for row in range(size):
                if row != 2 and row != 3:
                    gap = ti.Vector([0.0] * BLOCK)
                    for quad in range((row + 1) // 4):  # four at a time: sums are stored a quarter as often
                        n = 4 * quad
                        a, b, c, d = root[row, n], root[row, n + 1], root[row, n + 2], root[row, n + 3]
                        for i in range(BLOCK):
                            k = at + i
                            gap[i] += (
                                a * points[n, k]
                                + b * points[n + 1, k]
                                + c * points[n + 2, k]
                                + d * points[n + 3, k]
                            )
                    for n in range((row + 1) // 4 * 4, row + 1):
                        a = root[row, n]
                        for i in range(BLOCK):
                            gap[i] += a * points[n, at + i]
                    mean, cosine, sine = base[row, 0], base[row, 1], base[row, 2]
                    if row < 2 or row == 4:
                        out = ti.min(row, 2)
                        for i in range(BLOCK):
                            state[out, at + i] = mean + gap[i]
                    elif row % 2 == 1:
                        out = 3 + (row - AGENT) // 2 * 3
                        x, y = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
                        for i in range(BLOCK):
                            c, s = turn_of(wrapped(gap[i]))
                            x[i], y[i] = cosine * c - sine * s, sine * c + cosine * s
                        for i in range(BLOCK):
                            state[out, at + i] = x[i]
                        for i in range(BLOCK):
                            state[out + 1, at + i] = y[i]
                    else:
                        out = 5 + (row - AGENT) // 2 * 3
                        for i in range(BLOCK):
                            state[out, at + i] = mean + gap[i]
