"""Messages of the data association graph (Williams and Lau 2014)."""

import taichi as ti

from gridslam.kernels import PATH_BLOCK
from gridslam.kernels.launching import quick

LEAST_POSSIBLE = 1e-3
"""Share of particles at which a path is possible that ratios are divided by at least."""
ROOT_TURN_CUBED = 15.749609945722419


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


@quick
@ti.kernel
def associate(
    beta: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] path: "caused measurement m"
    missed: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [L] path: "caused none"
    new: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [M] measurement: "caused by no legacy path"
    limit: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] rounds at most; change that counts as none
    claim: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] out: from path to measurement
    nu: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] out: from measurement to path
    claimed: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [M] out: sum of `claim`
):
    """Exchange messages between paths and measurements until they stay as they are."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        paths, heard = beta.shape[0], beta.shape[1]
        for row in range(paths):
            for m in range(heard):
                nu[row, m], claim[row, m] = 1 / new[m], 0.0
        change, left = ti.cast(1e300, ti.f64), ti.cast(limit[0], ti.i32)
        while left > 0 and change >= limit[1]:
            left -= 1
            change = 0.0
            for row in range(paths):
                total = ti.cast(0.0, ti.f64)
                for m in range(heard):
                    total += beta[row, m] * nu[row, m]
                for m in range(heard):
                    others = ti.max(total - beta[row, m] * nu[row, m], 0.0)
                    claim[row, m] = beta[row, m] / (missed[row] + others)
            for m in range(heard):
                total = ti.cast(0.0, ti.f64)
                for row in range(paths):
                    total += claim[row, m]
                for row in range(paths):
                    fresh = 1 / (new[m] + ti.max(total - claim[row, m], 0.0))
                    change = ti.max(change, ti.abs(fresh - nu[row, m]))
                    nu[row, m] = fresh
        for m in range(heard):
            total = ti.cast(0.0, ti.f64)
            for row in range(paths):
                total += claim[row, m]
            claimed[m] = total
