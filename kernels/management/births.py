"""How well a new surface would explain a measurement, as a mean over samples; docs/model.md, (M32)."""

import taichi as ti

from gridslam.kernels import FAINTEST, PATH_BLOCK, USUAL_REFLECTION
from gridslam.kernels.primitives.blocks import Anchors, BirthRows
from gridslam.kernels.primitives.device import ON_CPU
from gridslam.kernels.primitives.functions import (
    ROOT_TURN,
    TURN,
    angle_of,
    bearing_of,
    cos_of,
    double_bounce,
    exp_of,
    level_of,
    mirrored,
    sin_of,
    single_bounce,
    turn_of,
    wrapped,
)
from gridslam.kernels.primitives.launching import copying
from gridslam.kernels.primitives.layout import (
    ABOVE,
    FACING,
    HEADING,
    LATE,
    anchor_of,
    line_entry,
    line_row,
    rise_of,
    unknown_row,
)
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.radio import (
    AT_1M,
    FALSE_ALARMS,
    SAMPLES,
    amplitude_of,
    clutter_of,
    deviations_of,
    lean_of,
    rician,
)
from gridslam.kernels.primitives.tables import (
    AMPLITUDE,
    AOA,
    AOD,
    BORN_ANCHOR,
    BORN_FIRST,
    BORN_LAST,
    BORN_OF,
    DISTANCE,
    EXPLAINED,
    LABEL,
    LINE_ANGLE,
    LINE_OFFSET,
    NEW,
    OVER_CLUTTER,
    OWN_STD,
)
from gridslam.kernels.propagation.coefficients import BINS

BLOCK = PATH_BLOCK
CLOSE = 1e-4
"""Square of the distance (m^2) between a virtual and its anchor below which no line is made of them."""
FAINT, SLIGHT = 1e-3, 1e-3
"""Ratios to clutter, and to the measurement's known causes, below which a birth isn't looked at."""
DOUBLE_SHARE = 0.5
"""Births by each kind of double bounce over births by single bounces."""
HIGHEST = 1.0
"""More than any density of an amplitude: that of a Rician of variance 1/2 or more is 0.86 at most."""
WIDEST = 2.5
"""Deviation of an AoD that is as good as none."""


@ti.func
def mean_rician(radio: ti.template(), anchor, distance, amplitude, other):
    """Density of an amplitude, averaged over the unknown coefficient; 1 if there is none."""
    total = ti.f64(1.0)
    if amplitude >= 0:
        total = 0.0
        at_1m, samples = radio[anchor, AT_1M], radio[anchor, SAMPLES]
        for n in range(BINS):
            level = amplitude_of(at_1m, distance) * other * (n + 0.5) / BINS
            total += rician(amplitude, level, samples) / BINS
    return total


@ti.func
def known_std(radio: ti.template(), anchor, scan: ti.template(), m, amplitude, lean):
    """sigma of distance, AoD and AoA: the table's own, by Fisher information, or 1e9 for "not measured"."""
    std = deviations_of(radio, anchor, ti.max(amplitude, FAINTEST), scan[m, AOD], scan[m, AOA], lean)
    for q in ti.static(range(3)):
        own = scan[m, OWN_STD + q]
        if own > 0:
            std[q] = own
        std[q] = ti.min(std[q], 1e9) if own >= 0 else 1e9
    return std


