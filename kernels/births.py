"""How well a new surface would explain a measurement, as a mean over samples (paper 002, section V-B)."""

import taichi as ti

from gridslam.kernels.device import SPREAD
from gridslam.kernels.functions import (
    TURN,
    angle_of,
    cos_of,
    double_bounce,
    exp_of,
    mirrored,
    sin_of,
    single_bounce,
    wrapped,
)
from gridslam.kernels.launching import quick

ROOT_TURN = 2.5066282746310002


@quick
@ti.kernel
def propose(
    state: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [3 + 3 S, P] x, y, heading; per line normal x, y, offset
    noise: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [2, B] standard normal, for as many states
    heard: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 6] distance, AoD, AoA and their deviations
    known: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [H, 2] known surface hit last, first; -1: the new one
    place: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [3] anchor x, y, orientation
    weight: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, H] out: mean of f(AoD) / span, 0 where impossible
):
    """Draw distance and AoA around the measurement, make the new line, and judge it by the AoD.

    An infinite deviation of the AoD stands for "not measured": its density is then 1 / (2 pi).
    """
    for item in range(heard.shape[0] * SPREAD):
        if item % SPREAD == 0:
            m = item // SPREAD
            hypotheses, samples = known.shape[0], ti.min(noise.shape[1], state.shape[1])
            for h in range(hypotheses):
                weight[m, h] = 0.0
            for k in range(samples):
                distance = heard[m, 0] + heard[m, 3] * noise[0, k]
                bearing = heard[m, 2] + heard[m, 5] * noise[1, k] + state[2, k]
                px, py = ti.cast(state[0, k], ti.f64), ti.cast(state[1, k], ti.f64)
                ax, ay = place[0], place[1]
                end_x, end_y = px + distance * cos_of(bearing), py + distance * sin_of(bearing)
                for h in range(hypotheses):
                    last, first = known[h, 0], known[h, 1]
                    s, r = 3 + 3 * last, 3 + 3 * first
                    vx, vy, sx, sy = end_x, end_y, ax, ay
                    if last >= 0:
                        vx, vy = mirrored(vx, vy, state[s, k], state[s + 1, k], state[s + 2, k])
                    if first >= 0:
                        sx, sy = mirrored(sx, sy, state[r, k], state[r + 1, k], state[r + 2, k])
                    span = ti.sqrt((vx - sx) ** 2 + (vy - sy) ** 2)
                    if span > 1e-2 and distance > 0:
                        nx, ny = (vx - sx) / span, (vy - sy) / span
                        c = 0.5 * (nx * (vx + sx) + ny * (vy + sy))
                        wx, wy, ok = 0.0 * px, 0.0 * px, 0.0 * px
                        if last < 0 and first < 0:
                            _, _, wx, wy, ok = single_bounce(px, py, ax, ay, nx, ny, c)
                        elif last >= 0:
                            ex, ey, e = state[s, k], state[s + 1, k], state[s + 2, k]
                            _, _, wx, wy, ok = double_bounce(px, py, ax, ay, ex, ey, e, nx, ny, c)
                        else:
                            ex, ey, e = state[r, k], state[r + 1, k], state[r + 2, k]
                            _, _, wx, wy, ok = double_bounce(px, py, ax, ay, nx, ny, c, ex, ey, e)
                        if ok > 0.5:
                            density = ti.cast(1 / TURN, ti.f32)
                            if heard[m, 4] < 1e6:
                                toward = angle_of(ti.cast(wx, ti.f32), ti.cast(wy, ti.f32))
                                gap = wrapped(heard[m, 1] + place[2] - toward) / heard[m, 4]
                                density = exp_of(ti.cast(-0.5 * gap * gap, ti.f32)) / (
                                    heard[m, 4] * ROOT_TURN
                                )
                            weight[m, h] += density / (span * samples)
