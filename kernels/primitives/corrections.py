"""The joint belief corrected by paths, one after the other; docs/model.md, (M27)-(M29).

State: see `layout`; what is predicted of a path: see `gaussian`.
"""

import taichi as ti

from gridslam.kernels import UNMEASURED
from gridslam.kernels.primitives.functions import PI, decay_of, wrapped
from gridslam.kernels.primitives.gaussian import (
    OF_BOUNCE,
    bend_of,
    bend_of_bounce,
    entry_of,
    path_of,
    spread_by_clocks,
    spread_by_rise,
    spread_of,
)
from gridslam.kernels.primitives.layout import HEADING, LATE, anchor_of, steepness_of, unknown_entry
from gridslam.kernels.primitives.tables import (
    ANCHOR,
    BETA,
    BOUNCES,
    DENSITY,
    FIRST,
    LAST,
    MISSED,
    NU,
    ORDER,
    PATH_ROW,
    RESPONSIBLE,
    SCAN_ROW,
    SURE,
    TAKEN,
    THERE,
    TOTAL,
    VARIANCE,
)

MEASURED = 0.1 * UNMEASURED
"""A variance from here on stands for "not measured"."""
NONE_OPEN, CLOCKS_OPEN, RISES_OPEN = range(3)
"""What a state holds between pose and lines."""
UNLIKELY, UNMOVED = 1e-3, 1e-6
"""Probabilities below which a path is left out, and below which an association moves nothing."""


@ti.func
def inverse_of(m):
    """Inverse of a symmetric 3 x 3 matrix, and its determinant."""
    i00, i11 = m[1, 1] * m[2, 2] - m[1, 2] ** 2, m[0, 0] * m[2, 2] - m[0, 2] ** 2
    i22 = m[0, 0] * m[1, 1] - m[0, 1] ** 2
    i01, i02 = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2], m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    i12 = m[0, 1] * m[0, 2] - m[1, 2] * m[0, 0]
    determinant = m[0, 0] * i00 + m[0, 1] * i01 + m[0, 2] * i02
    inverse = ti.Matrix([[i00, i01, i02], [i01, i11, i12], [i02, i12, i22]], dt=ti.f64) / determinant
    return inverse, determinant


@ti.func
def innovation_of(pair: ti.template(), k, value, core):
    """Measured minus predicted, 0 where nothing was measured, and its covariance."""
    gap, noisy = ti.Vector.zero(ti.f64, 3), core
    for i in ti.static(range(3)):
        noisy[i, i] += pair[k, VARIANCE + i]
        if pair[k, VARIANCE + i] < MEASURED:
            gap[i] = pair[k, i] - value[i]
            if ti.static(i > 0):
                gap[i] = wrapped(gap[i])
    return gap, noisy


@ti.func
def sorted_by(rank: ti.template(), least, among):
    """Write numbers of values in row `SURE` to row `ORDER`, largest first; return how many.

    The first `among` values are looked at, and those below `least` left out. Equal ones stay in their order.
    """
    count = 0
    for row in range(among):
        if rank[SURE, row] >= least:
            at = count
            while at > 0 and rank[SURE, ti.cast(rank[ORDER, ti.max(at - 1, 0)], ti.i32)] < rank[SURE, row]:
                rank[ORDER, at] = rank[ORDER, at - 1]
                at -= 1
            rank[ORDER, at] = row
            count += 1
    return count


