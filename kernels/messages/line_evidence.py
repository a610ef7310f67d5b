"""Evidence for lines of single bounces, gathered over steps from what known paths leave of snapshots."""

import taichi as ti

from gridslam.kernels.primitives.functions import bearing_of, cos_of, decay_of, sin_of
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.radio import scaled_bessel

TURN = 6.283185307179586
MOST_LOG = 12.0
"""Largest log ratio of one snapshot, about."""
LEAST, MOST = 1e-6, 1e30
"""Between which evidence stays."""


@quick
@ti.kernel
def weigh_lines(
    power: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [T, R, D] |y|^2 by departure, arrival and length,
    # noise of power 1; below 0 where a known path is too near
    folding: ti.f64,  # length beyond which a path looks nearer than it is
    place: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [4] anchor: x, y, orientation, height above the agent
    pose: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [5] x, y, heading of the agent; middle of the region
    offset: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [O] of the lines from the middle
    level: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [B] amplitude at 1 m, by coefficient
    chance: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] that a path is open; that it becomes audible
    fades: ti.i32,  # whether amplitudes are drawn anew at each step
    evidence: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [A, O, B] in and out: likelihood that a line has been
    # heard from some step on, over that it hasn't
):
    """Multiply the evidence of all lines by what a snapshot says of their single bounces."""
    ti.loop_config(serialize=True)
    for a, o in ti.ndrange(evidence.shape[0], evidence.shape[1]):
        angle = 0.5 * TURN * ti.cast(a, ti.f64) / evidence.shape[0]
        nx, ny = cos_of(angle), sin_of(angle)
        far = offset[o] + nx * pose[3] + ny * pose[4]
        here, there = nx * pose[0] + ny * pose[1] - far, nx * place[0] + ny * place[1] - far
        if here * there > 0:
            dx, dy = place[0] - 2 * there * nx - pose[0], place[1] - 2 * there * ny - pose[1]
            length = ti.sqrt(dx * dx + dy * dy + place[3] * place[3])
            arrival = bearing_of(dx, dy)
            t = nearest((2 * angle - arrival - place[2]) / TURN + 0.5, power.shape[0])
            r = nearest((arrival - pose[2]) / TURN + 0.5, power.shape[1])
            d = nearest(length / folding, power.shape[2])
            matched = power[t, r, d]
            if matched >= 0:
                amplitude = ti.sqrt(matched)
                for b in range(evidence.shape[2]):
                    strong = level[b] / length
                    square = strong * strong
                    ratio = decay_of(ti.min(square * matched / (1 + square), MOST_LOG)) / (1 + square)
                    if fades == 0:
                        bend = 2 * strong * amplitude
                        ratio = decay_of(ti.min(bend - square, MOST_LOG)) * scaled_bessel(bend)
                    ratio = chance[0] * ratio + 1 - chance[0]
                    before = evidence[a, o, b]
                    after = ratio * ((1 - chance[1]) * before + chance[1])
                    evidence[a, o, b] = ti.min(ti.max(after, LEAST), MOST)


@ti.func
def nearest(share, count):
    """Index of the nearest of so many points that are even over a turn, of which `share` has gone by."""
    index = ti.cast(ti.floor(share * count + 0.5), ti.i32) % count
    return index + count * ti.cast(index < 0, ti.i32)
