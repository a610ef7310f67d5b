"""Where surfaces were hit, and how many anchors saw them."""

import taichi as ti

from gridslam.kernels.primitives.functions import cos_of, sin_of
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.layout import line_entry

LIKELIER_THAN_NOT = 0.5
"""Probability of having caused a measurement above which a path shows that its surfaces are there."""
EXPONENT, NO_NUMBER = 52, 0x7FF
"""Bit at which a double's exponent begins, and what it is where the rest is no number."""


@ti.func
def known(value):
    """Whether it is a number; comparisons are optimised as if all were."""
    return ((ti.bit_cast(ti.cast(value, ti.f64), ti.i64) >> EXPONENT) & NO_NUMBER) != NO_NUMBER


@ti.func
def spot(
    path: ti.template(), row, seen: ti.template(), mean: ti.template(), head, foot: ti.template(),
    extent: ti.template(), times: ti.template(), latest: ti.template(),
):  # fmt: skip
    """Remember where a path hit its surfaces, and that its anchor saw them, once each.

    Arguments are those of `mark`; `latest` is the anchor that detected each surface last in this launch.
    """
    bounces, anchor = path[row, 0], path[row, 3]
    for corner in range(bounces):  # of a double bounce, the surface that is hit first comes first
        s = path[row, 1] if corner == bounces - 1 else path[row, 2]
        angle = mean[line_entry(head, s)]
        along = cos_of(angle) * seen[row, 3 + 2 * corner] - sin_of(angle) * seen[row, 2 + 2 * corner]
        before, low, high = times[s], extent[s, 0], extent[s, 1]
        foot[s] = ti.select(
            known(along), along, foot[s]
        )  # a GPU gets its other entries only if some are read
        extent[s, 0] = ti.min(low, along) if known(low) else along
        extent[s, 1] = ti.max(high, along) if known(high) else along
        times[s] = before + (1 if latest[s] != anchor else 0)
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
    latest: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [S] scratch
    foot: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S] in/out: tangential coordinate of the latest hit
    extent: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [S, 2] in/out: stretch that was hit, if any was
    times: ti.types.ndarray(dtype=ti.i64, ndim=1),  # [S] in/out: detections, one per anchor at most, if its
    # paths follow each other
):
    """Remember which surfaces were seen by an anchor, and where they were hit."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for s in range(foot.shape[0]):
            latest[s] = -1
        for row in range(path.shape[0]):
            if share[row] * seen[row, 1] > LIKELIER_THAN_NOT:
                spot(path, row, seen, mean, head, foot, extent, times, latest)
