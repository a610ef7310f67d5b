"""Features moved up the slopes of the likelihood by Adam, many steps in one launch; docs/model.md, (M401)."""

import taichi as ti

from gridslam.kernels.messages.feature_likelihood import differentiate, factorise, invert
from gridslam.kernels.messages.feature_responses import (
    SIDE,
    SLOPE,
    Outputs,
    Side,
    multiply,
    pairs_of,
    place_features,
    project,
)
from gridslam.kernels.primitives.blocks import Ascent
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.packing import pack

SCATTERED, FREE = 1, 2
"""Kinds of features: the extra length is its way to the anchor, or any; of others it stays."""
FORGETS, FORGETS_SQUARES = 0.1, 0.001
"""Shares by which Adam's means of slopes and of their squares follow."""
DONE, UNIT, FAINTEST, RATE = 0, 1, 2, 3
"""Places of `Ascent.plan`: steps taken before, unit of power, least power in it, longest step of each of
x, y, extra length (m) and power (units)."""
NONE_M = 1e-3
MEAN, SQUARE, NOW = 0, 1, 2
"""Tables of `Ascent.slopes`: means, means of squares, and the slopes where features are."""


@ti.func
def rise(
    points: ti.template(), step: ti.template(), features: ti.template(), anchor: ti.template(),
    element: ti.template(), table: ti.template(), pulse: ti.template(), reach: ti.template(), first,
    scratch: ti.template(), gram: ti.template(), slopes: ti.template(),
):  # fmt: skip
    """Sum of A over all points; that of its slopes by the features from `first` on, into `slopes`."""
    total, count, pairs = ti.f64(0.0), features.shape[0], pairs_of(element)
    for n in range(first, count):
        for e in ti.static(range(4)):
            slopes[NOW, n - first, e] = 0.0
    for block in range((points.shape[0] + SIDE - 1) // SIDE):
        p = block * SIDE
        place_features(p, 0, pairs, points, features, anchor, element, table, step, reach, scratch, True)
        project(0, count, pairs, pulse, reach[0], scratch)
        multiply(0, count, pairs, pulse, reach[0], scratch, gram, True)
        value = factorise(0, count, scratch, gram)
        invert(0, count, first, scratch, gram)
        differentiate(0, count, first, scratch, gram)
        for i in ti.static(range(SIDE)):
            if p + i < points.shape[0]:
                total += value[i]
                for n in range(first, count):
                    for e in ti.static(range(4)):
                        slopes[NOW, n - first, e] += scratch[0, n, SLOPE + e][i]
    return total


@ti.func
def move(
    moves, features: ti.template(), anchor: ti.template(), kind: ti.template(), plan: ti.template(),
    slopes: ti.template(),
):  # fmt: skip
    """The `moves`-th step of Adam of the last features, each within what its kind allows."""
    first = features.shape[0] - kind.shape[0]
    for k in range(kind.shape[0]):
        x, y = features[first + k, 0] - anchor[0], features[first + k, 1] - anchor[1]
        far = ti.max(ti.sqrt(x * x + y * y), NONE_M)
        if kind[k] == SCATTERED:  # its extra length moves with it
            slopes[NOW, k, 0] += slopes[NOW, k, 2] * x / far
            slopes[NOW, k, 1] += slopes[NOW, k, 2] * y / far
        if kind[k] != FREE:
            slopes[NOW, k, 2] = 0.0
        for e in ti.static(range(4)):
            scale = plan[UNIT] if e == 3 else 1.0
            slope = slopes[NOW, k, e] * scale
            slopes[MEAN, k, e] += FORGETS * (slope - slopes[MEAN, k, e])
            slopes[SQUARE, k, e] += FORGETS_SQUARES * (slope * slope - slopes[SQUARE, k, e])
            mean = slopes[MEAN, k, e] / (1 - ti.pow(ti.cast(1 - FORGETS, ti.f64), moves))
            square = slopes[SQUARE, k, e] / (1 - ti.pow(ti.cast(1 - FORGETS_SQUARES, ti.f64), moves))
            features[first + k, e] += scale * plan[RATE + e] * mean / (ti.sqrt(square) + 1e-12)
        features[first + k, 2] = ti.max(features[first + k, 2], 0.0)
        features[first + k, 3] = ti.max(features[first + k, 3], plan[FAINTEST] * plan[UNIT])
        if kind[k] == SCATTERED:
            x, y = features[first + k, 0] - anchor[0], features[first + k, 1] - anchor[1]
            features[first + k, 2] = ti.sqrt(x * x + y * y)


@quick
@ti.kernel
def climb_features(
    points: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [P, 4] x, y (m), heading (rad), noise power
    step: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [P] which table a point belongs to
    features: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [D, 4] in and out: x, y, extra length (m), power
    anchor: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] m
    element: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 2] 2 pi / wavelength times place, own frame
    table: ti.types.ndarray(dtype=Outputs, ndim=3),  # [K, N, T] matched outputs re, im; slopes re, im
    pulse: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [T, 2] correlation of the pulse over length, slope
    reach: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [2] rows of tables per metre; longest path heard, m
    kind: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [n] of the last features; those before them stay
    scratch: ti.types.ndarray(dtype=Side, ndim=3),  # [1, D + 1, ARRAY + 3 N]
    gram: ti.types.ndarray(dtype=Side, ndim=3),  # [1, BLOCKS D, D]
    ascent: pack(Ascent),
):
    """As many steps as `ascent.value` has places; the best features on the way are kept.

    Serial: each step needs the sum over all points of the one before, and points are few.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        first = features.shape[0] - kind.shape[0]
        for i in range(ascent.value.shape[0]):
            ascent.value[i] = rise(
                points, step, features, anchor, element, table, pulse, reach, first, scratch, gram,
                ascent.slopes,
            )  # fmt: skip
            if ascent.value[i] > ascent.highest[0]:
                ascent.highest[0] = ascent.value[i]
                for n in range(features.shape[0]):
                    for e in ti.static(range(4)):
                        ascent.best[n, e] = features[n, e]
            move(ascent.plan[DONE] + i + 1, features, anchor, kind, ascent.plan, ascent.slopes)
