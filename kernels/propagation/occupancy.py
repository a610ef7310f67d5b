"""Beliefs of cells: fold messages in; occupancy in both roles of a cell; docs/model.md, (M35), (M40)."""

import taichi as ti

from gridslam.kernels.primitives.device import ON_CPU
from gridslam.kernels.primitives.functions import exp_of
from gridslam.kernels.primitives.launching import quick

CROSSED_LEAST, HIT_LEAST, MOST = 1e-4, 1e-3, 0.99
"""Bounds of a cell's occupancy in the roles of being crossed and of being hit."""
FREE = 1e-6
"""Occupancy next to an anchor."""
CELL_BITS = 6
CELLS = 1 << CELL_BITS
"""Cells that are taken at a time; without a message to any of them, they stay as they are."""
TOUCHED = 0.01
"""Message from which on a cell counts as observed; what leaks through a wall's last doubt is fainter."""


@ti.func
def probability_of(odds):
    """Probability by its log odds, in single precision."""
    rest = exp_of(-ti.abs(odds))
    return ti.select(odds > 0, 1.0, rest) / (1 + rest)


@quick
@ti.kernel
def fold_messages(
    message: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [SLABS, N] sums of log ratios; 0 afterwards
    news: ti.types.ndarray(dtype=ti.u8, ndim=2),  # [SLABS, groups of CELLS] whether there are any; 0 after
    before: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] evidence: log odds without the prior
    clear: ti.types.ndarray(dtype=ti.u8, ndim=1),  # [N] whether the cell is next to an anchor
    every: ti.i32,  # whether occupancy is worked out without messages, too
    prior: ti.f64,  # log odds of a cell in the role of being crossed
    clip: ti.f64,
    evidence: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] out
    observed: ti.types.ndarray(dtype=ti.u8, ndim=1),  # [N] in/out
    occupied: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [2, N] in/out: o of a traversed cell, of a hit one
):
    """Fold the messages of all paths into the cells' evidence, [Li2026grid], eq. (46)."""
    shift = ti.cast(prior, ti.f32)
    ti.loop_config(serialize=ON_CPU)
    for group in range(news.shape[1]):
        first, messages = group * CELLS, every
        live = ti.min(CELLS, before.shape[0] - first)
        for slab in range(message.shape[0]):
            messages += ti.cast(news[slab, group], ti.i32)
        if messages == 0:
            for i in range(live):
                evidence[first + i] = before[first + i]
        else:
            total, odds = ti.Vector([0.0] * CELLS, dt=ti.f64), ti.Vector([0.0] * CELLS)
            crossed, hit = ti.Vector([0.0] * CELLS), ti.Vector([0.0] * CELLS)
            for slab in range(message.shape[0]):
                if news[slab, group] > 0:
                    for i in range(live):
                        total[i] += message[slab, first + i]
                    for i in range(live):
                        message[slab, first + i] = 0.0
                    news[slab, group] = ti.cast(0, ti.u8)
            for i in range(live):
                after = ti.max(-clip, ti.min(before[first + i] + total[i], clip))
                evidence[first + i], odds[i] = after, ti.cast(after, ti.f32)
                so_far = observed[first + i]
                observed[first + i] = ti.select(ti.abs(total[i]) > TOUCHED, ti.cast(1, ti.u8), so_far)
            for i in range(CELLS):  # on the stack, so that it vectorises
                crossed[i] = probability_of(odds[i] + shift)
                hit[i] = probability_of(odds[i])
            for i in range(live):
                near = clear[first + i] > 0
                o = ti.max(CROSSED_LEAST, ti.min(crossed[i], MOST))
                occupied[0, first + i] = ti.select(near, FREE, o)
                h = ti.max(HIT_LEAST, ti.min(hit[i], MOST))
                occupied[1, first + i] = ti.select(near, FREE, h)
