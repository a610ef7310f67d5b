"""Evaluation of measurements under every path at every particle (docs/model.md, (M23)).

Particles are handled in blocks whose intermediate values stay on the stack, so that the inner loops
vectorise; angles are worked out only in blocks where a gated measurement's distance is met.
"""

import taichi as ti

from gridslam.kernels import PATH_BLOCK
from gridslam.kernels.primitives.device import ON_CPU
from gridslam.kernels.primitives.functions import (
    angle_of,
    cos_of,
    double_bounce,
    exp_of,
    sin_of,
    single_bounce,
    slant_of,
    wrapped,
)
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.layout import (
    GIVEN_HEIGHT,
    HEADING,
    HEIGHT,
    line_entry,
    line_row,
    lines_in,
    rise_of,
    unknown_row,
)
from gridslam.kernels.primitives.tables import (
    ANCHOR,
    AOA,
    AOD,
    BOUNCES,
    DISTANCE,
    FARTHEST,
    FIRST,
    INVERSE,
    LAST,
    NEAREST,
    NORMAL,
    OPEN,
    RAY_POSSIBLE,
)

BLOCK = PATH_BLOCK
FINE = 4096.0


@ti.func
def densities(
    block, head, state: ti.template(), path: ti.template(), places: ti.template(), start: ti.template(),
    pair: ti.template(), odds: ti.template(), out: ti.template(),
):  # fmt: skip
    """Sum, over a block of particles, the density of every gated pair where the path is possible.

    The factors of distance and angles in [Li2026grid], eqs. (8) to (10). Particles at which each
    path is possible are counted, too; of one without pairs that no ray comes through, V = 0, it doesn't
    matter at how many, and 0 stands there. Arguments are those of `evaluation.evaluate`; `pair` is its
    `table`, `out` its `blocks`.
    """
    for row in range(path.shape[0]):
        if start[row] < start[row + 1]:
            weigh_pairs(block, row, head, state, path, places, start, pair, out)
        elif odds[OPEN, row] > 0:  # of most paths, nothing is asked but whether they are possible
            out[row, block] = possible(block * BLOCK, row, state, path, places)
        else:
            out[row, block] = 0.0


@ti.func
def possible(at, row, state: ti.template(), path: ti.template(), places: ti.template()):
    """At how many of a block of particles, which begins at `at`, a path is possible."""
    anchor = path[row, ANCHOR]
    ax, ay = ti.cast(places[anchor, 0], ti.f32), ti.cast(places[anchor, 1], ti.f32)
    bounces, s, r = path[row, BOUNCES], line_row(path[row, LAST]), line_row(path[row, FIRST])
    count = ti.cast(BLOCK, ti.f32)
    if bounces > 0:
        count = 0.0
    if bounces == 1:
        for i in range(BLOCK):
            k = at + i
            _, _, _, _, ok = single_bounce(
                state[0, k], state[1, k], ax, ay, state[s, k], state[s + 1, k], state[s + 2, k]
            )
            count += ok
    elif bounces > 1:
        for i in range(BLOCK):
            k = at + i
            _, _, _, _, ok = double_bounce(
                state[0, k], state[1, k], ax, ay, state[s, k], state[s + 1, k], state[s + 2, k],
                state[r, k], state[r + 1, k], state[r + 2, k],
            )  # fmt: skip
            count += ok
    return count


