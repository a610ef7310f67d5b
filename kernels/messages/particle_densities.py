"""Density of a snapshot at many particles of N paths each, by N x N algebra; docs/model.md, (M74), (M88).

No sum runs over samples: products of responses are looked up in tables over distance, cubics in each cell.
Complex numbers are matrices of two by two, but where all products of responses are real. Arrays are flat,
and LANES particles stand side by side, so that the compiler makes vectors of them.
"""

import taichi as ti

from gridslam.kernels.primitives.functions import logarithm_of
from gridslam.kernels.primitives.launching import quick

LANES = 8
"""Particles that are worked on side by side."""
OFTEN = 4
"""Rows of a root whose diagonals are multiplied before a logarithm is taken."""


@quick
@ti.kernel
def weigh_particles(
    sizes: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [6] N; D; 1 where products are real, else 2; cells S;
    # chunks C that threads take; blocks B of particles
    distance: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [B, N, LANES] in cells, from 0 to S
    root: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [B, N, LANES] of a path's power over the noise's
    gram: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2 S, 1 or 2, 4] products of two responses by difference
    # of distances, from -S
    table: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S, 1 or 2 rows, 2 or 1 products with the samples, and
    # D with directions in which there is more than noise, 4]
    work: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [C, 2 N + 2, D + 2 N, LANES] scratch
    density: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [B, LANES] out: log density but for a constant
):
    """Log density of the samples at each particle."""
    for chunk in range(sizes[4]):
        parts, rows, base = sizes[2], sizes[0] * sizes[2], sizes[1]
        wide = base + rows
        origin = chunk * (rows + 2) * wide
        for block in range(sizes[5] * chunk // sizes[4], sizes[5] * (chunk + 1) // sizes[4]):
            found, product = ti.Vector.zero(ti.f64, LANES), ti.Vector.one(ti.f64, LANES)
            for n in range(rows):
                look_up(sizes, block, n, origin, distance, root, table, work)
                correlate(sizes, block, n, origin, distance, root, gram, work)
                for k in range(n):
                    eliminate(n, k, origin, base, wide, work)
                sum_up(n, n, origin, base, wide, work)
                here = origin + n * wide + base + n
                for lane in ti.static(range(LANES)):
                    product[lane] *= work[LANES * here + lane]
                    work[LANES * here + lane] = 1 / ti.sqrt(work[LANES * here + lane])
                if n % OFTEN == OFTEN - 1 or n == rows - 1:
                    for lane in ti.static(range(LANES)):
                        found[lane] -= logarithm_of(product[lane]) / parts
                        product[lane] = 1.0
            for side in range(3 - parts):
                for k in range(rows):
                    eliminate(rows + side, k, origin, base, wide, work)
                    here = origin + (rows + side) * wide + base + k
                    for lane in ti.static(range(LANES)):
                        found[lane] += work[LANES * here + lane] * work[LANES * here + lane]
            for lane in ti.static(range(LANES)):
                density[LANES * block + lane] = found[lane]


@ti.func
def look_up(
    sizes: ti.template(), block, n, origin, distance: ti.template(), root: ti.template(),
    table: ti.template(), work: ti.template(),
):  # fmt: skip
    """A row's products with all directions, and with the samples, behind all rows."""
    parts, base = sizes[2], sizes[1]
    wide, samples = base + sizes[0] * parts, 3 - parts
    first, row = block * sizes[0] + n // parts, ti.Vector.zero(ti.i32, LANES)
    share, scale = ti.Vector.zero(ti.f64, LANES), ti.Vector.zero(ti.f64, LANES)
    for lane in ti.static(range(LANES)):
        at = distance[LANES * first + lane]
        row[lane] = (ti.cast(at, ti.i32) * parts + n % parts) * (samples + base)
        share[lane] = at - ti.cast(at, ti.i32)
        scale[lane] = root[LANES * first + lane]
    for i in range(samples + base):
        place = origin + n * wide + i - samples
        if i < samples:
            place = origin + (sizes[0] * parts + i) * wide + base + n
        one = ti.Vector.zero(ti.f64, LANES)
        for lane in ti.static(range(LANES)):
            one[lane] = scale[lane] * cubic(table, 4 * (row[lane] + i), share[lane])
        for lane in ti.static(range(LANES)):
            work[LANES * place + lane] = one[lane]


@ti.func
def correlate(
    sizes: ti.template(), block, n, origin, distance: ti.template(), root: ti.template(),
    gram: ti.template(), work: ti.template(),
):  # fmt: skip
    """A row's products with those before it, as if there were noise alone, and with itself."""
    parts, base = sizes[2], sizes[1]
    own = block * sizes[0] + n // parts
    start = origin + n * (base + sizes[0] * parts) + base
    for k in range(n):
        other, part, sign = block * sizes[0] + k // parts, (n % parts) ^ (k % parts), 1.0
        if n % parts < k % parts:
            sign = -1.0
        one = ti.Vector.zero(ti.f64, LANES)
        for lane in ti.static(range(LANES)):
            at = distance[LANES * other + lane] - distance[LANES * own + lane] + sizes[3]
            cell = ti.cast(at, ti.i32)
            scale = sign * root[LANES * own + lane] * root[LANES * other + lane]
            one[lane] = scale * cubic(gram, 4 * (cell * parts + part), at - cell)
        for lane in ti.static(range(LANES)):
            work[LANES * (start + k) + lane] = one[lane]
    for lane in ti.static(range(LANES)):
        work[LANES * (start + n) + lane] = 1 + root[LANES * own + lane] ** 2


@ti.func
def cubic(table: ti.template(), first, share):
    """A cell's cubic."""
    return table[first] + share * (table[first + 1] + share * (table[first + 2] + share * table[first + 3]))


@ti.func
def eliminate(n, k, origin, base, wide, work: ti.template()):
    """Entry k of a row of the root."""
    sum_up(n, k, origin, base, wide, work)
    here, inverse = origin + n * wide + base + k, origin + k * wide + base + k
    for lane in ti.static(range(LANES)):
        work[LANES * here + lane] *= work[LANES * inverse + lane]


@ti.func
def sum_up(n, k, origin, base, wide, work: ti.template()):
    """Take from a row's entry k what entries before it explain."""
    mine, other = origin + n * wide, origin + k * wide
    left = ti.Vector.zero(ti.f64, LANES)
    for lane in ti.static(range(LANES)):
        left[lane] = work[LANES * (mine + base + k) + lane]
    for i in range(ti.select(n < wide - base, 0, base), base + k):
        for lane in ti.static(range(LANES)):
            left[lane] -= work[LANES * (mine + i) + lane] * work[LANES * (other + i) + lane]
    for lane in ti.static(range(LANES)):
        work[LANES * (mine + base + k) + lane] = left[lane]
