"""Lengths and angles of paths at a joint state, and how they scatter by the prior; docs/model.md, (M281)."""

import taichi as ti

from gridslam.kernels.primitives.functions import bearing_of, cos_of, sin_of
from gridslam.kernels.primitives.launching import quick

NUMBER, OFF, SHIFT, OWN = 0, 1, 2, 3
"""Rows of `paths`: lengths and angles theta(x) + epsilon, and J (x - m) + epsilon, both out; epsilon, and
its variances R."""
LEAST_M = 0.1
"""Shorter paths are taken to be as long as this."""
SLOPES = 6
"""Entries of the state that move a path: the agent's x, y, the heading's error, the feature's own three."""


@ti.func
def moved_by(e, own, last):
    """Number in the state of the e-th entry that moves a path; of a line of sight, any stands for its own."""
    return ti.select(e < 2, e, ti.select(e == 2, last, ti.max(own, 0) + e - 3))


@ti.func
def place_path(
    start, count, n, own, heading, state: ti.template(), origin: ti.template(), half, paths: ti.template(),
    slopes: ti.template(),
):  # fmt: skip
    """Length and angle of a path, and their slopes."""
    x, y = origin[half + n, 0] - state[0, 0], origin[half + n, 1] - state[0, 1]
    out, extra, ahead, beside = ti.f64(0.0), ti.f64(0.0), ti.f64(0.0), ti.f64(0.0)
    if own >= 0:
        extra = state[0, own + 2]
        out, ahead, beside = (
            state[0, own] - extra,
            cos_of(state[0, own + 1]),
            sin_of(state[0, own + 1]),
        )
        x, y = x + out * ahead, y + out * beside
    far = ti.max(ti.sqrt(x * x + y * y), ti.f64(LEAST_M))
    one, two = start + n, start + count + n
    paths[NUMBER, one] = ti.max(far + extra, ti.f64(LEAST_M)) + paths[SHIFT, one]
    paths[NUMBER, two] = bearing_of(x, y) - heading - state[0, state.shape[1] - 1] + paths[SHIFT, two]
    x, y = x / far, y / far
    slopes[one, 0], slopes[one, 1], slopes[one, 2] = -x, -y, 0.0
    slopes[two, 0], slopes[two, 1], slopes[two, 2] = y / far, -x / far, -1.0
    along, across = x * ahead + y * beside, x * beside - y * ahead
    slopes[one, 3], slopes[two, 3] = along, across / far
    slopes[one, 4], slopes[two, 4] = -out * across, out * along / far
    slopes[one, 5], slopes[two, 5] = ti.select(own >= 0, 1 - along, 0.0), -across / far


@quick
@ti.kernel
def place_paths(
    state: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [2, n + 1] x, where slopes are taken, and prior mean m:
    # joint state, error of the heading
    prior: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [n + 1, n + 1] covariance P
    origin: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [p / 2, 2] of each path: its anchor, or from where its
    # feature's length and direction are counted, m
    own: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [p / 2] first of the feature's entries; line of sight: -1
    first: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [A + 1] of every anchor's numbers: lengths, then angles
    heading: ti.f64,  # measured, rad
    paths: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [4, p] see `NUMBER`
    slopes: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [p, SLOPES] out: by the entries of `moved_by`
    towards: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [p, n + 1] out: J P
    spread: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [p, p] out: J P J^T + R
):
    """Numbers of all anchors' paths, and their covariances with the state and each other; serial."""
    ti.loop_config(serialize=True)
    for a in range(first.shape[0] - 1):
        start, count, size = first[a], (first[a + 1] - first[a]) // 2, state.shape[1]
        for n in range(count):
            place_path(
                start, count, n, own[start // 2 + n], heading, state, origin, start // 2, paths, slopes
            )
        for i in range(start, start + 2 * count):
            mine = own[start // 2 + ti.select(i < start + count, i - start, i - start - count)]
            paths[OFF, i] = paths[SHIFT, i]
            for e in ti.static(range(SLOPES)):
                entry = moved_by(e, mine, size - 1)
                paths[OFF, i] += slopes[i, e] * (state[0, entry] - state[1, entry])
            for k in range(size):
                total = ti.f64(0.0)
                for e in ti.static(range(SLOPES)):
                    total += slopes[i, e] * prior[moved_by(e, mine, size - 1), k]
                towards[i, k] = total
    ti.loop_config(serialize=True)
    for a in range(first.shape[0] - 1):
        start, count, size = first[a], (first[a + 1] - first[a]) // 2, state.shape[1]
        for k in range(start, start + 2 * count):
            mine = own[start // 2 + ti.select(k < start + count, k - start, k - start - count)]
            for i in range(first[first.shape[0] - 1]):
                total = ti.f64(0.0)
                for e in ti.static(range(SLOPES)):
                    total += slopes[k, e] * towards[i, moved_by(e, mine, size - 1)]
                spread[i, k] = total
            spread[k, k] += paths[OWN, k]
