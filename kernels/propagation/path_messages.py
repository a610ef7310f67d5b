"""Messages of an anchor's paths to coefficients and cells, appended to those of other anchors."""

import taichi as ti

from gridslam.kernels import LEAST_SENDING
from gridslam.kernels.primitives.tables import (
    AMPLITUDE,
    CHANCE,
    EXISTENCE,
    LENGTH,
    MESSAGE,
    SCAN_ROW,
    SENDS,
    SURFACES,
    WORTH,
)

OF_SURFACES, OF_RAY, SHARE, HOW_LONG = range(4)
"""Rows of `summary`: existence of a path's surfaces; chance that it is there, if they are; probability that
it caused a measurement; its length."""


@ti.func
def note(
    rows: ti.template(), pairs: ti.template(), ratios: ti.template(), scan: ti.template(),
    share: ti.template(), out: ti.template(),
):  # fmt: skip
    """Append paths and pairs to those of the anchors before.

    Arguments are those of `updates.update`; `out` is its `messages`.
    """
    n, k = out.count[0], out.count[1]
    fresh = n >= 0  # always, but a GPU copies the earlier rows only if they seem to be needed
    for row in range(rows.path.shape[0]):
        for e in ti.static(range(4)):
            out.noted[n, e] = ti.select(fresh, rows.path[row, e], out.noted[n, e])
        belief, total = ratios.odds[SURFACES, row] * ratios.odds[EXISTENCE, row], ti.f64(0.0)
        message = belief * ratios.odds[WORTH, row] + 1 - belief
        out.factor[n, MESSAGE] = ti.select(fresh, message, out.factor[n, MESSAGE])
        out.factor[n, SENDS] = 1.0 if belief > LEAST_SENDING else 0.0
        for pair in range(pairs.start[row], pairs.start[row + 1]):
            amplitude = scan[pairs.index[pair, SCAN_ROW], AMPLITUDE]
            out.detection[0, k] = ti.select(fresh, amplitude, out.detection[0, k])
            out.detection[1, k] = share[pair]
            total += share[pair]
            k += 1
        out.summary[OF_SURFACES, n] = ti.select(
            fresh, ratios.odds[SURFACES, row], out.summary[OF_SURFACES, n]
        )
        out.summary[OF_RAY, n], out.summary[SHARE, n] = ratios.odds[CHANCE, row], total
        out.summary[HOW_LONG, n] = rows.predicted[row, LENGTH]
        n += 1
        out.begin[n] = ti.select(fresh, k, out.begin[n])
    out.count[0], out.count[1] = n, k