@ti.func
def correct_by(
    row, belief: ti.template(), head, path: ti.template(), pairs: ti.template(), ratios: ti.template(),
    places: ti.template(), account: ti.template(), open: ti.template(),
):  # fmt: skip
    """Correct by one path, docs/model.md, (M27)-(M29), (M291), (M552).

    What surer paths have taken of a measurement it can't have caused: the rest counts as caused none.
    """
    size = belief.mean.shape[0]
    bounces, last, first, anchor = path[row, BOUNCES], path[row, LAST], path[row, FIRST], path[row, ANCHOR]
    place = anchor_of(places, belief.mean, head, anchor)
    value, slope = path_of(belief.mean, head, place, bounces, last, first)
    entry, unknown = entry_of(head, bounces, last, first), unknown_entry(places, head, anchor)
    steepness = steepness_of(place, value[0] - place[LATE])
    core = spread_of(slope, entry, belief.covariance)
    if ti.static(open == CLOCKS_OPEN):
        core += spread_by_clocks(slope, entry, unknown, belief.covariance)
    if ti.static(open == RISES_OPEN):
        if unknown >= 0:
            core += spread_by_rise(slope, entry, unknown, steepness, belief.covariance)
    if bounces == 0:
        bent, bend = bend_of(slope, value[0] - place[LATE], belief.covariance)
        value += bent
        core += bend
    if bounces == 1:
        block = ti.Matrix.zero(ti.f64, 4, 4)
        for i in ti.static(range(4)):
            for j in ti.static(range(4)):
                block[i, j] = belief.covariance[entry[OF_BOUNCE[i]], entry[OF_BOUNCE[j]]]
        angle, offset = belief.mean[entry[3]], belief.mean[entry[4]]
        bent, bend = bend_of_bounce(slope, value[0] - place[LATE], place, angle, offset, block)
        value += bent
        core += bend
    total = ratios.odds[MISSED, row]
    change, shift = ti.Matrix.zero(ti.f64, 3, 3), ti.Vector.zero(ti.f64, 3)
    moved = False
    for walk in range(2):  # 0: probabilities of the associations; 1: what they do
        for k in range(pairs.start[row], pairs.start[row + 1]):
            if walk == 0 or account.share[k] > UNMOVED * total:
                gap, noisy = innovation_of(pairs.pair, k, value, core)
                inverse, determinant = inverse_of(noisy)
                g = inverse @ gap
                if walk == 0:
                    scale = ti.sqrt((2 * PI) ** 3 * determinant)
                    density = pairs.pair[k, DENSITY] * decay_of(-0.5 * gap.dot(g)) / scale
                    account.share[k] = (
                        ratios.odds[THERE, row] * ratios.message[NU, row, pairs.index[k, SCAN_ROW]] * density
                    )
                    total += account.share[k]
                else:
                    free = 1 - ratios.measured[TAKEN, pairs.index[k, SCAN_ROW]]
                    part = ti.min(account.share[k] / total, ti.max(free, 0.0))
                    shift += part * g
                    change += part * (inverse - g.outer_product(g))
                    moved = True
    ratios.odds[TOTAL, row] = total
    for k in range(pairs.start[row], pairs.start[row + 1]):
        taken = ratios.measured[TAKEN, pairs.index[k, SCAN_ROW]]
        part = ti.min(account.share[k] / total, ti.max(1 - taken, 0.0))
        account.share[k] = part
        ratios.measured[TAKEN, pairs.index[k, SCAN_ROW]] = taken + part
    if moved:
        change += shift.outer_product(shift)
        for n in range(size):
            spread = ti.Vector.zero(ti.f64, 3)
            for m in range(7):
                p = belief.covariance[n, entry[m]]
                for i in ti.static(range(3)):
                    spread[i] += p * slope[i, m]
            if ti.static(open == CLOCKS_OPEN):
                spread[0] += belief.covariance[n, unknown]
            if ti.static(open == RISES_OPEN):
                if unknown >= 0:
                    spread[0] += steepness * belief.covariance[n, unknown]
            pushed = change @ spread
            for i in ti.static(range(3)):
                account.scratch[n, i], account.scratch[n, 3 + i] = spread[i], pushed[i]
        for n in range(size):
            for m in range(n + 1):
                less = ti.f64(0.0)
                for i in ti.static(range(3)):
                    less += account.scratch[n, i] * account.scratch[m, 3 + i]
                after = (
                    belief.covariance[n, m] - less
                )  # read, then written: an addition in place would be atomic
                belief.covariance[n, m], belief.covariance[m, n] = after, after
            moved_to = belief.mean[n]
            for i in ti.static(range(3)):
                moved_to += account.scratch[n, i] * shift[i]
            belief.mean[n] = moved_to
        belief.mean[HEADING] = wrapped(belief.mean[HEADING])


@ti.func
def correct(
    belief: ti.template(), head, path: ti.template(), pairs: ti.template(), ratios: ti.template(),
    places: ti.template(), account: ti.template(), open: ti.template(),
):  # fmt: skip
    """Correct by the paths one after the other, surest first, each moment-matched over its measurements.

    Several measurements may have come from the path, or none. With S = P J', a measurement moves the state
    by S g, and all of them together change the covariance by S C S', where C is 3 x 3. `open` says whether
    clocks or heights are part of the state; arguments: see `updates.update`.
    """
    for k in range(pairs.start[path.shape[0]]):
        account.share[k] = 0.0
    for m in range(ratios.measured.shape[1]):
        ratios.measured[TAKEN, m] = 0.0
    for row in range(path.shape[0]):
        total = ti.f64(0.0)
        for m in range(ratios.message.shape[2]):
            ratios.message[RESPONSIBLE, row, m] = 0.0
            total += ratios.message[BETA, row, m] * ratios.message[NU, row, m]
        ratios.odds[TOTAL, row] = total + ratios.odds[MISSED, row]
        ratios.odds[SURE, row] = total / ratios.odds[TOTAL, row]
    for turn in range(sorted_by(ratios.odds, UNLIKELY, path.shape[0])):
        row = ti.cast(ratios.odds[ORDER, turn], ti.i32)
        correct_by(row, belief, head, path, pairs, ratios, places, account, open)
    for k in range(pairs.start[path.shape[0]]):
        ratios.message[RESPONSIBLE, pairs.index[k, PATH_ROW], pairs.index[k, SCAN_ROW]] = account.share[k]
