"""Paths as functions of the whole state, for the joint mode of agent and surfaces (docs/model.md, (M151))."""

import taichi as ti

from gridslam.kernels.primitives.gaussian import entry_of, path_of
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.tables import BOUNCES, FIRST, LAST


@quick
@ti.kernel
def trace_paths(
    head: ti.i32,  # entry of the mean where the lines begin: see `layout`
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N]
    root: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, N] the state's derivatives by what moves it
    spot: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [5] x, y, orientation, clock and height of the anchor
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 4] bounces, last, first, anchor
    value: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [L, 3] out: length, AoD, AoA
    turn: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [L, 3, N] out: their derivatives
):
    """Length and angles of every path at a state, and their derivatives through a root of its covariance."""
    ti.loop_config(serialize=True)
    for row in range(path.shape[0]):
        bounces, last, first = path[row, BOUNCES], path[row, LAST], path[row, FIRST]
        place = ti.Vector([spot[0], spot[1], spot[2], spot[3], spot[4]], dt=ti.f64)
        values, slope = path_of(mean, head, place, bounces, last, first)
        entry = entry_of(head, bounces, last, first)
        for q in ti.static(range(3)):
            value[row, q] = values[q]
            for n in range(mean.shape[0]):
                total = ti.f64(0.0)
                for k in ti.static(range(7)):
                    total += slope[q, k] * root[entry[k], n]
                turn[row, q, n] = total
