"""Rays: which paths there may be, as they are predicted, and which measurements lie near."""

import taichi as ti

from gridslam.kernels.functions import wrapped
from gridslam.kernels.gaussian import predict_by
from gridslam.kernels.launching import quick
from gridslam.kernels.radio import GIVEN, HERE, SCALE, THERE, THRESHOLD

STRONG = 0.3
"""Existence from which on a surface may take part in a double bounce, and explain a loud measurement."""
GATE = 4.0
"""Standard deviations within which a measurement lies where its path is predicted."""
ROOT_8_PI = 8.885765876316732


@quick
@ti.kernel
def foresee(
    only: ti.i32,  # the anchor; -1 for all, one after the other
    bounces: ti.i32,  # at most; single ones are always listed
    stay: ti.f64,  # probabilities that a ray stays and that one appears: 1 and 0 list them as they are
    appear: ti.f64,
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N]
    covariance: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, N]
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 3] anchors: x, y, orientation
    surface: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S] existence
    owner: ti.types.ndarray(dtype=ti.i64, ndim=1),  # [S] the one anchor that a surface serves; -1 for all
    sight: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [J] existence of lines of sight
    single: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, S] of rays over one surface
    double: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [J, S, S] over (last, first)
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [J (1 + S S), 4] out: bounces, last, first, anchor
    existence: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [J (1 + S S)] out: of the ray
    surfaces: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [J (1 + S S)] out: of all surfaces involved
    predicted: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J (1 + S S), 12] out: value (3), spread (9)
    found: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [1] out: how many there are
):
    """List and predict paths: line of sight, single bounces, double bounces."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        count, n = surface.shape[0], 0
        for anchor in range(ti.max(only, 0), places.shape[0] if only < 0 else only + 1):
            for kind in range(3 if bounces > 1 else 2):
                for s in range(1 if kind == 0 else count):
                    for r in range(count if kind == 2 else 1):
                        there, chance, together = True, sight[anchor], ti.cast(1.0, ti.f64)
                        last, first = -1, -1
                        if kind == 1:
                            there = owner[s] == -1 or owner[s] == anchor
                            chance, together, last, first = single[anchor, s], surface[s], s, s
                        elif kind == 2:
                            there = s != r and surface[s] > STRONG and surface[r] > STRONG
                            chance, together = double[anchor, s, r], surface[s] * surface[r]
                            last, first = s, r
                        if there:
                            path[n, 0], path[n, 1], path[n, 2], path[n, 3] = kind, last, first, anchor
                            existence[n], surfaces[n] = appear + chance * (stay - appear), together
                            n += 1
        for row in range(n):
            predict_by(mean, covariance, path, places, row, predicted)
        found[0] = n


@quick
@ti.kernel
def near(
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 4] bounces, last, first, anchor
    surfaces: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [L] existence of all surfaces involved
    predicted: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, 12] value (3), spread (9)
    start: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [J + 1] where the measurements of each anchor begin
    heard: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 9] see `Heard.table`
    radio: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 11] see `kernels.radio`
    claimed: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [M] out: 1 where a loud measurement lies near a path
):
    """Find the loud measurements that lie where a path is predicted.

    Which way an array faces doesn't matter here.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        for m in range(heard.shape[0]):
            claimed[m] = 0
        for row in range(path.shape[0]):
            anchor = path[row, 3]
            scale, threshold = radio[anchor, SCALE], radio[anchor, THRESHOLD]
            there = 0.5 * (radio[anchor, THERE] + radio[anchor, THERE + 1])
            here = 0.5 * (radio[anchor, HERE] + radio[anchor, HERE + 1])
            for m in range(start[anchor], start[anchor + 1] if surfaces[row] > STRONG else start[anchor]):
                if heard[m, 7] > 0.5:
                    amplitude = heard[m, 6] if heard[m, 6] >= 0 else threshold
                    far = ti.cast(0.0, ti.f64)
                    for q in range(3):
                        gap, std = heard[m, q] - predicted[row, q], heard[m, 3 + q]
                        if q > 0:
                            gap = wrapped(gap)
                        if std == 0:
                            square = there if q == 1 else here
                            std = 1 / (ROOT_8_PI * amplitude * ti.sqrt(ti.max(square, 1e-30)))
                            if q == 0:
                                std = radio[anchor, GIVEN] if radio[anchor, GIVEN] > 0 else scale / amplitude
                        if std >= 0:  # what wasn't measured is near
                            far += gap * gap / (predicted[row, 3 + 4 * q] + std * std)
                    if far < GATE * GATE:
                        claimed[m] = 1
