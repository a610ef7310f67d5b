"""Density of a snapshot at many particles of N paths each, by N x N algebra; docs/model.md, (M74), (M88).

No sum runs over samples: products of responses are polynomials of where a particle's paths lie in the stretch
that all particles cover. Complex numbers are matrices of two by two, but where all products of responses are
real. LANES particles stand side by side, and rows go in pairs, so that what is loaded serves twice.

What keeps the compiler at vectors of lanes: sums are multiplied by a 1 that it doesn't know, or it would make
vectors of the turns of their loops; numbers of entries are cut to so many bits, or it wouldn't see that lanes
lie side by side; and what is stored goes into a sum in the same turn, too (squares of rows, products of
pivots), for what is stored alone is worked out lane by lane, between looks for where the array lies.
"""

import taichi as ti

from gridslam.kernels.primitives.launching import quick

LANES = 16
"""Particles that are worked on side by side."""
PIVOTS = 8
"""Rows of a root whose pivots are multiplied before their logarithm is taken."""
FEW, MANY = 0xFFFF, 0xFFFFFF
"""Bits of numbers of rows, and of entries."""
Side = ti.types.vector(LANES, ti.f64)


@quick
@ti.kernel
def weigh_particles(
    sizes: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [7] N, even where products are real; D; parts, 1 where
    # products are real, else 2; terms K and L; chunks C that threads take; blocks B of particles
    true: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [1] 1
    offset: ti.types.ndarray(dtype=Side, ndim=1),  # [N + 2 / parts, B] places in the stretch, from -1 to 1;
    # after the paths 0, for the samples
    power: ti.types.ndarray(dtype=Side, ndim=1),  # [N, B] of a path over the noise's, above 0
    product: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N + 2 / parts, N, parts, L] of two responses by how
    # much farther the second lies; then of a response with the samples (real and imaginary part, if parts
    # is 1) by where it lies
    rows: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N parts, D, K] of a response with directions in which
    # there is more than noise
    work: ti.types.ndarray(dtype=Side, ndim=1),  # [C, N parts + 2, D + N parts] scratch
    explained: ti.types.ndarray(dtype=Side, ndim=1),  # [B] out: power of the samples that the paths explain
    pivots: ti.types.ndarray(dtype=Side, ndim=1),  # [N parts / PIVOTS, B] out: 1 over products of pivots
):
    """Root of the paths' covariance in their own space, and the samples solved by it, at each particle.

    All rows are over the root of their path's power, which is left in the diagonal alone: (M74), R^-1 A R^-1.
    """
    for chunk in range(sizes[5]):
        count, base = (sizes[0] * sizes[2]) & FEW, sizes[1] & FEW
        wide, same = (base + count) & FEW, true[0]
        start = (chunk * (count + 2) * wide) & MANY
        for block in range(sizes[6] * chunk // sizes[5], sizes[6] * (chunk + 1) // sizes[5]):
            pivot = ti.Vector.one(ti.f64, LANES)
            found = zeros()
            for pair in range((count // 2 + 1) & FEW):  # the last one are the samples
                n = 2 * pair
                here, first = (start + n * wide) & MANY, base
                own_aa, own_ba, own_bb = zeros(), zeros(), zeros()
                if n < count:
                    first = 0
                    for i in range(base):
                        a = along(sizes, block, n, i, offset, rows)
                        b = along(sizes, block, n + 1, i, offset, rows)
                        own_aa = same * own_aa + a * a
                        own_ba = same * own_ba + a * b
                        own_bb = same * own_bb + b * b
                        work[here + i] = a
                        work[here + wide + i] = b
                for before in range(pair):
                    k = 2 * before
                    aa = correlated(sizes, block, n, k, offset, product)
                    ab = correlated(sizes, block, n, k + 1, offset, product)
                    ba = correlated(sizes, block, n + 1, k, offset, product)
                    bb = correlated(sizes, block, n + 1, k + 1, offset, product)
                    there = (start + k * wide) & MANY
                    for i in range(first, (base + k) & FEW):
                        a, b = work[here + i], work[here + wide + i]
                        c, d = work[there + i], work[there + wide + i]
                        aa = same * aa - a * c
                        ab = same * ab - a * d
                        ba = same * ba - b * c
                        bb = same * bb - b * d
                    there += base + k
                    c, d, slant = work[there], work[there + wide + 1], work[there + wide]
                    aa *= c
                    ba *= c
                    ab = (ab - aa * slant) * d
                    bb = (bb - ba * slant) * d
                    own_aa = same * own_aa + (aa * aa + ab * ab)
                    own_ba = same * own_ba + (aa * ba + ab * bb)
                    own_bb = same * own_bb + (ba * ba + bb * bb)
                    at = here + base + k
                    work[at] = aa
                    work[at + wide] = ba
                    work[at + 1] = ab
                    work[at + wide + 1] = bb
                if n < count:
                    c, d = 1 / power[entry(sizes, block, n)], 1 / power[entry(sizes, block, n + 1)]
                    ba = correlated(sizes, block, n + 1, n, offset, product) - own_ba
                    one = 1 / ti.sqrt(1 + c - own_aa)
                    ba *= one
                    two = 1 / ti.sqrt(1 + d - own_bb - ba * ba)
                    pivot *= (one * one * c) * (two * two * d)
                    at = here + base + n
                    work[at] = one
                    work[at + wide] = ba
                    work[at + wide + 1] = two
                    if n % PIVOTS == PIVOTS - 2 or n == count - 2:
                        pivots[n // PIVOTS * sizes[6] + block] = pivot
                        pivot = ti.Vector.one(ti.f64, LANES)
                else:
                    found = own_aa + own_bb
            explained[block] = found


@ti.func
def zeros():
    """A number for each lane."""
    return ti.Vector.zero(ti.f64, LANES)


@ti.func
def along(sizes: ti.template(), block, n, i, offset: ti.template(), rows: ti.template()):
    """Product of a row with a direction."""
    path, first = entry(sizes, block, n), ((n * (sizes[1] & FEW) + i) * sizes[3]) & MANY
    return series(rows, first, sizes[3], offset[path])


@ti.func
def correlated(sizes: ti.template(), block, n, k, offset: ti.template(), product: ti.template()):
    """Product of two rows, as if there were noise alone."""
    shift, terms = sizes[2] - 1, sizes[4]
    mine, other, part, sign = n >> shift, k >> shift, (n ^ k) & shift, 1.0
    if n & shift < k & shift:
        sign = -1.0
    one, two = entry(sizes, block, n), entry(sizes, block, k)
    first = (((mine * sizes[0] + other) * sizes[2] + part) * terms) & MANY
    return sign * series(product, first, terms, offset[two] - offset[one])


@ti.func
def entry(sizes: ti.template(), block, n):
    """Where a row's path stands of a block."""
    return ((n >> (sizes[2] - 1)) * sizes[6] + block) & MANY


@ti.func
def series(table: ti.template(), first, terms, at):
    """A polynomial, the highest power first."""
    value = zeros()
    for j in range(terms & FEW):
        value = value * at + table[first + j]
    return value
