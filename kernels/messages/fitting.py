"""How well measurements fit the paths that surely caused them: what a filter learns of itself and radio."""

import taichi as ti

from gridslam.kernels import PATH_BLOCK
from gridslam.kernels.primitives.gaussian import MEASURED, innovation_of, inverse_of
from gridslam.kernels.primitives.radio import AT_1M, SAMPLES, THRESHOLD
from gridslam.kernels.primitives.tables import RESPONSIBLE

SURE = 0.9
"""Probability from which an association counts as sure."""
WORST = 30.0
"""Normalised innovation squared at which one path's is cut off."""


@ti.func
def fit(
    path: ti.template(), start: ti.template(), index: ti.template(), pair: ti.template(),
    predicted: ti.template(), share: ti.template(), message: ti.template(), heard: ti.template(),
    blocks: ti.template(), radio: ti.template(), anchor, turned: ti.template(), sums: ti.template(),
):  # fmt: skip
    """Add what the pairs say that are sure; explained are the loud measurements that some path caused.

    The line of sight says how an anchor faces and how strong it sends: no wall takes part. Arguments: see
    `updates.update`.
    """
    paths, count = path.shape[0], blocks.shape[1]
    add = ti.Vector.zero(ti.f64, 8)
    for m in range(heard.shape[0]):
        if heard[m, 7] > 0.5:
            total = ti.cast(0.0, ti.f64)
            for row in range(paths):
                total += message[RESPONSIBLE, row, m]
            add[4] += ti.min(total, 1.0)
            add[5] += 1.0
    for k in range(start[paths]):
        if share[k] > SURE:
            row, m = index[k, 0], index[k, 1]
            core, value = ti.Matrix.zero(ti.f64, 3, 3), ti.Vector.zero(ti.f64, 3)
            for i in range(3):
                value[i] = predicted[row, i]
                for j in range(3):
                    core[i, j] = predicted[row, 3 + 3 * i + j]
            gap, noisy = innovation_of(pair, k, value, core)
            inverse, _determinant = inverse_of(noisy)
            add[0] += ti.min(gap.dot(inverse @ gap), WORST)
            for i in range(3):
                add[1] += 1.0 if pair[k, 3 + i] < MEASURED else 0.0
            if path[row, 0] == 0:
                if pair[k, 4] < MEASURED:
                    add[6] += (turned[anchor] - gap[1]) / noisy[1, 1]
                    add[7] += 1 / noisy[1, 1]
                amplitude = heard[m, 6]
                if pair[k, 3] < MEASURED and amplitude >= 0:
                    level = radio[AT_1M] / ti.max(pair[k, 0], 1e-3)
                    square = 0.5 + level * level / (4 * radio[SAMPLES])
                    measured = ti.sqrt(ti.max(amplitude * amplitude - square, 0.0))
                    if measured > 2 * radio[THRESHOLD]:  # fainter ones are biased by the threshold
                        add[2] += level * measured / square
                        add[3] += level * level / square
            mean, squares = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
            for block in range(count):
                mean += blocks[paths + k, block] / count
            for block in range(count):
                off = blocks[paths + k, block] - mean
                squares += off * off / count
            # blocks are sums of independent weights, so their spread tells that of the weights
            spread = ti.min(PATH_BLOCK * squares / ti.max(mean, 1e-30) ** 2, 1e12)
            number = ti.max(count * PATH_BLOCK / (1 + spread), 1.0)
            fewest = sums[anchor, 8]
            sums[anchor, 8] = ti.min(fewest, number)
    for n in range(8):
        before = sums[anchor, n]
        sums[anchor, n] = before + add[n]
