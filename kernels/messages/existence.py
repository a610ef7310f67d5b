"""Existence of rays and surfaces after an anchor's measurements; docs/model.md, (M30), (M31)."""

import taichi as ti

from gridslam.kernels.primitives.functions import decay_of, logarithm_of
from gridslam.kernels.primitives.tables import (
    CHANCE,
    DETECTED,
    EXISTENCE,
    NU,
    POSSIBLE,
    RATIO,
    SURFACES,
    WORTH,
)

SUREST = 1e-7
"""Doubt that is always left."""


@ti.func
def renewed(before, after):
    """The new value; a GPU gets an array's other entries only if some are read, too."""
    return ti.select(after >= 0, after, before)


@ti.func
def exist(
    path: ti.template(), odds: ti.template(), message: ti.template(), log: ti.template(),
    surface: ti.template(), sight: ti.template(), single: ti.template(), double: ti.template(),
):  # fmt: skip
    """Update rays, then surfaces by all paths that meet them.

    A ray that the grid blocks (V small) is not judged by its silence. Arguments: see
    `updates.update`.
    """
    for s in range(surface.shape[0]):
        log[s, 0] = 0.0
    for row in range(path.shape[0]):
        bounces, last, first, anchor = path[row, 0], path[row, 1], path[row, 2], path[row, 3]
        likelihood = 1 - odds[DETECTED, row]
        for m in range(message.shape[2]):
            likelihood += message[NU, row, m] * message[RATIO, row, m]
        odds[WORTH, row] = likelihood
        chance, there = odds[SURFACES, row] * odds[POSSIBLE, row], odds[EXISTENCE, row]
        ahead = there * (chance * likelihood + 1 - chance)
        after = ahead / (ahead + 1 - there)
        whole = odds[CHANCE, row] * likelihood + 1 - odds[CHANCE, row]
        if bounces == 0:
            sight[anchor] = renewed(sight[anchor], after)
        elif bounces == 1:
            single[anchor, last] = renewed(single[anchor, last], after)
            before = log[last, 0]
            log[last, 0] = before + logarithm_of(ti.max(whole, 1e-12))
        else:
            double[anchor, last, first] = renewed(double[anchor, last, first], after)
            by_last, by_first, before = surface[last], surface[first], log[last, 0]
            log[last, 0] = before + logarithm_of(ti.max(by_first * whole + 1 - by_first, 1e-12))
            before = log[first, 0]
            log[first, 0] = before + logarithm_of(ti.max(by_last * whole + 1 - by_last, 1e-12))
    for s in range(surface.shape[0]):
        logs, gone = logarithm_of(ti.max(surface[s], 1e-12)), logarithm_of(ti.max(1 - surface[s], 1e-9))
        total = ti.max(ti.min(logs - gone + log[s, 0], 40.0), -40.0)
        surface[s] = ti.min(1 / (1 + decay_of(-total)), 1 - SUREST)
