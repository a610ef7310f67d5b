"""Updates of agent, surfaces and rays by what an anchor heard, once its measurements are associated."""

import taichi as ti

from gridslam.kernels.existence import exist
from gridslam.kernels.fitting import fit
from gridslam.kernels.gaussian import correct
from gridslam.kernels.launching import quick


@quick
@ti.kernel
def update(
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] in/out
    covariance: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, N] in/out
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 4] bounces, last, first, anchor
    start: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [L + 1] where the pairs of each path begin
    index: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [K or more, 2] path and measurement of every pair
    pair: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [K or more, 8] z (3), variance (3), density, unused
    prior: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [4, L] existence of ray and of surfaces, V, p_d
    odds: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [4, L] as `association.enter` leaves them
    ratio: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] likewise
    beta: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] messages into the association
    nu: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] and out of it
    place: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [3] anchor x, y, orientation
    predicted: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, 12] value (3) and spread (9) of every path
    heard: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 9] see `Heard.table`
    blocks: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [L + K, P / BLOCK] as `paths.evaluate` leaves them
    radio: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [11] see `kernels.radio`
    turned: ti.f64,  # rad, by which the anchor is taken to be turned
    scratch: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 6]
    rest: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [L + S or more] scratch
    order: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [L] scratch
    surface: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S] in/out: existence
    sight: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [J] in/out: existence of lines of sight
    single: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, S] in/out: of rays over one surface
    double: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [J, S, S] in/out: over (last, first)
    share: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [K] out: probability of each association
    responsible: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, M] out: the same by path and measurement
    worth: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [L] out: mean of sum_m nu_m g_m + 1 - p_d
    sums: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [9] in/out: see `fitting.SUMS`
):
    """Correct agent and surfaces, update what exists, and note how well all that fits."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        correct(
            mean, covariance, path, start, index, pair, odds, beta, nu, place, scratch, rest, order, share,
            responsible,
        )  # fmt: skip
        fit(path, index, pair, predicted, share, responsible, heard, blocks, radio, turned, sums)
        exist(path, prior, odds, ratio, nu, rest, surface, sight, single, double, worth)
