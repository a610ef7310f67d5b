"""Messages of the data association graph [Williams2014bp]; docs/model.md, (M24)-(M26)."""

import taichi as ti

from gridslam.kernels import PATH_BLOCK
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.tables import (
    BETA,
    CHANCE,
    CLAIM,
    CLAIMED,
    DENSITY,
    DETECTED,
    DETERMINANT,
    EXISTENCE,
    EXPLAINED,
    MISSED,
    NEW,
    NU,
    OPEN,
    POSSIBLE,
    RATIO,
    SCAN_ROW,
    SURFACES,
    THERE,
)

LEAST_POSSIBLE = 1e-3
"""Share of particles at which a path is possible that ratios are divided by at least."""
ROOT_TURN_CUBED = 15.749609945722419
NO_MESSAGE = 1e-30
"""Message that a path is divided by at least."""
SETTLED = 1e-6
"""Change of a message that counts as none."""


@ti.func
def enter(
    blocks: ti.template(), start: ti.template(), index: ti.template(), pair: ti.template(),
    odds: ti.template(), message: ti.template(), measured: ti.template(),
):  # fmt: skip
    """Means over the particles, and the messages from them into the association.

    [Li2026grid], eqs. (17) to (42): `SURFACES` is the product over those that a path meets, none, one or
    two, so one line serves all of them. Arguments are those of `evaluation.evaluate`, whose blocks of
    particles are summed up.
    """
    paths, count = odds.shape[1], blocks.shape[1]
    particles = ti.cast(count * PATH_BLOCK, ti.f64)
    for m in range(measured.shape[1]):
        measured[EXPLAINED, m] = 0.0
    for row in range(paths):
        total = ti.f64(0.0)
        for block in range(count):
            total += blocks[row, block]
        possible = total / particles
        odds[POSSIBLE, row] = odds[OPEN, row] * possible
        odds[CHANCE, row] = odds[EXISTENCE, row] * odds[POSSIBLE, row]
        odds[THERE, row] = odds[SURFACES, row] * odds[CHANCE, row]
        odds[MISSED, row] = ti.max(1 - odds[THERE, row] * odds[DETECTED, row], 1e-9)
        for m in range(measured.shape[1]):
            message[RATIO, row, m], message[BETA, row, m] = 0.0, 0.0
        among = ti.f64(0.0)
        for k in range(start[row], start[row + 1]):
            m, total = index[k, SCAN_ROW], ti.f64(0.0)
            for block in range(count):
                total += blocks[paths + k, block]
            mean = total / particles / (ROOT_TURN_CUBED * ti.sqrt(pair[k, DETERMINANT]))
            ratio = pair[k, DENSITY] * mean / ti.max(possible, LEAST_POSSIBLE)
            message[RATIO, row, m], message[BETA, row, m] = ratio, odds[THERE, row] * ratio
            among += odds[THERE, row] * ratio
        for k in range(start[row], start[row + 1]):
            beta, before = message[BETA, row, index[k, SCAN_ROW]], measured[EXPLAINED, index[k, SCAN_ROW]]
            share = beta / ti.max(among, NO_MESSAGE)  # a path that sent another one explains this one less
            measured[EXPLAINED, index[k, SCAN_ROW]] = before + share * beta


@ti.func
def exchange(odds: ti.template(), message: ti.template(), measured: ti.template(), rounds):
    """Exchange messages between paths and measurements until they stay as they are.

    Arguments are those of `associate`.
    """
    paths, measurements = message.shape[1], message.shape[2]
    for row in range(paths):
        for m in range(measurements):
            message[NU, row, m], message[CLAIM, row, m] = 1 / measured[NEW, m], 0.0
    change, left = ti.f64(1e30), rounds
    while left > 0 and change >= SETTLED:
        left -= 1
        change = 0.0
        for row in range(paths):
            total = ti.f64(0.0)
            for m in range(measurements):
                total += message[BETA, row, m] * message[NU, row, m]
            for m in range(measurements):
                beta = message[BETA, row, m]
                others = ti.max(total - beta * message[NU, row, m], 0.0)
                message[CLAIM, row, m] = beta / (odds[MISSED, row] + others)
        for m in range(measurements):
            total = ti.f64(0.0)
            for row in range(paths):
                total += message[CLAIM, row, m]
            for row in range(paths):
                fresh = 1 / (measured[NEW, m] + ti.max(total - message[CLAIM, row, m], 0.0))
                change = ti.max(change, ti.abs(fresh - message[NU, row, m]))
                message[NU, row, m] = fresh
    for m in range(measurements):
        total = ti.f64(0.0)
        for row in range(paths):
            total += message[CLAIM, row, m]
        measured[CLAIMED, m] = total


@quick
@ti.kernel
def associate(
    odds: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [12, L] of which `MISSED` is given: see `tables`
    message: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [5, L, M] in/out: `BETA` in; `CLAIM`, `NU` out
    measured: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [5, M] in/out: `NEW` in; `CLAIMED` out
    rounds: ti.i32,  # at most
):
    """Data association by itself; a filter has it done with its updates."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        exchange(odds, message, measured, rounds)
