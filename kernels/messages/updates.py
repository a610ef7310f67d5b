"""Data association of measurements of one anchor, or of all, and the updates by it.

Existence of rays and surfaces is updated here, docs/model.md, (M30), (M31); (M26) to (M29) elsewhere.
"""

from functools import cache

import taichi as ti

from gridslam.kernels.messages.association import exchange
from gridslam.kernels.messages.fitting import fit
from gridslam.kernels.primitives.blocks import (
    Account,
    Anchors,
    Belief,
    Existence,
    Messages,
    Pairs,
    PathRows,
    Ratios,
)
from gridslam.kernels.primitives.corrections import CLOCKS_OPEN, NONE_OPEN, RISES_OPEN, correct
from gridslam.kernels.primitives.functions import decay_of, logarithm_of
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.tables import (
    ANCHOR,
    BOUNCES,
    CHANCE,
    DETECTED,
    EXISTENCE,
    FIRST,
    LAST,
    NU,
    POSSIBLE,
    RATIO,
    SURFACES,
    WORTH,
)
from gridslam.kernels.propagation.path_messages import note

SUREST = 1e-7
"""Doubt that is always left: docs/model.md, (M31)."""
LEAST_LIKELY, LEAST_DOUBT, MOST_ODDS = 1e-12, 1e-9, 40.0
"""So that logarithms are finite: of a factor or an existence, of what is left to 1, and log odds at most."""


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
    `update`.
    """
    for s in range(surface.shape[0]):
        log[s, 0] = 0.0
    for row in range(path.shape[0]):
        bounces, anchor = path[row, BOUNCES], path[row, ANCHOR]
        last, first = path[row, LAST], path[row, FIRST]
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
            log[last, 0] = before + logarithm_of(ti.max(whole, LEAST_LIKELY))
        else:
            double[anchor, last, first] = renewed(double[anchor, last, first], after)
            by_last, by_first, before = surface[last], surface[first], log[last, 0]
            log[last, 0] = before + logarithm_of(ti.max(by_first * whole + 1 - by_first, LEAST_LIKELY))
            before = log[first, 0]
            log[first, 0] = before + logarithm_of(ti.max(by_last * whole + 1 - by_last, LEAST_LIKELY))
    for s in range(surface.shape[0]):
        there = logarithm_of(ti.max(surface[s], LEAST_LIKELY))
        gone = logarithm_of(ti.max(1 - surface[s], LEAST_DOUBT))
        total = ti.max(ti.min(there - gone + log[s, 0], MOST_ODDS), -MOST_ODDS)
        surface[s] = ti.min(1 / (1 + decay_of(-total)), 1 - SUREST)


def _kernel(open):
    """The kernel of a state with clocks, rises or neither: known ones cost nothing, not even in rounding."""

    @ti.kernel
    def update(
        head: ti.i32,  # entry of the mean where the lines begin: see `layout`
        rounds: ti.i32,  # of association at most; 0 where it was done elsewhere
        belief: pack(Belief),  # in and out
        rows: pack(PathRows),
        pairs: pack(Pairs),
        ratios: pack(
            Ratios
        ),  # in and out: of `message` the first two are given, and `NU` if it was done elsewhere
        scan: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 10] see `AnchorScan.table`
        anchors: pack(Anchors),
        existence: pack(Existence),
        account: pack(Account),
        messages: pack(Messages),
    ):
        """Associate; correct agent and surfaces; update existence; sum up the fit; append messages."""
        ti.loop_config(serialize=True)
        for _ in range(1):
            if rounds > 0:
                exchange(ratios.odds, ratios.message, ratios.measured, rounds)
            correct(belief, head, rows.path, pairs, ratios, anchors.places, account, open)
            fit(rows, pairs, ratios.message, scan, anchors.radio, account)
            exist(
                rows.path, ratios.odds, ratios.message, account.scratch, existence.surface, existence.sight,
                existence.single, existence.double,
            )  # fmt: skip
            if messages.noted.shape[0] > 0:
                note(rows, pairs, ratios, scan, account.share, messages)

    return update


update = quick(_kernel(NONE_OPEN))


@cache
def update_with_clocks():
    """The kernel `update` of a state with clocks."""
    return quick(_kernel(CLOCKS_OPEN))


@cache
def update_with_rises():
    """The kernel `update` of a state with rises."""
    return quick(_kernel(RISES_OPEN))
