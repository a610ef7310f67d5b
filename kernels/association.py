"""Messages of the data association graph (Williams and Lau 2014)."""

import taichi as ti

from gridslam.kernels import PATH_BLOCK
from gridslam.kernels.launching import quick

LEAST_POSSIBLE = 1e-3
"""Share of particles at which a path is possible that ratios are divided by at least."""
ROOT_TURN_CUBED = 15.749609945722419
CLAIM, NU, RESPONSIBLE = range(3)
"""Messages between a path and a measurement: there, back, and the probability that one caused the other."""
SETTLED = 1e-6
"""Change of a message that counts as none."""


@quick
@ti.kernel
def enter(
    blocks: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [L + K, P / BLOCK] as `paths.evaluate` leaves them
    index: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [K or more, 2] path and measurement of every pair
    pair: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [K or more, 8] as `gating.gate` leaves them
    prior: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [4, L] existence of ray and of surfaces, V, p_d
    ratio: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] out: p_d f(z | path) / (mu_fa f_fa(z))
    beta: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] out: from path to association
    odds: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [4, L] out: V where possible, chance if its surfaces are
    # there, chance, "caused none"
    explained: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [M] out: sum of beta
):
    """Means over the particles, and the messages from them into the association."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        paths, count = ratio.shape[0], blocks.shape[1]
        particles = ti.cast(count * PATH_BLOCK, ti.f64)
        for m in range(ratio.shape[1]):
            explained[m] = 0.0
        for row in range(paths):
            total = ti.cast(0.0, ti.f64)
            for block in range(count):
                total += blocks[row, block]
            possible = total / particles
            odds[0, row] = prior[2, row] * possible
            odds[1, row] = prior[0, row] * odds[0, row]
            odds[2, row] = prior[1, row] * odds[1, row]
            odds[3, row] = ti.max(1 - odds[2, row] * prior[3, row], 1e-9)
            for m in range(ratio.shape[1]):
                ratio[row, m], beta[row, m] = 0.0, 0.0
        for k in range(blocks.shape[0] - paths):
            row, m = index[k, 0], index[k, 1]
            total, possible = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
            for block in range(count):
                total += blocks[paths + k, block]
                possible += blocks[row, block]
            mean = total / particles / (ROOT_TURN_CUBED * ti.sqrt(pair[k, 7]))
            ratio[row, m] = pair[k, 6] * mean / ti.max(possible / particles, LEAST_POSSIBLE)
            beta[row, m] = odds[2, row] * ratio[row, m]
            explained[m] += beta[row, m]


@ti.func
def exchange(
    beta: ti.template(), missed: ti.template(), own, new: ti.template(), rounds, message: ti.template(),
    claimed: ti.template(),
):  # fmt: skip
    """Exchange messages between paths and measurements until they stay as they are.

    Row `own` of `missed` holds the paths' message for "caused none". Arguments else as of `associate`.
    """
    paths, heard = beta.shape[0], beta.shape[1]
    for row in range(paths):
        for m in range(heard):
            message[NU, row, m], message[CLAIM, row, m] = 1 / new[m], 0.0
    change, left = ti.cast(1e300, ti.f64), rounds
    while left > 0 and change >= SETTLED:
        left -= 1
        change = 0.0
        for row in range(paths):
            total = ti.cast(0.0, ti.f64)
            for m in range(heard):
                total += beta[row, m] * message[NU, row, m]
            for m in range(heard):
                others = ti.max(total - beta[row, m] * message[NU, row, m], 0.0)
                message[CLAIM, row, m] = beta[row, m] / (missed[own, row] + others)
        for m in range(heard):
            total = ti.cast(0.0, ti.f64)
            for row in range(paths):
                total += message[CLAIM, row, m]
            for row in range(paths):
                fresh = 1 / (new[m] + ti.max(total - message[CLAIM, row, m], 0.0))
                change = ti.max(change, ti.abs(fresh - message[NU, row, m]))
                message[NU, row, m] = fresh
    for m in range(heard):
        total = ti.cast(0.0, ti.f64)
        for row in range(paths):
            total += message[CLAIM, row, m]
        claimed[m] = total


@quick
@ti.kernel
def associate(
    beta: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] path: "caused measurement m"
    missed: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [1, L] path: "caused none"
    new: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [M] measurement: "caused by no legacy path"
    rounds: ti.i32,  # at most
    message: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [2, L, M] out: from path to measurement, and back
    claimed: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [M] out: sum of what paths claim
):
    """Data association by itself; a filter has it done with its updates."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        exchange(beta, missed, 0, new, rounds, message, claimed)
