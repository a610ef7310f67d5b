"""Histograms of rays' amplitudes: prediction and update, [Li2025adaptive]; docs/model.md, (M43), (M44)."""

import taichi as ti

from gridslam.kernels.primitives.functions import decay_of, logarithm_of
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.radio import log_rician
from gridslam.kernels.primitives.tables import AMPLITUDE

NODES, GAP, STAY, RISE, FALL, SILENT = 0, 1, 2, 3, 4, 5
"""Rows of a table over the nodes: amplitudes; shares of a flat density; probability that a walking amplitude
stays, goes to the next node, or to the one before; that it isn't detected."""
FINE, RATIO, AT_1M, P_STAY, P_APPEAR, SURPRISE, LEVEL, WEAKENED = 0, 1, 2, 3, 4, 5, 6, 7
"""Places of numbers: nodes are ``FINE sinh(RATIO (n + 1))``; amplitude at 1 m; probabilities that a ray stays
and that it appears; weight of any amplitude at all; deviation of a line of sight's amplitude about that of
free space, as a share of it, and share of those that something weakens."""
CLAIMED = 1e-3
"""Sum over the paths of their responsibility from which on a measurement is looked at."""


@ti.func
def rescale(
    weights: ti.template(), row, factor, number: ti.template(), table: ti.template(), out: ti.template()
):
    """Write what a histogram is where amplitudes are `factor` times what they were."""
    last = weights.shape[1] - 1
    for n in range(last + 1):
        out[n] = 0.0
    for n in range(last + 1):
        x = factor * table[NODES, n] / number[FINE]
        place = logarithm_of(x + ti.sqrt(x * x + 1)) / number[RATIO] - 1
        place = ti.max(0.0, ti.min(place, ti.cast(last, ti.f64)))
        below = ti.min(ti.cast(place, ti.i32), last - 1)
        above = weights[row, n] * (place - below)
        before, after = out[below], out[below + 1]
        out[below], out[below + 1] = before + weights[row, n] - above, after + above


@ti.func
def of_free_space(row, length: ti.template(), number: ti.template(), table: ti.template(), n):
    """Density at a node, not normalised, of the amplitude that free space makes of a line of sight."""
    far = ti.max(length[1, row], 1e-3)
    level = ti.min(number[AT_1M] / far, table[NODES, table.shape[1] - 1])
    doubt = length[3, row] / far
    deviation = level * ti.sqrt(number[LEVEL] * number[LEVEL] + doubt * doubt) + number[FINE] * number[RATIO]
    gap = (table[NODES, n] - level) / deviation
    return table[GAP, n] * decay_of(-0.5 * gap * gap)


@quick
@ti.kernel
def walk(
    earlier: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, K] histograms as they were
    length: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [4, L] paths' then, negative for none; now; at least;
    # deviation of that now, of lines of sight, negative for what is reflected
    existence: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [L] predicted, of the rays
    table: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [6, K] see `NODES`
    number: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [8] see `FINE`
    scratch: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [K]
    ahead: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, K] out: histograms one step ahead, (M43)
):
    """Let amplitudes walk, about what free space makes of a path's new length; rays may appear."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        last = ahead.shape[1] - 1
        for row in range(ahead.shape[0]):
            far = ti.max(length[1, row], 1e-3)
            near = ti.max(length[2, row], 1e-3)
            reach = ti.max(ti.min(number[AT_1M] / near, table[NODES, last]), 2 * table[NODES, 0])
            total, free, there, chance = ti.f64(0.0), ti.f64(0.0), existence[row], number[P_APPEAR]
            any_level = number[WEAKENED] if length[3, row] >= 0 else 1.0
            for n in range(last + 1):
                total += table[GAP, n] if table[NODES, n] <= reach else 0.0
                density = of_free_space(row, length, number, table, n) if any_level < 1 else 0.0
                ahead[row, n] = density
                free += density
            share = ti.f64(1.0)  # of a ray that appears: any amplitude up to that, or free space's
            if length[0, row] >= 0:
                rescale(earlier, row, length[0, row] / far, number, table, scratch)
                before = ti.max(0.0, ti.min((there - chance) / (number[P_STAY] - chance), 1.0))
                share = chance * (1 - before) / ti.max(there, 1e-12)
            for n in range(last + 1):
                fresh = any_level * table[GAP, n] / total if table[NODES, n] <= reach else 0.0
                if any_level < 1:
                    density = ahead[row, n]
                    fresh += (1 - any_level) * density / free
                ahead[row, n] = share * fresh
            for n in range(last + 1 if share < 1 else 0):
                walked = scratch[n] * table[STAY, n]
                if n > 0:
                    walked += scratch[n - 1] * table[RISE, n - 1]
                if n < last:
                    walked += scratch[n + 1] * table[FALL, n + 1]
                so_far = ahead[row, n]
                ahead[row, n] = so_far + (1 - share) * walked


@quick
@ti.kernel
def listen(
    ahead: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, K] histograms before the update
    scan: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 9] see `AnchorScan.table`
    responsible: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] probability that path caused measurement
    table: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [6, K] see `NODES`
    number: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [6] see `FINE`
    samples: ti.f64,  # of the radio
    density: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, K] scratch
    after: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, K] out
):
    """Update by the measurements, softly by association, [Li2025adaptive], eq. (26)."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        paths, last = ahead.shape[0], ahead.shape[1] - 1
        for m in range(scan.shape[0]):
            mass, most = ti.f64(0.0), ti.f64(-1e30)
            for row in range(paths):
                mass += responsible[row, m]
            if mass > CLAIMED:
                audible = ti.min(scan[m, AMPLITUDE], table[NODES, last])
                for n in range(last + 1):
                    density[m, n] = log_rician(audible, table[NODES, n], samples) if audible > 0 else 0.0
                    most = ti.max(most, density[m, n])
                for n in range(last + 1):
                    log = density[m, n]
                    density[m, n] = decay_of(log - most)
            else:
                density[m, 0] = -1.0  # looked at by nobody
        for row in range(paths):
            silent, missed = ti.f64(0.0), ti.f64(1.0)
            for n in range(last + 1):
                silent += (ahead[row, n] + number[SURPRISE] * table[GAP, n]) * table[SILENT, n]
            for m in range(scan.shape[0]):
                missed -= responsible[row, m]
            missed = ti.max(missed, 0.0) / silent
            for n in range(last + 1):
                prior = ahead[row, n] + number[SURPRISE] * table[GAP, n]
                after[row, n] = missed * prior * table[SILENT, n]
            for m in range(scan.shape[0]):
                if density[m, 0] >= 0 and responsible[row, m] > 0:
                    likelihood = ti.f64(0.0)
                    for n in range(last + 1):
                        likelihood += (ahead[row, n] + number[SURPRISE] * table[GAP, n]) * density[m, n]
                    part = responsible[row, m] / likelihood
                    for n in range(last + 1):
                        prior, so_far = ahead[row, n] + number[SURPRISE] * table[GAP, n], after[row, n]
                        after[row, n] = so_far + part * prior * density[m, n]
            total = ti.f64(0.0)
            for n in range(last + 1):
                total += after[row, n]
            for n in range(last + 1):
                so_far = after[row, n]
                after[row, n] = so_far / ti.max(total, 1e-12)
