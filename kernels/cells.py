"""Ray casting through grid cells and the messages to cells (paper 003, eqs. (1), (43)-(45)).

A ray is the polyline anchor, interaction points, agent. It traverses cells T and meets cells H_b at
bounce b. Rays of one path are adjacent. Every slab handles a fixed set of paths in order, so sums do
not depend on the number of threads.

A message is a ratio of two means over a path's rays, in which a ray that doesn't touch the cell counts
alike. A crossed cell needs only the sum of V over the rays that cross it; a met cell the two lifts of its
own states above that. So a ray is walked twice at most: for V, and to add V to its cells.
"""

import taichi as ti

from gridslam.kernels.device import ON_CPU, SPREAD
from gridslam.kernels.functions import log_of
from gridslam.kernels.launching import quick
from gridslam.kernels.paths import draw_path

NEAR = 3
"""Steps of a walk within which it may touch the cells met at its ends."""


@ti.func
def cell_of(x, origin, per_metre):
    """Index of the cell that holds a coordinate."""
    return ti.cast(ti.floor((x - origin) * per_metre), ti.i32)


@ti.func
def listed(slab, ix, iy, scratch: ti.template(), touched: ti.template(), count):
    """Enter a cell in the list of those that the path touches, once; return how many there are."""
    n = count
    if (
        scratch[slab, 0, iy, ix] == 0.0
        and scratch[slab, 1, iy, ix] == 0.0
        and scratch[slab, 2, iy, ix] == 0.0
    ):
        touched[slab, n, 0], touched[slab, n, 1] = ix, iy
        n += 1
    return n


