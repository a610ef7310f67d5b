"""Measurement evaluation: measurements under every path of one anchor, or of all; docs/model.md, (M23).

Which measurements may have come from which paths is found first, then each such pair is evaluated.
"""

import taichi as ti

from gridslam.kernels import FAINTEST, UNMEASURED
from gridslam.kernels.messages.association import enter
from gridslam.kernels.primitives.blocks import Amplitudes, Anchors, Drawing, Gating, Pairs, PathRows, Ratios
from gridslam.kernels.primitives.corrections import inverse_of
from gridslam.kernels.primitives.device import SPREAD, TASKS
from gridslam.kernels.primitives.functions import ROOT_TURN, wrapped
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.layout import HEIGHT
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.particles import BLOCK, draw_block
from gridslam.kernels.primitives.radio import SENDER, SPAN, deviations_of, lean_of
from gridslam.kernels.primitives.tables import (
    ANCHOR,
    AOA,
    AOD,
    AS_CLUTTER,
    COVARIANCE,
    DENSITY,
    DETERMINANT,
    DISTANCE,
    FARTHEST,
    INVERSE,
    LABEL,
    LENGTH,
    NEAREST,
    OWN_STD,
    PATH_ROW,
    QUIET,
    SCAN_ROW,
    VARIANCE,
)
from gridslam.kernels.propagation.amplitudes import NEGLIGIBLE, prior_existence, weigh
from gridslam.kernels.propagation.paths import densities

GATE = 6.0
"""Deviations within reach."""
MARGIN_M, MARGIN_RAD = 0.3, 0.3
"""Widening of the gate for what the linearised spread doesn't tell."""
LEAST_STD = 1e-6


@ti.func
def gate(
    rows: ti.template(), scan: ti.template(), places: ti.template(), radio: ti.template(), bandwidth,
    scratch: ti.template(), pairs: ti.template(), ratios: ti.template(),
):  # fmt: skip
    """Pick the pairs whose distance and angles lie within reach of what is predicted, path by path.

    What one anchor is known to have sent belongs to none of the others' paths. `scratch.strength` is as
    `amplitudes.weigh` leaves it; arguments: see `evaluate`.
    """
    known = 0
    for m in range(scan.shape[0]):
        ratios.measured[QUIET, m] = scan[m, AS_CLUTTER]
    pairs.start[0] = 0
    for row in range(rows.predicted.shape[0]):
        anchor = rows.path[row, ANCHOR]
        for m in range(scan.shape[0]):
            ratio = scratch.strength[0, row, m]
            own = scan[m, LABEL] < 0 or scan[m, LABEL] == radio[anchor, SENDER]
            if own and ratio > 0 and prior_existence(ratios.odds, row) > NEGLIGIBLE:
                amplitude = ti.max(scratch.strength[1, row, m], FAINTEST)
                lean = lean_of(rows.predicted[row, LENGTH], places[anchor, HEIGHT])
                std = deviations_of(
                    radio, anchor, amplitude, rows.predicted[row, AOD], rows.predicted[row, AOA], lean
                )
                near, absent = True, ti.f64(1.0)
                variance = ti.Vector([0.0, 0.0, 0.0], dt=ti.f64)
                for q in ti.static(range(3)):
                    given, gap = scan[m, OWN_STD + q], ti.f64(0.0)
                    if given > 0:
                        std[q] = given
                    if given >= 0:
                        gap = scan[m, q] - rows.predicted[row, q]
                        if ti.static(q > 0):
                            gap = wrapped(gap)
                    variance[q] = ti.max(std[q], LEAST_STD) ** 2
                    if given < 0 or variance[q] >= UNMEASURED:
                        # a factor left out on both sides: its clutter density cancels
                        flat = radio[anchor, SPAN] if ti.static(q == 0) else ROOT_TURN * ROOT_TURN
                        absent *= ROOT_TURN * ti.sqrt(ti.cast(UNMEASURED, ti.f64)) / flat
                        variance[q] = UNMEASURED
                        std[q] = 0.0
                    reach = GATE * ti.sqrt(rows.predicted[row, COVARIANCE + 4 * q] + std[q] * std[q])
                    reach += MARGIN_M if ti.static(q == 0) else MARGIN_RAD
                    if not (ti.abs(gap) < reach):
                        near = False
                if near:
                    total = ti.Matrix.zero(ti.f64, 3, 3)
                    for i in ti.static(range(3)):
                        for j in ti.static(range(3)):
                            total[i, j] = bandwidth * rows.predicted[row, COVARIANCE + 3 * i + j]
                        total[i, i] += variance[i]
                    inverse, determinant = inverse_of(total)
                    reach = ti.min(GATE * ti.sqrt(total[0, 0]), 1e5)
                    pairs.index[known, PATH_ROW], pairs.index[known, SCAN_ROW] = row, m
                    for q in ti.static(range(3)):
                        pairs.pair[known, q], pairs.pair[known, VARIANCE + q] = scan[m, q], variance[q]
                        scratch.table[known, q] = ti.cast(scan[m, q], ti.f32)
                    pairs.pair[known, DENSITY] = ratio * absent
                    pairs.pair[known, DETERMINANT] = determinant
                    scratch.table[known, INVERSE] = ti.cast(inverse[0, 0], ti.f32)
                    scratch.table[known, INVERSE + 1] = ti.cast(inverse[1, 1], ti.f32)
                    scratch.table[known, INVERSE + 2] = ti.cast(inverse[2, 2], ti.f32)
                    scratch.table[known, INVERSE + 3] = ti.cast(inverse[0, 1], ti.f32)
                    scratch.table[known, INVERSE + 4] = ti.cast(inverse[0, 2], ti.f32)
                    scratch.table[known, INVERSE + 5] = ti.cast(inverse[1, 2], ti.f32)
                    scratch.table[known, NEAREST] = ti.cast(ti.max(scan[m, DISTANCE] - reach, -1e5), ti.f32)
                    scratch.table[known, FARTHEST] = ti.cast(scan[m, DISTANCE] + reach, ti.f32)
                    known += 1
        pairs.start[row + 1] = known


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