@ti.func
def weigh_pairs(
    block, row, head, state: ti.template(), path: ti.template(), places: ti.template(),
    start: ti.template(), pair: ti.template(), out: ti.template(),
):  # fmt: skip
    """Sums over particles for the gated pairs of one path, and at how many particles it is possible."""
    at, paths, anchor = block * BLOCK, path.shape[0], path[row, ANCHOR]
    ax, ay = ti.cast(places[anchor, 0], ti.f32), ti.cast(places[anchor, 1], ti.f32)
    facing, height = ti.cast(places[anchor, 2], ti.f32), ti.cast(places[anchor, HEIGHT], ti.f32)
    bounces, s, r = path[row, BOUNCES], line_row(path[row, LAST]), line_row(path[row, FIRST])
    tx, ty = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    wx, wy = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    good, far = ti.Vector([1.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    if bounces == 0:
        for i in range(BLOCK):
            x, y = ax - state[0, at + i], ay - state[1, at + i]
            tx[i], ty[i], wx[i], wy[i] = x, y, -x, -y
    elif bounces == 1:
        for i in range(BLOCK):
            k = at + i
            a, b, c, d, ok = single_bounce(
                state[0, k], state[1, k], ax, ay, state[s, k], state[s + 1, k], state[s + 2, k]
            )
            tx[i], ty[i], wx[i], wy[i], good[i] = a, b, c, d, ok
    else:
        for i in range(BLOCK):
            k = at + i
            a, b, c, d, ok = double_bounce(
                state[0, k], state[1, k], ax, ay, state[s, k], state[s + 1, k], state[s + 2, k],
                state[r, k], state[r + 1, k], state[r + 2, k],
            )  # fmt: skip
            tx[i], ty[i], wx[i], wy[i], good[i] = a, b, c, d, ok
    low, high = 1 << 30, -(1 << 30)  # range interval in fixed point: integer extrema vectorise
    count = 0.0
    for i in range(BLOCK):
        far[i] = slant_of(tx[i] * tx[i] + ty[i] * ty[i], height)
    unknown = unknown_row(places, head, anchor, state.shape[0])
    if unknown >= 0:
        if rise_of(places, anchor) >= 0:
            anchor_height = ti.cast(places[anchor, GIVEN_HEIGHT], ti.f32)
            for i in range(BLOCK):
                far[i] = slant_of(tx[i] * tx[i] + ty[i] * ty[i], anchor_height + state[unknown, at + i])
        else:
            for i in range(BLOCK):
                far[i] += state[unknown, at + i]
    for i in range(BLOCK):
        fixed = ti.cast(far[i] * FINE, ti.i32)
        low, high = ti.min(low, fixed), ti.max(high, fixed)
    for i in range(BLOCK):
        count += good[i]
    out[row, block] = count
    wanted = 0
    for n in range(start[row], start[row + 1]):
        near = count > 0.0 and pair[n, NEAREST] * FINE <= high and pair[n, FARTHEST] * FINE >= low
        out[paths + n, block] = 1.0 if near else 0.0
        wanted += 1 if near else 0
    if wanted > 0:
        for i in range(BLOCK):
            arrival = angle_of(tx[i], ty[i]) - state[2, at + i]
            departure = angle_of(wx[i], wy[i]) - facing
            tx[i], wx[i] = arrival, departure
        for n in range(start[row], start[row + 1]):
            if out[paths + n, block] > 0.0:
                z0, z1, z2 = pair[n, DISTANCE], pair[n, AOD], pair[n, AOA]
                i00, i11, i22 = pair[n, INVERSE], pair[n, INVERSE + 1], pair[n, INVERSE + 2]
                i01, i02, i12 = pair[n, INVERSE + 3], pair[n, INVERSE + 4], pair[n, INVERSE + 5]
                total = 0.0
                for i in range(BLOCK):
                    e0, e1, e2 = z0 - far[i], wrapped(z1 - wx[i]), wrapped(z2 - tx[i])
                    q = i00 * e0 * e0 + i11 * e1 * e1 + i22 * e2 * e2
                    q += 2 * (i01 * e0 * e1 + i02 * e0 * e2 + i12 * e1 * e2)
                    total += good[i] * exp_of(-0.5 * q)
                out[paths + n, block] = total


@ti.func
def draw_path(state: ti.template(), path: ti.template(), places: ti.template(), row, k, drawn: ti.template()):
    """Draw a path at a state as a row of `drawn`, see `tables.NORMAL`: all but V.

    The first corner is the anchor, the last the agent, which repeats where there are fewer bounces. The first
    normal is that of the surface hit first, the second of the one hit last. An impossible path collapses onto
    the anchor.
    """
    at = row * state.shape[1] + k
    anchor = path[row, ANCHOR]
    ax, ay = places[anchor, 0], places[anchor, 1]
    px, py = ti.cast(state[0, k], ti.f64), ti.cast(state[1, k], ti.f64)
    bounces, s, r = path[row, BOUNCES], line_row(path[row, LAST]), line_row(path[row, FIRST])
    x1, y1, x2, y2 = px, py, px, py
    one, zero = ti.f64(1.0), ti.f64(0.0)
    mx, my, nx, ny = one, zero, one, zero
    ok = one
    if bounces > 0:
        nx, ny, c = state[s, k], state[s + 1, k], state[s + 2, k]
        here, across, there, over = zero, one, zero, one
        ux, uy = zero, zero
        if bounces == 1:
            vx, vy, _, _, good = single_bounce(px, py, ax, ay, nx, ny, c)
            mx, my = nx, ny
            here, across = nx * px + ny * py - c, nx * vx + ny * vy
            t = -here / ti.select(ti.abs(across) < 1e-12, 1e-12, across)
            x1, y1 = px + t * vx, py + t * vy
            ok = good
        else:
            mx, my, d = state[r, k], state[r + 1, k], state[r + 2, k]
            vx, vy, ux, uy, good = double_bounce(px, py, ax, ay, nx, ny, c, mx, my, d)
            here, across = nx * px + ny * py - c, nx * vx + ny * vy
            t = -here / ti.select(ti.abs(across) < 1e-12, 1e-12, across)
            there, over = mx * ax + my * ay - d, mx * ux + my * uy
            f = -there / ti.select(ti.abs(over) < 1e-12, 1e-12, over)
            x1, y1, x2, y2 = ax + f * ux, ay + f * uy, px + t * vx, py + t * vy
            ok = good
    largest = ti.max(ti.max(ti.abs(x1), ti.abs(y1)), ti.max(ti.abs(x2), ti.abs(y2)))
    if not (ti.max(largest, ti.max(ti.abs(px), ti.abs(py))) < 1e4):
        ok = zero
    if ok < 0.5:
        x1, y1, x2, y2, px, py = ax, ay, ax, ay, ax, ay
    drawn[at, 0], drawn[at, 1], drawn[at, 2], drawn[at, 3] = ax, ay, x1, y1
    drawn[at, 4], drawn[at, 5], drawn[at, 6], drawn[at, 7] = x2, y2, px, py
    drawn[at, NORMAL], drawn[at, NORMAL + 1] = mx, my
    drawn[at, NORMAL + 2], drawn[at, NORMAL + 3] = nx, ny
    drawn[at, RAY_POSSIBLE] = ok


@ti.func
def stand_at(mean: ti.template(), head, state: ti.template()):
    """Write the first state as the mean of a belief, without clocks, by which no path is drawn."""
    state[0, 0], state[1, 0], state[2, 0] = mean[0], mean[1], mean[HEADING]
    for s in range(lines_in(head, mean.shape[0])):
        entry = line_entry(head, s)
        state[line_row(s), 0], state[line_row(s) + 1, 0] = cos_of(mean[entry]), sin_of(mean[entry])
        state[line_row(s) + 2, 0] = mean[entry + 1]


@quick
@ti.kernel
def polylines(
    state: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [3 + 3 S or more, R] see `layout`
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 4] bounces, last, first, anchor
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 6] anchors: see `blocks`
    drawn: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L R, 14] out
):
    """Draw every path at every sampled state."""
    ti.loop_config(serialize=ON_CPU)  # too little work to wake other threads for
    for row, k in ti.ndrange(path.shape[0], state.shape[1]):
        draw_path(state, path, places, row, k, drawn)