@quick
@ti.kernel
def cast(
    state: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [3 + 3 S, R] x, y, heading; per line normal x, y, offset
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 4] bounces, last, first, anchor
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 3] anchors: x, y, orientation
    factor: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, 2]  A of the path, and whether to send messages
    occupied: ti.types.ndarray(dtype=ti.f32, ndim=3),  # [2, ny, nx] o of a traversed cell, of a hit one in V
    frame: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [6] origin x, y, side, factor outside, clip, least share
    drawn: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L R, 14] out: corners, normals, possible or not, V
    scratch: ti.types.ndarray(dtype=ti.f32, ndim=4),  # [SLABS, 3, ny, nx] zero on entry and exit
    touched: ti.types.ndarray(dtype=ti.i32, ndim=3),  # [SLABS, ny * nx + 1, 2] scratch
    message: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [SLABS, ny, nx] in/out: sum of log ratios
):
    """Draw and cast the rays of all paths; add the log ratios to `message` of those that are to send.

    A path sends only if it is possible at more than the least share of its states.
    """
    ti.loop_config(serialize=ON_CPU)  # too little work to wake other threads for
    for row, k in ti.ndrange(path.shape[0], state.shape[1]):
        draw_path(state, path, places, row, k, drawn)
    for item in range(message.shape[0] * SPREAD):
        if item % SPREAD == 0:
            slab = item // SPREAD
            ny, nx = occupied.shape[1], occupied.shape[2]
            paths, rays = path.shape[0], state.shape[1]
            side, per_metre, outside, clip = frame[2], 1 / frame[2], frame[3], frame[4]
            row = slab
            while row < paths:
                count, a = path[row, 0], factor[row, 0]
                total, known = ti.cast(0.0, ti.f64), 0
                possible = ti.cast(0.0, ti.f64)
                for ray in range(rays):
                    possible += drawn[row * rays + ray, 12]
                send = factor[row, 1] > 0.5 and possible > frame[5] * rays
                for ray in range(rays):
                    k = row * rays + ray
                    hx, hy = ti.Vector([-9, -9, -9, -9, -9, -9]), ti.Vector([-9, -9, -9, -9, -9, -9])
                    met_v, met_m = ti.Vector([1.0, 1.0], dt=ti.f64), ti.Vector([1.0, 1.0], dt=ti.f64)
                    for b in range(count):
                        clear_v, clear_m = ti.cast(1.0, ti.f64), ti.cast(1.0, ti.f64)
                        inside = 0
                        for n in range(3):
                            off = (n - 1) * side
                            ix = cell_of(drawn[k, 2 * b + 2] + off * drawn[k, 8 + 2 * b], frame[0], per_metre)
                            iy = cell_of(drawn[k, 2 * b + 3] + off * drawn[k, 9 + 2 * b], frame[1], per_metre)
                            if ix >= 0 and iy >= 0 and ix < nx and iy < ny:
                                fresh = 1
                                for other in range(n):
                                    if hx[3 * b + other] == ix and hy[3 * b + other] == iy:
                                        fresh = 0
                                if fresh == 1:
                                    hx[3 * b + n], hy[3 * b + n] = ix, iy
                                    clear_v *= 1 - occupied[1, iy, ix]
                                    clear_m *= 1 - occupied[0, iy, ix]
                                    inside = 1
                        met_v[b] = 1 - clear_v if inside == 1 else outside
                        met_m[b] = 1 - clear_m if inside == 1 else outside
                    through = ti.cast(1.0, ti.f64)
                    v_m = ti.cast(0.0, ti.f64)
                    for walk in ti.static(range(2)):  # 0: V; 1: add it to the cells
                        if walk == 0 or (send and v_m > 0):
                            add = ti.cast(v_m, ti.f32)
                            for leg in range(count + 1):  # Amanatides and Woo
                                x0 = (drawn[k, 2 * leg] - frame[0]) * per_metre
                                y0 = (drawn[k, 2 * leg + 1] - frame[1]) * per_metre
                                x1 = (drawn[k, 2 * leg + 2] - frame[0]) * per_metre
                                y1 = (drawn[k, 2 * leg + 3] - frame[1]) * per_metre
                                ix, iy = ti.cast(ti.floor(x0), ti.i32), ti.cast(ti.floor(y0), ti.i32)
                                jx, jy = ti.cast(ti.floor(x1), ti.i32), ti.cast(ti.floor(y1), ti.i32)
                                dx, dy = x1 - x0, y1 - y0
                                sx, sy = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
                                far = ti.cast(1e30, ti.f64)
                                tx, ty, ax, ay = far, far, far, far
                                if ti.abs(dx) > 1e-12:
                                    ax = ti.abs(1 / dx)
                                    tx = (ix + 1 - x0 if dx > 0 else x0 - ix) * ax
                                if ti.abs(dy) > 1e-12:
                                    ay = ti.abs(1 / dy)
                                    ty = (iy + 1 - y0 if dy > 0 else y0 - iy) * ay
                                steps = ti.abs(jx - ix) + ti.abs(jy - iy) + 1
                                # met cells lie at the leg's ends, unless another bounce's stand in its way
                                lx, ly, ux, uy = (
                                    ti.min(ix, jx),
                                    ti.min(iy, jy),
                                    ti.max(ix, jx),
                                    ti.max(iy, jy),
                                )
                                careful = lx < 0 or ly < 0 or ux >= nx or uy >= ny
                                for n in range(3 * count):
                                    b = n // 3
                                    if b != leg and b != leg - 1:
                                        if hx[n] >= lx and hx[n] <= ux and hy[n] >= ly and hy[n] <= uy:
                                            careful = True
                                head = steps if careful else (ti.min(steps, NEAR) if leg > 0 else 0)
                                tail = ti.min(steps - head, NEAR) if leg < count else 0
                                for part in ti.static(range(3)):
                                    left = head if part == 0 else (tail if part == 2 else steps - head - tail)
                                    while left > 0:
                                        left -= 1
                                        good = True
                                        if ti.static(part != 1):
                                            good = ix >= 0 and iy >= 0 and ix < nx and iy < ny
                                            for n in range(3 * count):
                                                if hx[n] == ix and hy[n] == iy:
                                                    good = False
                                        if good:
                                            if ti.static(walk == 0):
                                                through *= 1 - occupied[0, iy, ix]
                                            else:
                                                before = scratch[slab, 0, iy, ix]
                                                if before == 0.0:
                                                    known = listed(slab, ix, iy, scratch, touched, known)
                                                scratch[slab, 0, iy, ix] = before + add
                                        if tx < ty:
                                            tx += ax
                                            ix += sx
                                        else:
                                            ty += ay
                                            iy += sy
                        if ti.static(walk == 0):
                            drawn[k, 13] = through * met_v[0] * met_v[1]
                            v_m = through * met_m[0] * met_m[1]
                            total += v_m * a + 1 - v_m
                    if send and v_m > 0:
                        for b in range(count):
                            v1 = v_m / ti.max(met_m[b], 1e-12)
                            for n in range(3 * b, 3 * b + 3):
                                ix, iy = hx[n], hy[n]
                                if ix >= 0:
                                    v0 = v1 * (1 - (1 - met_m[b]) / (1 - occupied[0, iy, ix]))
                                    known = listed(slab, ix, iy, scratch, touched, known)
                                    low, high = (v0 - v_m) * (a - 1), (v1 - v_m) * (a - 1)
                                    before1, before2 = scratch[slab, 1, iy, ix], scratch[slab, 2, iy, ix]
                                    scratch[slab, 1, iy, ix] = before1 + ti.cast(low, ti.f32)
                                    scratch[slab, 2, iy, ix] = before2 + ti.cast(high, ti.f32)
                for n in range(known):
                    ix, iy = touched[slab, n, 0], touched[slab, n, 1]
                    o, lift = ti.cast(occupied[0, iy, ix], ti.f64), (a - 1) * scratch[slab, 0, iy, ix]
                    low = ti.max(total + lift * o / (1 - o) + scratch[slab, 1, iy, ix], 1e-12)
                    high = ti.max(total - lift + scratch[slab, 2, iy, ix], 1e-12)
                    ratio = log_of(ti.max(1e-30, ti.min(high / low, 1e30)))
                    before = message[slab, iy, ix]  # a slab has one thread, so nothing need be atomic
                    message[slab, iy, ix] = before + ti.max(-clip, ti.min(clip, ratio))
                    scratch[slab, 0, iy, ix] = 0.0
                    scratch[slab, 1, iy, ix] = 0.0
                    scratch[slab, 2, iy, ix] = 0.0
                row += message.shape[0]
