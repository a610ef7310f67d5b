"""Reflection coefficients where rays meet walls: what cells and surfaces believe, and what they learn."""

import taichi as ti

from gridslam.kernels.bundles import cell_of
from gridslam.kernels.functions import decay_of
from gridslam.kernels.launching import quick

BINS = 20
"""Bins of a coefficient's belief; products of two have twice as many nodes."""


@ti.func
def local_belief(
    drawn: ti.template(), path: ti.template(), held: ti.template(), surface: ti.template(),
    frame: ti.template(), row, rays, corner, number,
):  # fmt: skip
    """Belief over the coefficient at a hit: the surface's, the cell's own, and room for a surprise."""
    at = ti.Vector([0.0] * BINS, dt=ti.f64)
    inside, per_metre = 0, 1 / frame[2]
    for k in range(row * rays, (row + 1) * rays):
        ix = cell_of(drawn[k, 2 * corner], frame[0], per_metre)
        iy = cell_of(drawn[k, 2 * corner + 1], frame[1], per_metre)
        if ix >= 0 and iy >= 0 and ix < held.shape[1] and iy < held.shape[0]:
            inside += 1
            for n in range(BINS):
                at[n] += held[iy, ix, n]
    most, total = ti.cast(-1e300, ti.f64), ti.cast(0.0, ti.f64)
    for n in range(BINS):
        at[n] /= ti.max(inside, 1)
        most = ti.max(most, at[n])
    for n in range(BINS):
        at[n] = surface[number, n] * decay_of(at[n] - most)
        total += at[n]
    for n in range(BINS):
        own = at[n] / total if total > 1e-12 else 1 / ti.cast(BINS, ti.f64)
        at[n] = (1 - frame[3]) * own + frame[3] / BINS
    return at


@quick
@ti.kernel
def recall(
    drawn: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L R, 14] as cast
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 4] bounces, last, first, anchor
    held: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [ny, nx, BINS] log-likelihood that cells hold
    surface: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [S, BINS] beliefs of surfaces
    frame: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [4] origin x, y, side; share of another material
    belief: ti.types.ndarray(
        dtype=ti.f64, ndim=2
    ),  # [L, 2 BINS] out: over products; node n is (n + 1) / 2 BINS
):
    """Belief over the product of the coefficients along every path (paper 003, eq. (2))."""
    ti.loop_config(serialize=True)
    for row in range(path.shape[0]):
        bounces, nodes = path[row, 0], 2 * BINS
        rays = drawn.shape[0] // path.shape[0]
        for n in range(nodes):
            belief[row, n] = 0.0
        if bounces == 0:
            belief[row, nodes - 1] = 1.0
        elif bounces == 1:
            last = local_belief(drawn, path, held, surface, frame, row, rays, 1, path[row, 1])
            for n in range(BINS):
                belief[row, 2 * n] = last[n]
        else:
            first = local_belief(drawn, path, held, surface, frame, row, rays, 1, path[row, 2])
            last = local_belief(drawn, path, held, surface, frame, row, rays, 2, path[row, 1])
            for i in range(BINS):
                for j in range(BINS):  # the product of two bins' centres lies between two nodes
                    place = ti.cast((2 * i + 1) * (2 * j + 1), ti.f64) / (2 * BINS) - 1
                    low = ti.max(0, ti.min(ti.cast(ti.floor(place), ti.i32), nodes - 2))
                    part = ti.max(0.0, ti.min(place - low, 1.0))
                    both, under, over = last[i] * first[j], belief[row, low], belief[row, low + 1]
                    belief[row, low] = under + (1 - part) * both
                    belief[row, low + 1] = over + part * both


@quick
@ti.kernel
def learn(
    drawn: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L R, 14] as cast
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 4] bounces, last, first, anchor
    where: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [N, 2] path and corner that news are of
    factor: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, BINS] log-likelihood over the coefficient there
    frame: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [4] as above
    held: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [ny, nx, BINS] in/out
):
    """Add log-likelihoods to the cells that the rays of a path meet, shared among its rays."""
    ti.loop_config(serialize=True)
    for n in range(where.shape[0]):
        row, corner, per_metre = where[n, 0], where[n, 1], 1 / frame[2]
        rays = drawn.shape[0] // path.shape[0]
        for k in range(row * rays, (row + 1) * rays):
            ix = cell_of(drawn[k, 2 * corner], frame[0], per_metre)
            iy = cell_of(drawn[k, 2 * corner + 1], frame[1], per_metre)
            if ix >= 0 and iy >= 0 and ix < held.shape[1] and iy < held.shape[0]:
                for b in range(BINS):
                    before = held[iy, ix, b]
                    held[iy, ix, b] = before + factor[n, b] / rays
