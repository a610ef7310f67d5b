"""How well measurements fit the paths that surely caused them: what a filter learns of itself and radio."""

import taichi as ti

from gridslam.kernels import (
    CAUSED,
    FREEDOM,
    GAIN,
    GAIN_PRECISION,
    LEAST_PARTICLES,
    LOUD_ONES,
    MISFIT,
    PATH_BLOCK,
    SUMS,
    TURNED,
    TURNED_PRECISION,
)
from gridslam.kernels.primitives.corrections import MEASURED, innovation_of, inverse_of
from gridslam.kernels.primitives.radio import AT_1M, SAMPLES, THRESHOLD
from gridslam.kernels.primitives.tables import (
    AMPLITUDE,
    ANCHOR,
    AOD,
    BOUNCES,
    COVARIANCE,
    DISTANCE,
    LABEL,
    LOUD,
    PATH_ROW,
    RESPONSIBLE,
    SCAN_ROW,
    VARIANCE,
)
from gridslam.kernels.propagation.amplitudes import length_given

SURE = 0.9
"""Probability from which an association counts as sure."""
WORST = 30.0
"""Normalised innovation squared at which one path's is cut off."""
ADDED = SUMS - 1
"""Columns of `sums` that are added to; of the last one, the least is kept."""


@ti.func
def book(sums: ti.template(), anchor, add):
    """Add to an anchor's sums; read, then written, since an addition in place would be atomic."""
    for n in ti.static(range(ADDED)):
        before = sums[anchor, n]
        sums[anchor, n] = before + add[n]


@ti.func
def fit(
    rows: ti.template(), pairs: ti.template(), message: ti.template(), scan: ti.template(),
    radio: ti.template(), account: ti.template(),
):  # fmt: skip
    """Add what the pairs say that are sure; explained are the loud measurements that some path caused.

    Each is booked for the anchor of its path; how many are loud for the anchor that sent them, or, where that
    isn't known, for the first.

    The line of sight says how an anchor faces and how strong it sends: no wall takes part. Arguments: see
    `updates.update`.
    """
    paths, count = rows.path.shape[0], pairs.blocks.shape[1]
    for m in range(scan.shape[0]):
        if scan[m, LOUD] > 0.5:
            total, add = ti.f64(0.0), ti.Vector.zero(ti.f64, ADDED)
            for row in range(paths):
                total += message[RESPONSIBLE, row, m]
            add[CAUSED], add[LOUD_ONES] = ti.min(total, 1.0), 1.0
            book(account.sums, ti.cast(ti.max(scan[m, LABEL], 0.0), ti.i32), add)
    for k in range(pairs.start[paths]):
        if account.share[k] > SURE:
            row, m = pairs.index[k, PATH_ROW], pairs.index[k, SCAN_ROW]
            anchor, add = rows.path[row, ANCHOR], ti.Vector.zero(ti.f64, ADDED)
            core, value = ti.Matrix.zero(ti.f64, 3, 3), ti.Vector.zero(ti.f64, 3)
            for i in range(3):
                value[i] = rows.predicted[row, i]
                for j in range(3):
                    core[i, j] = rows.predicted[row, COVARIANCE + 3 * i + j]
            gap, noisy = innovation_of(pairs.pair, k, value, core)
            inverse, _determinant = inverse_of(noisy)
            add[MISFIT] = ti.min(gap.dot(inverse @ gap), WORST)
            for i in range(3):
                add[FREEDOM] += 1.0 if pairs.pair[k, VARIANCE + i] < MEASURED else 0.0
            if rows.path[row, BOUNCES] == 0:
                if pairs.pair[k, VARIANCE + AOD] < MEASURED:
                    add[TURNED] = (account.turned[anchor] - gap[1]) / noisy[1, 1]
                    add[TURNED_PRECISION] = 1 / noisy[1, 1]
                amplitude = scan[m, AMPLITUDE]
                if pairs.pair[k, VARIANCE + DISTANCE] < MEASURED and amplitude >= 0:
                    length, unsure = length_given(rows, row, pairs.pair[k, DISTANCE], pairs.pair[k, VARIANCE])
                    level = radio[anchor, AT_1M] / length
                    square = 0.5 + level * level / (4 * radio[anchor, SAMPLES])
                    measured = ti.sqrt(ti.max(amplitude * amplitude - square, 0.0))
                    square += unsure * unsure * level * amplitude
                    if measured > 2 * radio[anchor, THRESHOLD]:  # fainter ones are biased by the threshold
                        add[GAIN] = level * measured / square
                        add[GAIN_PRECISION] = level * level / square
            mean, squares = ti.f64(0.0), ti.f64(0.0)
            for block in range(count):
                mean += pairs.blocks[paths + k, block] / count
            for block in range(count):
                off = pairs.blocks[paths + k, block] - mean
                squares += off * off / count
            # blocks are sums of independent weights, so their spread tells that of the weights
            spread = ti.min(PATH_BLOCK * squares / ti.max(mean, 1e-30) ** 2, 1e12)
            number = ti.max(count * PATH_BLOCK / (1 + spread), 1.0)
            fewest = account.sums[anchor, LEAST_PARTICLES]
            account.sums[anchor, LEAST_PARTICLES] = ti.min(fewest, number)
            book(account.sums, anchor, add)
