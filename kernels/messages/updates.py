"""Data association of measurements of one anchor, or of all, and the updates by it."""

from functools import cache

import taichi as ti

from gridslam.kernels.messages.association import exchange
from gridslam.kernels.messages.existence import exist
from gridslam.kernels.messages.fitting import fit
from gridslam.kernels.primitives.blocks import (
    Account,
    Anchors,
    Belief,
    Existence,
    Messages,
    Pairs,
    PathRows,
    Ratios,
)
from gridslam.kernels.primitives.corrections import CLOCKS_OPEN, NONE_OPEN, RISES_OPEN, correct
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.propagation.path_messages import note


def _kernel(open):
    """The kernel of a state with clocks, rises or neither: known ones cost nothing, not even in rounding."""

    @ti.kernel
    def update(
        head: ti.i32,  # entry of the mean where the lines begin: see `layout`
        rounds: ti.i32,  # of association at most; 0 where it was done elsewhere
        belief: pack(Belief),  # in and out
        rows: pack(PathRows),
        pairs: pack(Pairs),
        ratios: pack(
            Ratios
        ),  # in and out: of `message` the first two are given, and `NU` if it was done elsewhere
        scan: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 10] see `AnchorScan.table`
        anchors: pack(Anchors),
        existence: pack(Existence),
        account: pack(Account),
        messages: pack(Messages),
    ):
        """Associate; correct agent and surfaces; update existence; sum up the fit; append messages."""
        ti.loop_config(serialize=True)
        for _ in range(1):
            if rounds > 0:
                exchange(ratios.odds, ratios.message, ratios.measured, rounds)
            correct(belief, head, rows.path, pairs, ratios, anchors.places, account, open)
            fit(rows, pairs, ratios.message, scan, anchors.radio, account)
            exist(
                rows.path, ratios.odds, ratios.message, account.scratch, existence.surface, existence.sight,
                existence.single, existence.double,
            )  # fmt: skip
            if messages.noted.shape[0] > 0:
                note(rows, pairs, ratios, scan, account.share, messages)

    return update


update = quick(_kernel(NONE_OPEN))


@cache
def update_with_clocks():
    """The kernel `update` of a state with clocks."""
    return quick(_kernel(CLOCKS_OPEN))


@cache
def update_with_rises():
    """The kernel `update` of a state with rises."""
    return quick(_kernel(RISES_OPEN))
