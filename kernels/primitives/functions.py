"""Small functions that kernels share: mirrors, and polynomials that vectorise where libm doesn't."""

import taichi as ti

from gridslam.kernels.primitives.device import WIDE

PI, TURN, ROOT_TURN = 3.141592653589793, 6.283185307179586, 2.5066282746310002


@ti.func
def exp_of(x):
    """exp(x) for x <= 0 in single precision, relative error below 3e-6; 0 below -80."""
    t = ti.max(x, -80.0) * 1.4426950408889634
    whole = ti.floor(t + 0.5)
    f = t - whole
    p = 1.0 + f * (
        0.69314718 + f * (0.24022651 + f * (0.05550411 + f * (0.009618129 + f * (0.00133336 + f * 1.54e-4))))
    )
    scale = ti.bit_cast((ti.cast(whole, ti.i32) + 127) << 23, ti.f32)
    return ti.select(x < -80.0, 0.0, p * scale)


@ti.func
def log_of(x):
    """log(x) of a positive normal number in single precision, error below 1e-6."""
    bits = ti.bit_cast(ti.cast(x, ti.f32), ti.i32)
    power = (bits >> 23) - 127
    m = ti.bit_cast((bits & 0x7FFFFF) | 0x3F800000, ti.f32)  # in [1, 2)
    high = m > 1.4142135
    m = ti.select(high, 0.5 * m, m)
    t = (m - 1) / (m + 1)
    s = t * t
    series = 2 * t * (1 + s * (1 / 3 + s * (0.2 + s * (1 / 7 + s / 9))))
    return ti.cast(power + ti.select(high, 1, 0), ti.f32) * 0.69314718 + series


@ti.func
def angle_of(x, y):
    """atan2(y, x) in single precision, error below 1e-5 rad."""
    ax, ay = ti.abs(x), ti.abs(y)
    big, small = ti.max(ax, ay), ti.min(ax, ay)
    a = small / ti.max(big, 1e-20)
    s = a * a
    r = a * (
        0.99997726
        + s * (-0.33262347 + s * (0.19354346 + s * (-0.11643287 + s * (0.05265332 - s * 0.01172120))))
    )
    r = ti.select(ay > ax, 0.5 * PI - r, r)
    r = ti.select(x < 0, PI - r, r)
    return ti.select(y < 0, -r, r)


def _narrow(function):
    """A function's twin in single precision, for devices that have it in no other."""

    @ti.func
    def of_one(x):
        return ti.cast(function(ti.cast(x, ti.f32)), ti.f64)

    return of_one


cos_of = ti.cos if WIDE else _narrow(ti.cos)
"""Cosine of a number in double precision, as precise as the device has it."""
sin_of = ti.sin if WIDE else _narrow(ti.sin)
"""Sine; see `cos_of`."""
decay_of = ti.exp if WIDE else _narrow(ti.exp)
"""exp(x); see `cos_of`."""
logarithm_of = ti.log if WIDE else _narrow(ti.log)
"""log(x); see `cos_of`."""


@ti.func
def bearing_of(x, y):
    """atan2(y, x); see `cos_of`."""
    narrow = ti.cast(ti.atan2(ti.cast(y, ti.f32), ti.cast(x, ti.f32)), ti.f64)
    return ti.atan2(y, x) if ti.static(WIDE) else narrow


@ti.func
def dot(a, b):
    """Scalar product of two vectors of two entries."""
    return a[0] * b[0] + a[1] * b[1]


@ti.func
def turn_of(angle):
    """Cosine and sine of an angle in [-pi, pi] in single precision, error below 1e-6."""
    h = 0.5 * angle
    q = h * h
    s = h * (1 - q / 6 * (1 - q / 20 * (1 - q / 42 * (1 - q / 72 * (1 - q / 110)))))
    c = 1 - q / 2 * (1 - q / 12 * (1 - q / 30 * (1 - q / 56 * (1 - q / 90 * (1 - q / 132)))))
    return 1 - 2 * s * s, 2 * s * c


@ti.func
def wrapped(angle):
    """An angle, in [-pi, pi]."""
    return angle - TURN * ti.floor(angle * (1 / TURN) + 0.5)


@ti.func
def mirrored(x, y, nx, ny, c):
    """Mirror image of a point at the line n . q = c."""
    t = 2 * (nx * x + ny * y - c)
    return x - t * nx, y - t * ny


@ti.func
def slant_of(square, height):
    """Length of a path by the square of its length seen from above: docs/model.md, (M221).

    `height` is that of the anchor above the agent; walls are vertical.
    """
    return ti.sqrt(square + height * height)


@ti.func
def level_of(length, height):
    """The inverse: how long a path is seen from above; 0 where it can't reach the anchor's height."""
    return ti.sqrt(ti.max((length - height) * (length + height), 0.0))


@ti.func
def single_bounce(px, py, ax, ay, nx, ny, c):
    """Agent, anchor, line -> vector from agent to image, vector from anchor to mirrored agent, possible.

    The interaction point lies strictly inside iff agent and anchor stand on the same side of the line.
    """
    qx, qy = mirrored(ax, ay, nx, ny, c)
    wx, wy = mirrored(px, py, nx, ny, c)
    here, there = nx * px + ny * py - c, nx * ax + ny * ay - c
    return qx - px, qy - py, wx - ax, wy - ay, ti.select(here * there > 0, 1.0, 0.0)


@ti.func
def double_bounce(px, py, ax, ay, nx, ny, c, mx, my, d):
    """As `single_bounce`, over the first line (mx, my, d) and then the last line (nx, ny, c)."""
    ix, iy = mirrored(ax, ay, mx, my, d)
    qx, qy = mirrored(ix, iy, nx, ny, c)
    ux, uy = mirrored(px, py, nx, ny, c)
    wx, wy = mirrored(ux, uy, mx, my, d)
    here, image = nx * px + ny * py - c, nx * ix + ny * iy - c
    t = here / ti.select(ti.abs(here + image) < 1e-9, 1e-9, here + image)
    lx, ly = px + t * (qx - px), py + t * (qy - py)
    last, anchor = mx * lx + my * ly - d, mx * ax + my * ay - d
    good = ti.select(here * image > 0, 1.0, 0.0) * ti.select(last * anchor > 0, 1.0, 0.0)
    return qx - px, qy - py, wx - ax, wy - ay, good
