"""Evaluation of measurements under every path at every particle (model.md, section 2.2).

Particles are handled in blocks whose intermediate values stay on the stack, so that the inner loops
vectorise; angles are worked out only in blocks where a gated measurement's distance is met.
"""

import taichi as ti

from gridslam.kernels import PATH_BLOCK
from gridslam.kernels.functions import angle_of, double_bounce, exp_of, single_bounce, wrapped

BLOCK = PATH_BLOCK
FINE = 4096.0


@ti.kernel
def evaluate(
    agent: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [3, P] x, y, heading
    lines: ti.types.ndarray(dtype=ti.f32, ndim=3),  # [3, S, P] normal x, y, offset
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 3] bounces, last, first
    start: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [L + 1] first pair of each path
    pair: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [K, 11] z (3), inverse covariance (6), nearest, farthest
    place: ti.types.ndarray(dtype=ti.f32, ndim=1),  # [3] anchor x, y, orientation
    weight: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [K, P / BLOCK] out: sum of exp(-quadratic / 2)
    valid: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [L, P / BLOCK] out: number of valid particles
):
    """Sum, over each block of particles, the density of every gated pair where the path is possible."""
    ti.loop_config(block_dim=1)
    for block in range(agent.shape[1] // BLOCK):
        base = block * BLOCK
        ax, ay, facing = place[0], place[1], place[2]
        for row in range(path.shape[0]):
            tx, ty = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
            wx, wy = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
            good, far = ti.Vector([1.0] * BLOCK), ti.Vector([0.0] * BLOCK)
            bounces, s, r = path[row, 0], path[row, 1], path[row, 2]
            if bounces == 0:
                for i in range(BLOCK):
                    x, y = ax - agent[0, base + i], ay - agent[1, base + i]
                    tx[i], ty[i], wx[i], wy[i] = x, y, -x, -y
            elif bounces == 1:
                for i in range(BLOCK):
                    k = base + i
                    a, b, c, d, ok = single_bounce(
                        agent[0, k], agent[1, k], ax, ay, lines[0, s, k], lines[1, s, k], lines[2, s, k]
                    )
                    tx[i], ty[i], wx[i], wy[i], good[i] = a, b, c, d, ok
            else:
                for i in range(BLOCK):
                    k = base + i
                    a, b, c, d, ok = double_bounce(
                        agent[0, k], agent[1, k], ax, ay, lines[0, s, k], lines[1, s, k], lines[2, s, k],
                        lines[0, r, k], lines[1, r, k], lines[2, r, k],
                    )  # fmt: skip
                    tx[i], ty[i], wx[i], wy[i], good[i] = a, b, c, d, ok
            low, high = 1 << 30, 0  # range interval in fixed point: integer extrema vectorise
            count = 0.0
            for i in range(BLOCK):
                far[i] = ti.sqrt(tx[i] * tx[i] + ty[i] * ty[i])
            for i in range(BLOCK):
                fixed = ti.cast(far[i] * FINE, ti.i32)
                low, high = ti.min(low, fixed), ti.max(high, fixed)
            for i in range(BLOCK):
                count += good[i]
            valid[row, block] = count
            wanted = 0
            for n in range(start[row], start[row + 1]):
                near = count > 0.0 and pair[n, 9] * FINE <= high and pair[n, 10] * FINE >= low
                weight[n, block] = 1.0 if near else 0.0
                wanted += 1 if near else 0
            if wanted > 0:
                for i in range(BLOCK):
                    arrival = angle_of(tx[i], ty[i]) - agent[2, base + i]
                    departure = angle_of(wx[i], wy[i]) - facing
                    tx[i], wx[i] = arrival, departure
                for n in range(start[row], start[row + 1]):
                    if weight[n, block] > 0.0:
                        z0, z1, z2 = pair[n, 0], pair[n, 1], pair[n, 2]
                        i00, i11, i22 = pair[n, 3], pair[n, 4], pair[n, 5]
                        i01, i02, i12 = pair[n, 6], pair[n, 7], pair[n, 8]
                        total = 0.0
                        for i in range(BLOCK):
                            e0, e1, e2 = z0 - far[i], wrapped(z1 - wx[i]), wrapped(z2 - tx[i])
                            q = i00 * e0 * e0 + i11 * e1 * e1 + i22 * e2 * e2
                            q += 2 * (i01 * e0 * e1 + i02 * e0 * e2 + i12 * e1 * e2)
                            total += good[i] * exp_of(-0.5 * q)
                        weight[n, block] = total


@ti.kernel
def polylines(
    agent: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [2, R] x, y
    lines: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [3, S, R] normal x, y, offset
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 3] bounces, last, first
    place: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] anchor x, y
    corners: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [L, R, 4, 2] out: anchor, points, agent
    normals: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [L, R, 2, 2] out: normals of first and last
    valid: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, R] out: 1 or 0
):
    """Draw every path at every sampled state; an impossible path collapses onto the anchor."""
    for row, k in ti.ndrange(path.shape[0], agent.shape[1]):
        ax, ay, px, py = place[0], place[1], agent[0, k], agent[1, k]
        bounces, s, r = path[row, 0], path[row, 1], path[row, 2]
        for n in range(4):
            corners[row, k, n, 0], corners[row, k, n, 1] = px, py
        corners[row, k, 0, 0], corners[row, k, 0, 1] = ax, ay
        for n in range(2):
            normals[row, k, n, 0], normals[row, k, n, 1] = 1.0, 0.0
        ok = ti.cast(1.0, ti.f64)
        if bounces == 1:
            nx, ny, c = lines[0, s, k], lines[1, s, k], lines[2, s, k]
            vx, vy, _, _, good = single_bounce(px, py, ax, ay, nx, ny, c)
            here = nx * px + ny * py - c
            across = nx * vx + ny * vy
            t = -here / ti.select(ti.abs(across) < 1e-12, 1e-12, across)
            corners[row, k, 1, 0], corners[row, k, 1, 1] = px + t * vx, py + t * vy
            normals[row, k, 0, 0], normals[row, k, 0, 1] = nx, ny
            normals[row, k, 1, 0], normals[row, k, 1, 1] = nx, ny
            ok = good
        if bounces == 2:
            nx, ny, c = lines[0, s, k], lines[1, s, k], lines[2, s, k]
            mx, my, d = lines[0, r, k], lines[1, r, k], lines[2, r, k]
            vx, vy, ux, uy, good = double_bounce(px, py, ax, ay, nx, ny, c, mx, my, d)
            here, across = nx * px + ny * py - c, nx * vx + ny * vy
            t = -here / ti.select(ti.abs(across) < 1e-12, 1e-12, across)
            there, over = mx * ax + my * ay - d, mx * ux + my * uy
            f = -there / ti.select(ti.abs(over) < 1e-12, 1e-12, over)
            corners[row, k, 1, 0], corners[row, k, 1, 1] = ax + f * ux, ay + f * uy
            corners[row, k, 2, 0], corners[row, k, 2, 1] = px + t * vx, py + t * vy
            normals[row, k, 0, 0], normals[row, k, 0, 1] = mx, my
            normals[row, k, 1, 0], normals[row, k, 1, 1] = nx, ny
            ok = good
        for n in range(4):
            for side in range(2):
                value = corners[row, k, n, side]
                if not (ti.abs(value) < 1e4):
                    ok = 0.0
        if ok < 0.5:
            for n in range(4):
                corners[row, k, n, 0], corners[row, k, n, 1] = ax, ay
        valid[row, k] = ok
