"""Messages of the data association graph (Williams and Lau 2014)."""

import taichi as ti

from gridslam.kernels.launching import quick


@quick
@ti.kernel
def associate(
    beta: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] path: "caused measurement m"
    missed: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [L] path: "caused none"
    new: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [M] measurement: "caused by no legacy path"
    limit: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] rounds at most; change that counts as none
    claim: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] out: from path to measurement
    nu: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] out: from measurement to path
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
