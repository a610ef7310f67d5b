"""Ray casting through grid cells and the messages to cells (paper 003, eqs. (1), (43)-(45)).

A ray is the polyline anchor, interaction points, agent. It traverses cells T and meets cells H_b at
bounce b. Rays of one path are adjacent. Every slab handles a fixed set of paths in order, so sums do
not depend on the number of threads.
"""

import taichi as ti

SLABS = 4


@ti.func
def cell_of(x, origin, cell):
    """Index of the cell that holds a coordinate."""
    return ti.cast(ti.floor((x - origin) / cell), ti.i32)


@ti.kernel
def cast(
    corners: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [K, 4, 2] anchor, points, agent (all legs real)
    normals: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [K, 2, 2] normals of the surfaces hit
    bounces: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [L]
    factor: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, 2]  A of the path, and whether to send messages
    traversed: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [ny, nx] o of a traversed cell
    hit: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [ny, nx] o of a hit cell inside V
    frame: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [3] origin x, y, cell side
    validity: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [K] out: V
    lift: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [SLABS, 2, ny, nx] scratch, zero on entry and exit
    message: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [SLABS, ny, nx] in/out: sum of log ratios
    rays: ti.i32,
    outside: ti.f64,
    clip: ti.f64,
):
    """Cast the rays of all paths; where `factor[:, 1]` is set, add the paths' log ratios to `message`."""
    ny, nx = traversed.shape[0], traversed.shape[1]
    ti.loop_config(block_dim=1)
    for slab in range(SLABS):
        paths = bounces.shape[0]
        path = slab
        while path < paths:
            count = bounces[path]
            total = ti.cast(0.0, ti.f64)
            a = factor[path, 0]
            for mode in ti.static(range(3)):  # 0: cast V; 1: collect messages; 2: fold them into the sum
                if mode == 0 or factor[path, 1] > 0.5:
                    for ray in range(rays):
                        k = path * rays + ray
                        hx, hy = ti.Vector([-9, -9, -9, -9, -9, -9]), ti.Vector([-9, -9, -9, -9, -9, -9])
                        met_v = ti.Vector([1.0, 1.0], dt=ti.f64)
                        met_m = ti.Vector([1.0, 1.0], dt=ti.f64)
                        for b in range(count):
                            clear_v, clear_m = ti.cast(1.0, ti.f64), ti.cast(1.0, ti.f64)
                            inside = 0
                            for side in range(3):
                                off = (side - 1) * frame[2]
                                ix = cell_of(
                                    corners[k, b + 1, 0] + off * normals[k, b, 0], frame[0], frame[2]
                                )
                                iy = cell_of(
                                    corners[k, b + 1, 1] + off * normals[k, b, 1], frame[1], frame[2]
                                )
                                if ix >= 0 and iy >= 0 and ix < nx and iy < ny:
                                    fresh = 1
                                    for other in range(side):
                                        if hx[3 * b + other] == ix and hy[3 * b + other] == iy:
                                            fresh = 0
                                    if fresh == 1:
                                        hx[3 * b + side], hy[3 * b + side] = ix, iy
                                        clear_v *= 1 - hit[iy, ix]
                                        clear_m *= 1 - traversed[iy, ix]
                                        inside = 1
                            met_v[b] = 1 - clear_v if inside == 1 else outside
                            met_m[b] = 1 - clear_m if inside == 1 else outside
                        # walk the legs (Amanatides and Woo)
                        through = ti.cast(1.0, ti.f64)
                        if ti.static(mode > 0):
                            through = validity[k]
                            for b in range(count):
                                through /= ti.max(met_v[b], 1e-12)
                        v_m = through
                        for b in range(count):
                            v_m *= met_m[b]
                        base = v_m * a + 1 - v_m
                        if ti.static(mode == 1):
                            total += base
                        for leg in range(count + 1):
                            x0 = (corners[k, leg, 0] - frame[0]) / frame[2]
                            y0 = (corners[k, leg, 1] - frame[1]) / frame[2]
                            x1 = (corners[k, leg + 1, 0] - frame[0]) / frame[2]
                            y1 = (corners[k, leg + 1, 1] - frame[1]) / frame[2]
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
                            left = ti.abs(jx - ix) + ti.abs(jy - iy) + 1
                            while left > 0:
                                left -= 1
                                if ix >= 0 and iy >= 0 and ix < nx and iy < ny:
                                    own = 0
                                    for n in range(3 * count):
                                        if hx[n] == ix and hy[n] == iy:
                                            own = 1
                                    if own == 0:
                                        o = traversed[iy, ix]
                                        if ti.static(mode == 0):
                                            through *= 1 - o
                                        if ti.static(mode == 1):
                                            v = ti.min(v_m / (1 - o), 1.0)
                                            lift[slab, 0, iy, ix] += v * a + 1 - v - base
                                            lift[slab, 1, iy, ix] += 1 - base
                                        if ti.static(mode == 2):
                                            low, high = lift[slab, 0, iy, ix], lift[slab, 1, iy, ix]
                                            if low != 0.0 or high != 0.0:
                                                ratio = ti.log(ti.max(total + high, 1e-12))
                                                ratio -= ti.log(ti.max(total + low, 1e-12))
                                                message[slab, iy, ix] += ti.max(-clip, ti.min(clip, ratio))
                                                lift[slab, 0, iy, ix] = 0.0
                                                lift[slab, 1, iy, ix] = 0.0
                                if tx < ty:
                                    tx += ax
                                    ix += sx
                                else:
                                    ty += ay
                                    iy += sy
                        if ti.static(mode == 0):
                            for b in range(count):
                                through *= met_v[b]
                            validity[k] = through
                        if ti.static(mode > 0):
                            for b in range(count):
                                v1 = v_m / ti.max(met_m[b], 1e-12)
                                for side in range(3):
                                    ix, iy = hx[3 * b + side], hy[3 * b + side]
                                    if ix >= 0:
                                        if ti.static(mode == 1):
                                            rest = (1 - met_m[b]) / (1 - traversed[iy, ix])
                                            v0 = v1 * (1 - rest)
                                            lift[slab, 0, iy, ix] += v0 * a + 1 - v0 - base
                                            lift[slab, 1, iy, ix] += v1 * a + 1 - v1 - base
                                        else:
                                            low, high = lift[slab, 0, iy, ix], lift[slab, 1, iy, ix]
                                            if low != 0.0 or high != 0.0:
                                                ratio = ti.log(ti.max(total + high, 1e-12))
                                                ratio -= ti.log(ti.max(total + low, 1e-12))
                                                message[slab, iy, ix] += ti.max(-clip, ti.min(clip, ratio))
                                                lift[slab, 0, iy, ix] = 0.0
                                                lift[slab, 1, iy, ix] = 0.0
            path += SLABS
