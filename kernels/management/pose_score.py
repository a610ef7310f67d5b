"""What one scan says of poses: lines of sight, new bounces, clutter; and known surfaces, if there is a map.

docs/model.md, section 14. Most measurements agree with most poses in nothing, and cost a few products then:
exponentials and angles are worked out only where they may add more than `LEAST`.
"""

import taichi as ti

from gridslam.kernels.primitives.blocks import Clues
from gridslam.kernels.primitives.clues import (
    AMPLITUDE,
    ANY,
    AOA,
    AOD,
    AT_1M,
    BORN,
    CHANCE,
    COEFFICIENT,
    DISTANCE,
    FIT,
    HEIGHT,
    IMAGE,
    KNOWN_FROM,
    KNOWN_TO,
    NEAR,
    NORMAL,
    OFFSET,
    OVER,
    PEAK,
    SAMPLES,
    SCAN_FROM,
    SCAN_TO,
    SIDE,
    STRAIGHT,
    SURE,
    TOWARD,
    TURN,
    TURNED,
    X,
    Y,
)
from gridslam.kernels.primitives.functions import (
    bearing_of,
    cos_of,
    decay_of,
    logarithm_of,
    sin_of,
    slant_of,
    wrapped,
)
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.radio import amplitude_of, detection_of, log_rician

LEAST, MOST, MOST_RATIO = -45.0, 60.0, 1.1420073898156842e26
"""Logs of the least ratio of one measurement to clutter that is worked out, and of the largest; and that."""
LARGE = 1e9
"""Products beyond this are taken the logarithm of: times one more ratio they fit into single precision."""
CHUNK = 64
"""Poses that one task takes."""


@ti.func
def ratio_of(clues: ti.template(), a, step, m, log, length, coefficient):
    """Ratio to clutter of a path of this length, by the log that geometry alone says; 0 if it is so small."""
    ratio = ti.f64(0.0)
    if log + clues.measured[m, PEAK] > LEAST:
        amplitude = amplitude_of(clues.listener[a, AT_1M] * coefficient, length)
        if clues.measured[m, AMPLITUDE] >= 0:
            measured, samples = clues.measured[m, AMPLITUDE], clues.listener[a, SAMPLES]
            log += log_rician(measured, ti.max(amplitude, 1e-6), samples)
        else:
            log += logarithm_of(ti.max(detection_of(amplitude, clues.chance, step), 1e-12))
        ratio = decay_of(ti.min(log, MOST))
    return ratio


@ti.func
def fit_of(clues: ti.template(), m, first, gap, off, turn):
    """Log density of a measurement that misses what is predicted by so much; see `STRAIGHT`."""
    far = clues.measured[m, first] * gap * gap + clues.measured[m, first + 1] * off * off
    return clues.measured[m, first + 3] - 0.5 * (far + clues.measured[m, first + 2] * turn * turn)


@ti.func
def straight(clues: ti.template(), a, step, m, heading, leaving, back, length):
    """Ratio to clutter of the line of sight."""
    gap, off = clues.measured[m, DISTANCE] - length, wrapped(clues.measured[m, AOD] - leaving)
    turn = wrapped(heading + clues.measured[m, AOA] - back)
    return ratio_of(clues, a, step, m, fit_of(clues, m, STRAIGHT, gap, off, turn), length, 1.0)


@ti.func
def born(clues: ti.template(), m, ax, ay, c, s, nearest):
    """Ratio to clutter of a new single bounce, to an agent at (ax, ay) from the anchor that faces (c, s)."""
    tx, ty = clues.measured[m, TOWARD], clues.measured[m, TOWARD + 1]
    x, y = ax + tx, ay + ty
    if clues.measured[m, STRAIGHT + 2] > 0:  # an arrival, as the agent faces
        x, y = ax + c * tx - s * ty, ay + s * tx + c * ty
    square, along, aside = x * x + y * y, x * x - y * y, 2 * x * y
    # by how much the AoD misses it: its cosine and sine, times the square
    one, two = clues.measured[m, TURNED], clues.measured[m, TURNED + 1]
    ct, st = c * one - s * two, s * one + c * two
    near, fits = along * ct + aside * st, clues.measured[m, ANY]
    if near > clues.measured[m, NEAR] * square:
        miss = bearing_of(near, along * st - aside * ct)
        fits += clues.measured[m, FIT] * decay_of(-0.5 * clues.measured[m, SURE] * miss * miss)
    return ti.min(clues.measured[m, BORN] * fits / ti.max(ti.sqrt(square), nearest), MOST_RATIO)