@ti.func
def line_of(mean: ti.template(), head, length, angle, arrives, place, last, first):
    """Angle and offset of the new line that explains a length and an angle at the mean of the belief.

    The angle is an AoA if it `arrives`, else an AoD: the same path from its other end.
    """
    bearing, level, near, far = mean[HEADING] + angle, level_of(length, place[ABOVE]), last, first
    vx, vy, sx, sy = mean[0], mean[1], place[0], place[1]
    if not arrives:
        bearing, near, far = place[FACING] + angle, first, last
        vx, vy, sx, sy = place[0], place[1], mean[0], mean[1]
    vx += level * cos_of(bearing)
    vy += level * sin_of(bearing)
    if near >= 0:
        entry = line_entry(head, near)
        vx, vy = mirrored(vx, vy, cos_of(mean[entry]), sin_of(mean[entry]), mean[entry + 1])
    if far >= 0:
        entry = line_entry(head, far)
        sx, sy = mirrored(sx, sy, cos_of(mean[entry]), sin_of(mean[entry]), mean[entry + 1])
    span = ti.max(ti.sqrt((vx - sx) ** 2 + (vy - sy) ** 2), 1e-12)
    nx, ny = (vx - sx) / span, (vy - sy) / span
    return bearing_of(nx, ny), 0.5 * (nx * (vx + sx) + ny * (vy + sy))


@ti.func
def halfway(vx, vy, sx, sy):
    """Line halfway between two points, and the inverse of their distance: 0 if they are too close for one."""
    dx, dy = vx - sx, vy - sy
    square = dx * dx + dy * dy
    per_metre = 1 / ti.sqrt(ti.max(square, CLOSE))
    nx, ny = dx * per_metre, dy * per_metre
    return nx, ny, 0.5 * (nx * (vx + sx) + ny * (vy + sy)), ti.select(square > CLOSE, per_metre, 0.0)


@ti.func
def likely(
    at, near, far, state: ti.template(), ends: ti.template(), end_x: ti.template(), end_y: ti.template(),
    there: ti.template(), angle, std,
):  # fmt: skip
    """Sum of f(angle at the far end) / span over the samples from `at` on, for one hypothesis.

    Rows of `ends` are x and y of the end that a sample is seen from, and of the other one, whose image stands
    at (end_x, end_y). `near` and `far` are the known surfaces next to these ends, -1 for the new one.
    """
    wx, wy, weight = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    s = line_row(ti.max(near, far))
    if s < 3:
        for i in range(BLOCK):
            x, y, far_x, far_y = ends[0, i], ends[1, i], ends[2, i], ends[3, i]
            nx, ny, c, per_metre = halfway(end_x[i], end_y[i], far_x, far_y)
            _, _, tx, ty, ok = single_bounce(x, y, far_x, far_y, nx, ny, c)
            wx[i], wy[i], weight[i] = tx, ty, ok * per_metre
    elif near >= 0:
        for i in range(BLOCK):
            k, x, y, far_x, far_y = at + i, ends[0, i], ends[1, i], ends[2, i], ends[3, i]
            ex, ey, e = state[s, k], state[s + 1, k], state[s + 2, k]
            vx, vy = mirrored(end_x[i], end_y[i], ex, ey, e)
            nx, ny, c, per_metre = halfway(vx, vy, far_x, far_y)
            _, _, tx, ty, ok = double_bounce(x, y, far_x, far_y, ex, ey, e, nx, ny, c)
            wx[i], wy[i], weight[i] = tx, ty, ok * per_metre
    else:
        for i in range(BLOCK):
            k, x, y, far_x, far_y = at + i, ends[0, i], ends[1, i], ends[2, i], ends[3, i]
            ex, ey, e = state[s, k], state[s + 1, k], state[s + 2, k]
            sx, sy = mirrored(far_x, far_y, ex, ey, e)
            nx, ny, c, per_metre = halfway(end_x[i], end_y[i], sx, sy)
            _, _, tx, ty, ok = double_bounce(x, y, far_x, far_y, nx, ny, c, ex, ey, e)
            wx[i], wy[i], weight[i] = tx, ty, ok * per_metre
    total = 0.0
    if std < 1e6:
        for i in range(BLOCK):
            gap = wrapped(angle - angle_of(wx[i], wy[i])) / std
            total += there[i] * weight[i] * exp_of(-0.5 * gap * gap)
        total /= std * ROOT_TURN
    else:
        for i in range(BLOCK):
            total += there[i] * weight[i]
        total /= TURN
    return total


