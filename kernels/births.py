"""How well a new surface would explain a measurement, as a mean over samples (paper 002, section V-B)."""

import taichi as ti

from gridslam.kernels import FAINTEST, PATH_BLOCK, USUAL_REFLECTION
from gridslam.kernels.bundles import lay_leg, meet_cells, rows_alone
from gridslam.kernels.coefficients import BINS
from gridslam.kernels.device import ON_CPU
from gridslam.kernels.functions import (
    TURN,
    angle_of,
    bearing_of,
    cos_of,
    double_bounce,
    exp_of,
    mirrored,
    sin_of,
    single_bounce,
    turn_of,
    wrapped,
)
from gridslam.kernels.launching import quick
from gridslam.kernels.paths import draw_path, stand_at
from gridslam.kernels.radio import AT_1M, FALSE_ALARMS, SAMPLES, clutter_of, deviations_of, rician

BLOCK = PATH_BLOCK
ROOT_TURN = 2.5066282746310002
CLOSE = 1e-4
"""Square of the distance (m^2) between a virtual and its anchor below which no line is made of them."""
FAINT, EXPLAINED = 1e-3, 1e-3
"""Ratios to clutter, and to the measurement's known causes, below which a birth isn't looked at."""
DOUBLE_SHARE = 0.5
"""Births by each kind of double bounce over births by single bounces."""
WIDEST = 2.5
"""Deviation of an AoD that is as good as none."""


@ti.func
def mean_rician(radio: ti.template(), distance, amplitude, other):
    """Density of an amplitude, averaged over the unknown coefficient; 1 if there is none."""
    total = ti.cast(1.0, ti.f64)
    if amplitude >= 0:
        total = 0.0
        for n in range(BINS):
            level = radio[AT_1M] / ti.max(distance, 1e-3) * other * (n + 0.5) / BINS
            total += rician(amplitude, level, radio[SAMPLES]) / BINS
    return total


@ti.func
def known_std(radio: ti.template(), heard: ti.template(), m, amplitude):
    """sigma of distance, AoD and AoA: the table's own, by Fisher information, or 1e9 for "not measured"."""
    std = deviations_of(radio, ti.max(amplitude, FAINTEST), heard[m, 1], heard[m, 2])
    for q in ti.static(range(3)):
        own = heard[m, 3 + q]
        if own > 0:
            std[q] = own
        std[q] = ti.min(std[q], 1e9) if own >= 0 else 1e9
    return std


@ti.func
def line_of(mean: ti.template(), heard: ti.template(), place: ti.template(), m, last, first):
    """Angle and offset of the new line that explains a measurement at the mean of the belief."""
    bearing = mean[4] + heard[m, 2]
    vx, vy = mean[0] + heard[m, 0] * cos_of(bearing), mean[1] + heard[m, 0] * sin_of(bearing)
    sx, sy = place[0], place[1]
    if last >= 0:
        angle = mean[5 + 2 * last]
        vx, vy = mirrored(vx, vy, cos_of(angle), sin_of(angle), mean[6 + 2 * last])
    if first >= 0:
        angle = mean[5 + 2 * first]
        sx, sy = mirrored(sx, sy, cos_of(angle), sin_of(angle), mean[6 + 2 * first])
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
    at, last, first, state: ti.template(), end_x: ti.template(), end_y: ti.template(), there: ti.template(),
    ax, ay, departure, std,
):  # fmt: skip
    """Sum of f(AoD) / span over the samples from `at` on, whose images are given, for one hypothesis."""
    wx, wy, weight = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
    s = 3 + 3 * ti.max(last, first)
    if s < 3:
        for i in range(BLOCK):
            k = at + i
            nx, ny, c, per_metre = halfway(end_x[i], end_y[i], ax, ay)
            _, _, x, y, ok = single_bounce(state[0, k], state[1, k], ax, ay, nx, ny, c)
            wx[i], wy[i], weight[i] = x, y, ok * per_metre
    elif last >= 0:
        for i in range(BLOCK):
            k = at + i
            ex, ey, e = state[s, k], state[s + 1, k], state[s + 2, k]
            vx, vy = mirrored(end_x[i], end_y[i], ex, ey, e)
            nx, ny, c, per_metre = halfway(vx, vy, ax, ay)
            _, _, x, y, ok = double_bounce(state[0, k], state[1, k], ax, ay, ex, ey, e, nx, ny, c)
            wx[i], wy[i], weight[i] = x, y, ok * per_metre
    else:
        for i in range(BLOCK):
            k = at + i
            ex, ey, e = state[s, k], state[s + 1, k], state[s + 2, k]
            sx, sy = mirrored(ax, ay, ex, ey, e)
            nx, ny, c, per_metre = halfway(end_x[i], end_y[i], sx, sy)
            _, _, x, y, ok = double_bounce(state[0, k], state[1, k], ax, ay, nx, ny, c, ex, ey, e)
            wx[i], wy[i], weight[i] = x, y, ok * per_metre
    total = 0.0
    if std < 1e6:
        for i in range(BLOCK):
            gap = wrapped(departure - angle_of(wx[i], wy[i])) / std
            total += there[i] * weight[i] * exp_of(-0.5 * gap * gap)
        total /= std * ROOT_TURN
    else:
        for i in range(BLOCK):
            total += there[i] * weight[i]
        total /= TURN
    return total