@ti.func
def known_length(clues: ti.template(), a, k, x, y):
    """Length of a single bounce over a known surface; 0 if agent and anchor stand on two sides of it."""
    gap = clues.known[k, NORMAL] * x + clues.known[k, NORMAL + 1] * y - clues.known[k, OFFSET]
    dx, dy = clues.known[k, IMAGE] - x, clues.known[k, IMAGE + 1] - y
    length = slant_of(dx * dx + dy * dy, clues.listener[a, HEIGHT])
    return ti.select(gap * clues.known[k, SIDE] > 0, length, 0.0)


@ti.func
def over_known(clues: ti.template(), a, step, m, k, x, y, heading, length):
    """Ratio to clutter of a single bounce of this length over a known surface."""
    gap, ratio = clues.measured[m, DISTANCE] - length, ti.f64(0.0)
    if fit_of(clues, m, OVER, gap, 0.0, 0.0) + clues.measured[m, PEAK] > LEAST:
        back = bearing_of(clues.known[k, IMAGE] - x, clues.known[k, IMAGE + 1] - y)
        off = wrapped(clues.measured[m, AOD] - clues.known[k, TURN] + back)
        turn = wrapped(clues.measured[m, AOA] - back + heading)
        log = fit_of(clues, m, OVER, gap, off, turn)
        ratio = ratio_of(clues, a, step, m, log, length, clues.known[k, COEFFICIENT])
    return clues.known[k, CHANCE] * ratio


@quick
@ti.kernel
def score_poses(
    in_sight: ti.f64,  # chance that an anchor is in sight
    nearest: ti.f64,  # from an anchor to its image, at least (m)
    step: ti.f64,  # amplitude from one entry of the table of p_d to the next
    poses: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 3] x, y (m), heading (rad)
    clues: pack(Clues),
    score: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] out: log-likelihood of the scan over that of clutter
):
    """Score poses by one scan."""
    ti.loop_config(block_dim=1)
    for chunk in range((poses.shape[0] + CHUNK - 1) // CHUNK):
        for n in range(chunk * CHUNK, ti.min((chunk + 1) * CHUNK, poses.shape[0])):
            x, y, heading = poses[n, 0], poses[n, 1], poses[n, 2]
            c, s, total = cos_of(heading), sin_of(heading), ti.f64(0.0)
            product = ti.f64(1.0)  # a logarithm for many ratios
            for a in range(clues.listener.shape[0]):
                ax, ay = x - clues.listener[a, X], y - clues.listener[a, Y]
                length = slant_of(ax * ax + ay * ay, clues.listener[a, HEIGHT])
                leaving, back = bearing_of(ax, ay), bearing_of(-ax, -ay)
                at_1m = clues.listener[a, AT_1M]
                total -= in_sight * detection_of(amplitude_of(at_1m, length), clues.chance, step)
                for k in range(clues.own[a, KNOWN_FROM], clues.own[a, KNOWN_TO]):
                    over = known_length(clues, a, k, x, y)
                    if over > 0:
                        level = amplitude_of(at_1m * clues.known[k, COEFFICIENT], over)
                        total -= clues.known[k, CHANCE] * detection_of(level, clues.chance, step)
                for m in range(clues.own[a, SCAN_FROM], clues.own[a, SCAN_TO]):
                    ratio = straight(clues, a, step, m, heading, leaving, back, length)
                    if length < clues.measured[m, DISTANCE]:  # or the point of reflection isn't between
                        ratio += born(clues, m, ax, ay, c, s, nearest)
                    for k in range(clues.own[a, KNOWN_FROM], clues.own[a, KNOWN_TO]):
                        over = known_length(clues, a, k, x, y)
                        if over > 0:
                            ratio += over_known(clues, a, step, m, k, x, y, heading, over)
                    product *= 1 + ratio
                    if product > LARGE:
                        total += logarithm_of(product)
                        product = 1.0
            score[n] = total + logarithm_of(product)
