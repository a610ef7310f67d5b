"""Data association of measurements of one anchor, or of all, and the updates by it."""

from functools import cache

import taichi as ti

from gridslam.kernels.messages.association import exchange
from gridslam.kernels.messages.existence import exist
from gridslam.kernels.messages.fitting import fit
from gridslam.kernels.primitives.gaussian import correct
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.propagation.path_messages import note


def _kernel(clocks):
    """The kernel of a state with clocks, or without: known clocks cost nothing, not even in rounding."""

    @ti.kernel
    def update(
        mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] in/out
        covariance: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, N] in/out
        head: ti.i32,  # entry of the mean where the lines begin: see `layout`
        path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 4] bounces, last, first, anchor
        start: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [L + 1] where the pairs of each path begin
        index: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [K or more, 2] path and measurement of every pair
        pair: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [K or more, 8] z (3), variance (3), density, unused
        odds: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [12, L] in/out: see `tables`; eight are given
        rounds: ti.i32,  # of association at most; 0 where it was done elsewhere
        places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 3] anchors: x, y, orientation
        predicted: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, 13] value, spread and length of every path
        heard: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 10] see `AnchorScan.table`
        blocks: ti.types.ndarray(
            dtype=ti.f32, ndim=2
        ),  # [L + K, P / BLOCK] as `evaluation.evaluate` leaves them
        radio: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 11] see `radio`
        turned: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [J] rad, by which anchors are taken to be turned
        scratch: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 6] scratch
        message: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [5, L, M] in/out: see `tables`; the first two
        # are given, and `NU` if association was done elsewhere
        measured: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [4, M] in/out: `NEW` is given, and `CLAIMED`
        surface: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S] in/out: existence
        sight: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [J] in/out: existence of lines of sight
        single: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, S] in/out: of rays over one surface
        double: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [J, S, S] in/out: over (last, first)
        share: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [K or more] out: probability of each association
        sums: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 9] in/out: see `kernels.SUMS`
        count: ti.types.ndarray(
            dtype=ti.i32, ndim=1
        ),  # [2] in/out: paths and pairs of earlier anchors, of all
        noted: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [0; or room, 4] in/out: see `path_messages`
        factor: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [room, 2] in/out
        told: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [4, room] in/out: see `path_messages`
        begin: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [room + 1] in/out
        said: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [2, room] in/out
    ):
        """Associate; correct agent and surfaces; update existence; sum up the fit; append messages."""
        ti.loop_config(serialize=True)
        for _ in range(1):
            if rounds > 0:
                exchange(odds, message, measured, rounds)
            correct(
                mean, covariance, head, path, start, index, pair, odds, message, places, scratch, share,
                clocks,
            )  # fmt: skip
            fit(path, start, index, pair, predicted, share, message, heard, blocks, radio, turned, sums)
            exist(path, odds, message, scratch, surface, sight, single, double)
            if noted.shape[0] > 0:
                note(
                    path, start, index, odds, predicted, heard, share, count, noted, factor, told, begin, said
                )

    return update


update = quick(_kernel(False))


@cache
def update_with_clocks():
    """The kernel `update` of a state with clocks."""
    return quick(_kernel(True))