@quick
@ti.kernel
def propose(
    state: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [3 + 3 S, P] x, y, heading; per line normal x, y, offset
    noise: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [2, B] standard normal, for as many states
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] of the belief
    heard: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 9] see `Heard.table`
    explained: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [M] ratio to clutter of the known causes
    known: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [H, 2] known surface hit last, first; -1: the new one
    place: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [3] anchor x, y, orientation
    radio: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [11] see `kernels.radio`
    rate: ti.f64,  # births per anchor, step and unit of lines (rad m)
    ratio: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, H] out: mean number of births over that of clutter
    line: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [M, H, 2] out: the line at the mean, where ratio > 0
):
    """Draw distance and AoA around the measurement, make the new line, and judge it by AoD and amplitude.

    The mean of f(AoD) / span is taken over samples of agent, distance and AoA, whole blocks of them;
    amplitude and clutter are the same for all. An AoD that wasn't measured has the density 1 / (2 pi).
    """
    ti.loop_config(serialize=ON_CPU)  # too little work to wake other threads for
    for m in range(heard.shape[0]):
        hypotheses, blocks = known.shape[0], ti.min(noise.shape[1], state.shape[1]) // BLOCK
        for h in range(hypotheses):
            ratio[m, h] = 0.0
        common = rate * heard[m, 0]
        least = ti.max(ti.cast(FAINT, ti.f64), EXPLAINED * explained[m])
        keep = heard[m, 3] >= 0 and heard[m, 5] >= 0 and hypotheses > 0
        std, level = ti.Vector([0.0, 0.0, 0.0], dt=ti.f64), ti.Vector([0.0, 0.0], dt=ti.f64)
        if keep:
            amplitude = heard[m, 6]
            usual = amplitude if amplitude >= 0 else radio[AT_1M] / ti.max(heard[m, 0], 1e-3) * 0.5
            std = known_std(radio, heard, m, usual)
            clutter = radio[FALSE_ALARMS] * clutter_of(radio, amplitude)
            level[0] = mean_rician(radio, heard[m, 0], amplitude, 1.0) / clutter
            level[1] = mean_rician(radio, heard[m, 0], amplitude, USUAL_REFLECTION) / clutter
            # what a hypothesis could be worth at most: the AoD right on, the image next to the anchor
            most = ti.max(level[0], level[1]) if hypotheses > 1 else level[0]
            keep = common * most / ROOT_TURN > least * ti.min(std[1], WIDEST)
        reach, reach_std = ti.cast(heard[m, 0], ti.f32), ti.cast(std[0], ti.f32)
        arrival, arrival_std = ti.cast(heard[m, 2], ti.f32), ti.cast(std[2], ti.f32)
        departure, departure_std = ti.cast(heard[m, 1] + place[2], ti.f32), ti.cast(std[1], ti.f32)
        ax, ay = ti.cast(place[0], ti.f32), ti.cast(place[1], ti.f32)
        for block in range(blocks if keep else 0):
            at, there = block * BLOCK, ti.Vector([0.0] * BLOCK)
            end_x, end_y = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
            for i in range(BLOCK):
                k = at + i
                distance = reach + reach_std * ti.cast(noise[0, k], ti.f32)
                turned = arrival + arrival_std * ti.cast(noise[1, k], ti.f32)
                cosine, sine = turn_of(wrapped(turned + state[2, k]))
                end_x[i], end_y[i] = state[0, k] + distance * cosine, state[1, k] + distance * sine
                there[i] = ti.select(distance > 0, 1.0, 0.0)
            for h in range(hypotheses):
                so_far = ratio[m, h]
                more = likely(
                    at, known[h, 0], known[h, 1], state, end_x, end_y, there, ax, ay, departure, departure_std
                )
                ratio[m, h] = so_far + more / (blocks * BLOCK)
        for h in range(hypotheses if keep else 0):
            last, first = known[h, 0], known[h, 1]
            worth = common * level[0] * ratio[m, h]
            if last >= 0 or first >= 0:
                worth = common * level[1] * DOUBLE_SHARE * ratio[m, h]
            ratio[m, h] = 0.0
            if worth > least:
                ratio[m, h] = worth
                angle, offset = line_of(mean, heard, place, m, last, first)
                line[m, h, 0], line[m, h, 1] = angle, offset