@ti.func
def sum_up(born: ti.template(), proposal: ti.template(), measured: ti.template()):
    """Sum up each measurement's births for the association."""
    for m in range(measured.shape[1]):
        measured[NEW, m] = 0.0
    for b in range(born[0, 0]):
        before = measured[NEW, born[b + 1, BORN_OF]]
        measured[NEW, born[b + 1, BORN_OF]] = before + proposal[b, OVER_CLUTTER]
    for m in range(measured.shape[1]):
        total = measured[NEW, m]
        measured[NEW, m] = 1 + total


@copying("mean")
@ti.kernel
def propose(
    rate: ti.f64,  # half the density of births over lines: see `FilterModel.birth_rate`
    head: ti.i32,  # entry of the mean where the lines begin: see `layout`
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] of the belief
    state: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [3 + 3 S (+ J), P] see `layout`
    noise: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [2, B] standard normal, for as many states
    scan: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 10] see `AnchorScan.table`
    known: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [H, 2] known surface hit last, first; -1: the new one
    whose: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [A] anchors that may have sent the measurements
    anchors: pack(Anchors),
    measured: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [5, M] in/out: see `tables`; `NEW` is out
    births: pack(BirthRows),
):
    """Draw length and angle around the measurement, make the new line, and judge it by AoD and amplitude.

    [Li2026grid], eq. (11). The mean of f(AoD) / span is taken over samples of agent, clocks, distance and
    AoA, whole blocks of them; amplitude and clutter are the same for all. An AoD that wasn't measured has the
    density 1 / (2 pi). Without an AoA, the AoD is drawn: the same path from its other end.
    """
    ti.loop_config(serialize=ON_CPU)  # too little work to wake other threads for
    for item in range(scan.shape[0] * whose.shape[0]):
        m, own = item // whose.shape[0], item % whose.shape[0]
        hypotheses, blocks = known.shape[0], ti.min(noise.shape[1], state.shape[1]) // BLOCK
        least = ti.max(ti.cast(FAINT, ti.f64), SLIGHT * measured[EXPLAINED, m])
        anchor, begin = whose[own], own * hypotheses
        for h in range(hypotheses):
            births.ratio[m, begin + h] = 0.0
        place = anchor_of(anchors.places, mean, head, anchor)
        clock = unknown_row(anchors.places, head, anchor, state.shape[0])
        length = scan[m, DISTANCE] - place[LATE]
        common = rate * length
        arrives = scan[m, OWN_STD + AOA] >= 0
        angled = arrives or scan[m, OWN_STD + AOD] >= 0
        keep = scan[m, OWN_STD] >= 0 and angled and length > ti.abs(place[ABOVE])
        keep = keep and hypotheses > 0 and (scan[m, LABEL] < 0 or scan[m, LABEL] == anchor)
        std, level = ti.Vector([0.0, 0.0, 0.0], dt=ti.f64), ti.Vector([0.0, 0.0], dt=ti.f64)
        if keep:
            amplitude = scan[m, AMPLITUDE]
            usual = amplitude if amplitude >= 0 else amplitude_of(anchors.radio[anchor, AT_1M], length) * 0.5
            std = known_std(anchors.radio, anchor, scan, m, usual, lean_of(length, place[ABOVE]))
            clutter = anchors.radio[anchor, FALSE_ALARMS] * clutter_of(anchors.radio, anchor, amplitude)
            # what a hypothesis could be worth at most: the AoD right on, the image next to the anchor
            worth = least * (ti.min(std[1], WIDEST) if arrives else WIDEST) * ROOT_TURN
            keep = common * HIGHEST / clutter > worth
            if keep:
                level[0] = mean_rician(anchors.radio, anchor, length, amplitude, 1.0) / clutter
                most = level[0]
                if hypotheses > 1:
                    level[1] = (
                        mean_rician(anchors.radio, anchor, length, amplitude, USUAL_REFLECTION) / clutter
                    )
                    most = ti.max(level[0], level[1])
                keep = common * most > worth
        reach, reach_std = ti.cast(scan[m, DISTANCE], ti.f32), ti.cast(std[0], ti.f32)
        angle, angle_std = ti.cast(scan[m, AOA], ti.f32), ti.cast(std[2], ti.f32)
        other, other_std = ti.cast(scan[m, AOD] + place[FACING], ti.f32), ti.cast(std[1], ti.f32)
        if not arrives:
            angle, angle_std, other_std = other, other_std, ti.cast(std[2], ti.f32)
        ax, ay, height = ti.cast(place[0], ti.f32), ti.cast(place[1], ti.f32), ti.cast(place[ABOVE], ti.f32)
        for block in range(blocks if keep else 0):
            at, there, late = block * BLOCK, ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
            end_x, end_y = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
            ends = ti.Matrix.zero(ti.f32, 4, BLOCK)
            if clock >= 0 and rise_of(anchors.places, anchor) < 0:  # a rise is taken at its mean
                for i in range(BLOCK):
                    late[i] = state[clock, at + i]
            for i in range(BLOCK):
                k = at + i
                distance = reach + reach_std * ti.cast(noise[0, k], ti.f32) - late[i]
                turned = angle + angle_std * ti.cast(noise[1, k], ti.f32)
                ends[0, i], ends[1, i], ends[2, i], ends[3, i] = state[0, k], state[1, k], ax, ay
                if arrives:
                    turned += state[2, k]
                else:
                    ends[0, i], ends[1, i], ends[2, i], ends[3, i] = ax, ay, state[0, k], state[1, k]
                cosine, sine = turn_of(wrapped(turned))
                above = level_of(distance, height)  # as seen from there
                end_x[i], end_y[i] = ends[0, i] + above * cosine, ends[1, i] + above * sine
                there[i] = ti.select(distance > ti.abs(height), 1.0, 0.0)
            for h in range(hypotheses):
                last, first, so_far = known[h, 0], known[h, 1], births.ratio[m, begin + h]
                near, far = (last if arrives else first), (first if arrives else last)
                more = likely(at, near, far, state, ends, end_x, end_y, there, other, other_std)
                births.ratio[m, begin + h] = so_far + more / (blocks * BLOCK)
        for h in range(hypotheses if keep else 0):
            last, first = known[h, 0], known[h, 1]
            worth = common * level[0] * births.ratio[m, begin + h]
            if last >= 0 or first >= 0:
                worth = common * level[1] * DOUBLE_SHARE * births.ratio[m, begin + h]
            births.ratio[m, begin + h] = worth if worth > least else 0.0
    ti.loop_config(serialize=True)
    for _ in range(1):
        count = 0
        for m in range(scan.shape[0]):
            for n in range(births.ratio.shape[1]):
                if births.ratio[m, n] > 0:
                    h, anchor = n % known.shape[0], whose[n // known.shape[0]]
                    last, first, place = (
                        known[h, 0],
                        known[h, 1],
                        anchor_of(anchors.places, mean, head, anchor),
                    )
                    length, arrives = scan[m, DISTANCE] - place[LATE], scan[m, OWN_STD + AOA] >= 0
                    seen = scan[m, AOA] if arrives else scan[m, AOD]
                    angle, offset = line_of(mean, head, length, seen, arrives, place, last, first)
                    births.proposal[count, LINE_ANGLE], births.proposal[count, LINE_OFFSET] = angle, offset
                    births.proposal[count, OVER_CLUTTER] = births.ratio[m, n]
                    count += 1
                    births.born[count, BORN_OF], births.born[count, BORN_ANCHOR] = m, anchor
                    births.born[count, BORN_LAST], births.born[count, BORN_FIRST] = last, first
        births.born[0, 0] = count
        sum_up(births.born, births.proposal, measured)
