"""Where surfaces were hit, and how many anchors saw them."""

import taichi as ti

from gridslam.kernels import LIKELIER_THAN_NOT
from gridslam.kernels.primitives.blocks import Hits
from gridslam.kernels.primitives.functions import cos_of, mirrored, sin_of
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.layout import line_entry
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.tables import ANCHOR, BOUNCES, FIRST, LAST, SHARE_POSSIBLE

NEAR_M = 1e-9
"""A path from a line to it again is reflected anywhere."""
EXPONENT, NO_NUMBER = 52, 0x7FF
"""Bit at which a double's exponent begins, and what it is where the rest is no number."""


@ti.func
def known(value):
    """Whether it is a number; comparisons are optimised as if all were."""
    return ((ti.bit_cast(ti.cast(value, ti.f64), ti.i64) >> EXPONENT) & NO_NUMBER) != NO_NUMBER


@ti.func
def along_of(mean: ti.template(), at, way):
    """Where along a line a path is reflected off it that goes from ``way[:2]`` to ``way[2:]``."""
    nx, ny, offset = cos_of(mean[at]), sin_of(mean[at]), mean[at + 1]
    before, after = ti.abs(nx * way[0] + ny * way[1] - offset), ti.abs(nx * way[2] + ny * way[3] - offset)
    first, last = nx * way[1] - ny * way[0], nx * way[3] - ny * way[2]
    return (first * after + last * before) / ti.max(before + after, NEAR_M)


@ti.func
def way_of(outermost: ti.template(), s, side):
    """The path that hit a surface farthest on one side."""
    return ti.Vector([outermost[s, 4 * side + n] for n in range(4)], dt=ti.f64)


@ti.func
def place_again(s, mean: ti.template(), head, extent: ti.template(), outermost: ti.template()):
    """Put the ends of a stretch where its outermost hits are by the line as it is believed now."""
    for side in ti.static(range(2)):
        if known(outermost[s, 4 * side]):
            extent[s, side] = along_of(mean, line_entry(head, s), way_of(outermost, s, side))
    low, high = extent[s, 0], extent[s, 1]
    if known(low) and low > high:
        extent[s, 0], extent[s, 1] = high, low
        below, above = way_of(outermost, s, 0), way_of(outermost, s, 1)
        for n in ti.static(range(4)):
            outermost[s, n], outermost[s, 4 + n] = above[n], below[n]


@ti.func
def unfolded(path: ti.template(), row, corner, places: ti.template(), mean: ti.template(), head):
    """Where a path comes from and goes to as one of its bounces sees it: the other one is unfolded."""
    bounces, last, first, anchor = path[row, BOUNCES], path[row, LAST], path[row, FIRST], path[row, ANCHOR]
    fx, fy, tx, ty = places[anchor, 0], places[anchor, 1], mean[0], mean[1]
    if bounces == 2:
        other = line_entry(head, last if corner == 0 else first)
        nx, ny, offset = cos_of(mean[other]), sin_of(mean[other]), mean[other + 1]
        if corner == 0:
            tx, ty = mirrored(tx, ty, nx, ny, offset)
        else:
            fx, fy = mirrored(fx, fy, nx, ny, offset)
    return ti.Vector([fx, fy, tx, ty], dt=ti.f64)


@ti.func
def spot(
    path: ti.template(), row, seen: ti.template(), places: ti.template(), mean: ti.template(), head,
    hits: ti.template(), latest: ti.template(),
):  # fmt: skip
    """Remember where a path hit its surfaces, and that its anchor saw them, once each.

    Arguments are those of `mark`; `latest` is the anchor that detected each surface last in this launch.
    """
    bounces, anchor = path[row, BOUNCES], path[row, ANCHOR]
    for corner in range(bounces):  # of a double bounce, the surface that is hit first comes first
        s = path[row, LAST] if corner == bounces - 1 else path[row, FIRST]
        angle = mean[line_entry(head, s)]
        along = cos_of(angle) * seen[row, 3 + 2 * corner] - sin_of(angle) * seen[row, 2 + 2 * corner]
        hits.foot[s] = ti.select(
            known(along), along, hits.foot[s]
        )  # a GPU gets its other entries only if some are read
        way = unfolded(path, row, corner, places, mean, head)
        hit = along_of(mean, line_entry(head, s), way)
        for side in ti.static(range(2)):
            end = hits.extent[s, side]
            if not known(end) or (hit < end if ti.static(side == 0) else hit > end):
                hits.extent[s, side] = hit
                for n in ti.static(range(4)):
                    hits.outermost[s, 4 * side + n] = way[n]
        hits.times[s] += 1 if latest[s] != anchor else 0
        latest[s] = anchor


@quick
@ti.kernel
def mark(
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] of the belief
    head: ti.i32,  # entry where the lines begin: see `layout`
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [L, 4] bounces, last, first, anchor
    seen: ti.types.ndarray(
        dtype=ti.f64, ndim=2
    ),  # [L, 6] unused, share of states where it is possible, first
    # and second corner after the anchor
    share: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [L] probability that the path caused a measurement
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 2 or more] of the anchors
    latest: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [S] scratch
    hits: pack(Hits),
):
    """Remember which surfaces were seen by an anchor, and where they were hit."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for s in range(hits.foot.shape[0]):
            latest[s] = -1
            place_again(s, mean, head, hits.extent, hits.outermost)
        for row in range(path.shape[0]):
            if share[row] * seen[row, SHARE_POSSIBLE] > LIKELIER_THAN_NOT:
                spot(path, row, seen, places, mean, head, hits, latest)
