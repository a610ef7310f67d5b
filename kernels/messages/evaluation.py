"""Measurement evaluation: measurements under every path of one anchor, or of all; docs/model.md, (M23)."""

import taichi as ti

from gridslam.kernels.messages.association import enter
from gridslam.kernels.messages.gating import gate
from gridslam.kernels.primitives.blocks import Amplitudes, Anchors, Drawing, Gating, Pairs, PathRows, Ratios
from gridslam.kernels.primitives.device import SPREAD, TASKS
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.particles import BLOCK, draw_block
from gridslam.kernels.propagation.amplitudes import weigh
from gridslam.kernels.propagation.paths import densities


@quick
@ti.kernel
def evaluate(
    spreading: ti.f64,  # 1 if amplitudes fall with the path's length, else 0
    step: ti.f64,  # of the table of p_d
    head: ti.i32,  # entry of the belief where the lines begin: see `layout`
    bandwidth: ti.f64,  # bandwidth: share of the belief's covariance
    amplitudes: pack(Amplitudes),
    rows: pack(PathRows),
    scan: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 10] see `AnchorScan.table`
    anchors: pack(Anchors),
    drawing: pack(Drawing),
    scratch: pack(Gating),
    pairs: pack(Pairs),  # out
    ratios: pack(Ratios),  # in and out: three of `odds` are given
):
    """Pick the pairs that may belong together, draw the particles, and evaluate pairs and paths at them."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        weigh(amplitudes, spreading, step, rows, scan, anchors.radio, scratch, ratios.odds)
        gate(rows, scan, anchors.places, anchors.radio, bandwidth, scratch, pairs, ratios)
    for item in range(ti.min(pairs.blocks.shape[1], TASKS) * SPREAD):
        if item % SPREAD == 0:
            share = (pairs.blocks.shape[1] + TASKS - 1) // TASKS
            first = item // SPREAD * share
            for block in range(first, ti.min(first + share, pairs.blocks.shape[1])):
                draw_block(block * BLOCK, head, drawing.root, drawing.base, drawing.points, drawing.state)
                densities(
                    block, head, drawing.state, rows.path, anchors.places, pairs.start, scratch.table,
                    ratios.odds, pairs.blocks,
                )  # fmt: skip
    ti.loop_config(serialize=True)
    for _ in range(1):
        enter(
            pairs.blocks, pairs.start, pairs.index, pairs.pair, ratios.odds, ratios.message, ratios.measured
        )
