"""Messages of an anchor's paths to coefficients and cells, appended to those of other anchors."""

import taichi as ti

from gridslam.kernels.primitives.tables import CHANCE as CHANCE_BEFORE
from gridslam.kernels.primitives.tables import EXISTENCE, SURFACES, WORTH
from gridslam.kernels.primitives.tables import LENGTH as LENGTH_COLUMN

THERE, CHANCE, SHARE, LENGTH = range(4)
"""Rows of `told`: existence of a path's surfaces; chance that it is there, if they are; probability that it
caused a measurement; its length."""
LIKELY = 0.1
"""Probability of its ray and surfaces from which on a path sends to cells."""


@ti.func
def note(
    path: ti.template(), start: ti.template(), index: ti.template(), odds: ti.template(),
    predicted: ti.template(), heard: ti.template(), share: ti.template(), count: ti.template(),
    noted: ti.template(), factor: ti.template(), told: ti.template(), begin: ti.template(),
    said: ti.template(),
):  # fmt: skip
    """Append an anchor's paths and pairs to those of the anchors before.

    Arguments are those of `updates.update`; those after `count` are the arrays of
    `inference.state.path_messages`.
    """
    n, k = count[0], count[1]
    fresh = n >= 0  # always, but a GPU copies the earlier rows only if they seem to be needed
    for row in range(path.shape[0]):
        for e in ti.static(range(4)):
            noted[n, e] = ti.select(fresh, path[row, e], noted[n, e])
        belief, total = odds[SURFACES, row] * odds[EXISTENCE, row], ti.cast(0.0, ti.f64)
        factor[n, 0] = ti.select(fresh, belief * odds[WORTH, row] + 1 - belief, factor[n, 0])
        factor[n, 1] = 1.0 if belief > LIKELY else 0.0
        for pair in range(start[row], start[row + 1]):
            said[0, k] = ti.select(fresh, heard[index[pair, 1], 6], said[0, k])
            said[1, k] = share[pair]
            total += share[pair]
            k += 1
        told[THERE, n] = ti.select(fresh, odds[SURFACES, row], told[THERE, n])
        told[CHANCE, n], told[SHARE, n] = odds[CHANCE_BEFORE, row], total
        told[LENGTH, n] = predicted[row, LENGTH_COLUMN]
        n += 1
        begin[n] = ti.select(fresh, k, begin[n])
    count[0], count[1] = n, k
