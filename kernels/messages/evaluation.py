"""Measurement evaluation: measurements under every path of one anchor, or of all; docs/model.md, (M23)."""

import taichi as ti

from gridslam.kernels.messages.association import enter
from gridslam.kernels.messages.gating import gate
from gridslam.kernels.primitives.device import SPREAD, TASKS
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.particles import BLOCK, draw_block
from gridslam.kernels.propagation.amplitudes import weigh
from gridslam.kernels.propagation.paths import densities


@quick
@ti.kernel
def evaluate(
    belief: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, K] of every path's amplitude over the nodes
    nodes: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [K] amplitudes, or those at 1 m
    spreading: ti.f64,  # 1 if amplitudes fall with the path's length, else 0
    predicted: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, 13] value, spread and length of every path
    heard: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 10] see `AnchorScan.table`
    chance: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [T] p_d over ``0, step, ...``
    step: ti.f64,
    radio: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 11] see `radio`
    head: ti.i32,  # entry of the belief where the lines begin: see `layout`
    kept: ti.f64,  # bandwidth: share of the belief's covariance
    root: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [N, N] of the covariance, lower triangular
    base: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [N, 3] mean, and its cosine and sine
    points: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [N or more, P or more] standard normal
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 4] bounces, last, first, anchor
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 3] anchors: x, y, orientation
    density: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [2, M, K] scratch
    strength: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [2, L, M] scratch: amplitude's ratio to clutter; mean
    table: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [L M, 11] scratch: z, inverse (6), nearest, farthest
    odds: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [12, L] in/out: see `tables`; three are given
    start: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [L + 1] out: where the pairs of each path begin
    index: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L M, 2] out: path and measurement
    pair: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L M, 8] out: z, variances, density, determinant
    state: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [3 + 3 S (+ J), P] out: see `layout`
    blocks: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [L + L M, P / BLOCK] out: by blocks of particles, at
    # how many each path is possible; sums of each pair's densities
    message: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [5, L, M] out: the first two of `tables`
    measured: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [4, M] out: the first two
):
    """Pick the pairs that may belong together, draw the particles, and evaluate pairs and paths at them."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        weigh(belief, nodes, spreading, path, predicted, heard, chance, step, radio, density, strength, odds)
        gate(path, predicted, heard, radio, kept, odds, strength, start, index, pair, table, measured)
    for item in range(ti.min(blocks.shape[1], TASKS) * SPREAD):
        if item % SPREAD == 0:
            share = (blocks.shape[1] + TASKS - 1) // TASKS
            first = item // SPREAD * share
            for block in range(first, ti.min(first + share, blocks.shape[1])):
                draw_block(block * BLOCK, head, root, base, points, state)
                densities(block, head, state, path, places, start, table, blocks)
    ti.loop_config(serialize=True)
    for _ in range(1):
        enter(blocks, start, index, pair, odds, message, measured)