@quick
@ti.kernel
def glance(
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] of the belief
    hit: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [B, 2] known surface hit last, first; -1: the new one
    fresh: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [B, 2] the new one's line
    anchor: ti.i32,
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 3] anchors: x, y, orientation
    occupied: ti.types.ndarray(dtype=ti.f32, ndim=3),  # [2, ny, nx] o of a traversed cell, of a hit one in V
    frame: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [6] origin x, y, side, factor outside, unused (2)
    line: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [1 or more, LINES, LANES] scratch
    place: ti.types.ndarray(dtype=ti.i32, ndim=3),  # [1 or more, PLACES, LANES] scratch
    state: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [3 + 3 (S + 1), 1] scratch
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [1, 4] scratch
    drawn: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [1, 14] scratch
    validity: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [B] out: V, -1 where the path is impossible
):
    """Cast the path of every birth at the mean of the belief: V, eq. (1) of paper 003.

    One ray at a time: there are few, and waking other threads takes longer than this.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        surfaces = (mean.shape[0] - 5) // 2
        stand_at(mean, state)
        own = 3 + 3 * surfaces
        for b in range(hit.shape[0]):
            state[own, 0], state[own + 1, 0] = cos_of(fresh[b, 0]), sin_of(fresh[b, 0])
            state[own + 2, 0] = fresh[b, 1]
            last, first = hit[b, 0], hit[b, 1]
            path[0, 0], path[0, 3] = (1 if last < 0 and first < 0 else 2), anchor
            path[0, 1], path[0, 2] = (surfaces if last < 0 else last), (surfaces if first < 0 else first)
            draw_path(state, path, places, 0, 0, drawn)
            validity[b] = -1.0
            if drawn[0, 12] > 0.5:
                validity[b] = alone(drawn, path[0, 0], occupied, frame, line, place)


@ti.func
def alone(
    drawn: ti.template(), count, occupied: ti.template(), frame: ti.template(), line: ti.template(),
    place: ti.template(),
):  # fmt: skip
    """V of the one ray that is drawn: a bundle of one, which needs none of what makes bundles fast."""
    ny, nx = occupied.shape[1], occupied.shape[2]
    meet_cells(drawn, 0, 1, count, frame, occupied, 0, line, place)
    through = line[0, 0, 0] * line[0, 1, 0]
    start, stop, entry, leave = ti.Vector([0]), ti.Vector([0]), ti.Vector([0]), ti.Vector([0])
    base, slope = ti.Vector([0.0], dt=ti.f64), ti.Vector([0.0], dt=ti.f64)
    for corner in range(count + 1):
        plan = lay_leg(drawn, 0, 1, corner, frame, base, slope, start, stop, entry, leave)
        flat = plan[0] > 0.5
        columns, rows = (nx if flat else ny), (ny if flat else nx)
        for c in range(ti.max(start[0], 0), ti.min(stop[0], columns - 1) + 1):
            lowest, highest = rows_alone(c, base, slope, start, stop, entry, leave)
            for r in range(ti.max(lowest, 0), ti.min(highest, rows - 1) + 1):
                ix, iy = (c if flat else r), (r if flat else c)
                met = False
                for n in range(3 * count):
                    met = met or place[0, n, 0] == iy * nx + ix
                if not met:
                    through *= 1 - occupied[0, iy, ix]
    return through
