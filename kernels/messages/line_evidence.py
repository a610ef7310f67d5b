"""Evidence for lines of single bounces, gathered over steps from what known paths leave of snapshots."""

import taichi as ti

from gridslam.kernels.primitives.functions import angle_of, cos_of, exp_of, sin_of
from gridslam.kernels.primitives.launching import quick

TURN = 6.283185307179586
MOST_LOG = 12.0
"""Largest log ratio of one snapshot, about."""
LEAST, MOST = 1e-6, 1e30
"""Between which evidence stays."""


@quick
@ti.kernel
def weigh_lines(
    power: ti.types.ndarray(dtype=ti.f32, ndim=3),  # [T, R, D] |y|^2 by departure, arrival and length;
    # below 0 where a known path is too near
    noise: ti.f64,  # power of the noise in that
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
    fold, quiet = 1 / folding, ti.cast(1 / noise, ti.f32)
    for a in range(evidence.shape[0]):
        angle = 0.5 * TURN * ti.cast(a, ti.f64) / evidence.shape[0]
        nx, ny = cos_of(angle), sin_of(angle)
        middle = nx * pose[3] + ny * pose[4]
        here, there = nx * pose[0] + ny * pose[1] - middle, nx * place[0] + ny * place[1] - middle
        for o in range(evidence.shape[1]):
            if (here - offset[o]) * (there - offset[o]) > 0:
                back = 2 * (there - offset[o])
                dx, dy = place[0] - back * nx - pose[0], place[1] - back * ny - pose[1]
                length = ti.sqrt(dx * dx + dy * dy + place[3] * place[3])
                arrival = angle_of(ti.cast(dx, ti.f32), ti.cast(dy, ti.f32))
                t = nearest((2 * angle - arrival - place[2]) * (1 / TURN) + 0.5, power.shape[0])
                r = nearest((arrival - pose[2]) * (1 / TURN) + 0.5, power.shape[1])
                d = nearest(length * fold, power.shape[2])
                matched = power[t, r, d]
                if matched >= 0:
                    magnitude, near = ti.sqrt(matched * quiet), ti.cast(1 / length, ti.f32)
                    for b in range(evidence.shape[2]):
                        ratio = ratio_of(magnitude, near * ti.cast(level[b], ti.f32), fades)
                        before = evidence[a, o, b]
                        after = (chance[0] * ratio + 1 - chance[0]) * ((1 - chance[1]) * before + chance[1])
                        evidence[a, o, b] = ti.min(ti.max(after, LEAST), MOST)


@ti.func
def ratio_of(magnitude, strong, fades):
    """Likelihood ratio of a path of some amplitude where |y| is `magnitude`, (M152), in single precision."""
    square = strong * strong
    ratio = ti.f32(0.0)
    if fades:
        ratio = exp_of(ti.min(square * magnitude * magnitude / (1 + square), MOST_LOG)) / (1 + square)
    else:
        bend = 2 * strong * magnitude
        if bend <= 3.75:  # [Abramowitz1964handbook], 9.8.1, 9.8.2
            t = bend * bend * (1 / 14.0625)
            ratio = exp_of(-square) * (1 + t * (3.5156229 + t * (3.0899424 + t * (
                1.2067492 + t * (0.2659732 + t * (0.0360768 + t * 0.0045813))
            ))))  # fmt: skip
        else:
            s = 3.75 / bend
            ratio = exp_of(ti.min(bend - square, MOST_LOG)) * ti.rsqrt(bend) * (0.39894228 + s * (
                0.01328592 + s * (0.00225319 + s * (-0.00157565 + s * (0.00916281 + s * (
                    -0.02057706 + s * (0.02635537 + s * (-0.01647633 + s * 0.00392377))
                ))))
            ))  # fmt: skip
    return ratio


@ti.func
def nearest(share, count):
    """Index of the nearest of so many points that are even over a turn, of which `share` has gone by."""
    index = ti.cast((share - ti.floor(share)) * count + 0.5, ti.i32)
    return index if index < count else 0
