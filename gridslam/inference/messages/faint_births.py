"""Births that earlier measurements bear out: walls that are heard too seldom to be told from clutter at once;
owner of the kernel that says how much they do.

docs/model.md, (M251), (M252). Ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.layout import OF_POSE, POSE
from gridslam.inference.messages.amplitudes import detection_table
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.scans.anchor_measurements import AnchorScan, whole_of
from gridslam.inference.scans.deviations import own_deviations
from gridslam.inference.scans.leftovers import Leftovers
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives import blocks, tables
from gridslam.world.filter_model import FilterModel
from gridslam.world.radio import BINS, REFLECTION_BINS, RadioModel

CERTAIN = 5.0
"""Ratio to clutter from which on a birth needs no help, and known causes from which on it gets none."""
KNOWN = 0.5
"""Probability from which on a measurement counts as a known path's, or as what bore a surface."""
WIDEST = 1e3
"""Deviation that stands for "tells nothing"."""


def weigh_by_leftovers(
    births: Births, state: State, scan: AnchorScan, ratios: LikelihoodRatios, radio: RadioModel,
    model: FilterModel,
) -> tuple[Births, LikelihoodRatios]:  # fmt: skip
    """Births of single bounces weighed by what was left unexplained before, and the ratios with their sums.

    Parameters
    ----------
    radio : RadioModel
        As the radio seems to be.
    """
    left = state.leftovers
    if left is None or not len(left) or not len(births):
        return births, ratios
    explained = ratios.explained.tolist()
    few = zip(births.ratio.tolist(), births.measurement.tolist(), births.hit.max(1).tolist(), strict=True)
    rows = [  # one by one: at most steps none is left to ask whether it is whole
        row for row, (one, measurement, hit) in enumerate(few)
        if one < CERTAIN and explained[measurement] < CERTAIN and hit < 0 and scan.whole[measurement]
    ]  # fmt: skip
    if not rows:
        return births, ratios
    m, line = births.measurement.take(rows), births.line.take(rows, 0)
    gain, often = borne_out(line, scan, m, state, left, radio, model)
    if not gain.any():
        return births, ratios
    support, seen = np.ones((len(births), BINS)), np.zeros(len(births), np.int64)
    support[rows] += gain
    seen[rows] = often
    level = REFLECTION_BINS * radio.amplitude(scan.value[m, 0])[:, None]
    prior = np.exp(radio.log_rician(scan.amplitude[m, None], level))
    prior /= prior.sum(1, keepdims=True)
    ratio = births.ratio.copy()
    ratio[rows] *= (prior * support[rows]).sum(1)
    measured = ratios.measured.copy()
    np.add.at(measured[tables.NEW], m, ratio[rows] - births.ratio[rows])
    return replace(births, ratio=ratio, support=support, seen=seen), replace(ratios, measured=measured)


def borne_out(
    line: Array, scan: AnchorScan, m: NDArray[np.int32], state: State, left: Leftovers, radio: RadioModel,
    model: FilterModel,
) -> tuple[Array, NDArray[np.int64]]:  # fmt: skip
    """Likelihood of what was left over if a line has been there for some steps, over that if it hasn't.

    Misses alone tell nothing for a line and are left out.

    Parameters
    ----------
    line : (B, 2)
        Lines of single bounces.
    m : (B,) int32
        Which measurement each is born of.

    Returns
    -------
    (gain, seen)
        gain (B, BINS): by the line's coefficient; seen (B,): how often it was heard before.

    Raises
    ------
    ValueError
        A birth's measurement, or an anchor, doesn't exist.
    """
    if not (
        0 <= scan.anchor < len(model.places)
        and left.anchor.max(initial=-1) < len(model.places)
        and m.max(initial=-1) < len(scan)
    ):
        raise ValueError("births or leftovers name an anchor or measurement that doesn't exist")
    table, belief = detection_table(model.radio), state.belief
    gain, seen = np.empty((len(line), BINS)), np.empty(len(line), np.int64)
    _bearing()(
        scan.anchor, table.step, table.chance, blocks.Belief(belief.mean, belief.covariance),
        blocks.Anchors(model.places, radio.numbers), scan.table,
        blocks.Left(left.pose, left.covariance, left.begin, left.rows),
        blocks.Borne(line, m, gain, seen, np.empty((len(model.places) + 2, 2, BINS))),
    )  # fmt: skip
    return gain, seen


def remember_leftovers(
    state: State, scans: Sequence[AnchorScan], unclaimed_rows: NDArray[np.bool_], model: FilterModel, *,
    work: Workspace,
) -> State:  # fmt: skip
    """Keep what was probably no known path's, nor bore a surface, for later steps.

    Measurements that lack distance, an angle or the amplitude aren't kept.

    Parameters
    ----------
    unclaimed_rows : (M,) bool
        What is `unclaimed`.
    """
    if state.leftovers is None:
        return state
    own = work.once(own_deviations, scans, model.radio)
    whole, anchor, value, std, amplitude = work.once(_stated, scans, own)
    (rows,), belief = (whole & unclaimed_rows).nonzero(), state.belief
    leftovers = state.leftovers.joined(
        belief.mean[POSE], belief.covariance[OF_POSE], anchor[rows], value[rows], std[rows], amplitude[rows]
    )
    return replace(state, leftovers=leftovers)


def unclaimed(exchanges: Sequence[Exchange]) -> NDArray[np.bool_]:
    """Measurements (M,) of all anchors that were probably no known path's, nor bore a surface."""
    unclaimed_rows = np.concatenate([exchange.responsible.sum(0) for exchange in exchanges]) < KNOWN
    first = 0
    for exchange in exchanges:
        if len(exchange.born):
            unclaimed_rows[first + exchange.born[exchange.born[:, 1] > KNOWN, 0].astype(np.intp)] = False
        first += exchange.message.shape[2]
    return np.asarray(unclaimed_rows)


def _stated(
    scans: Sequence[AnchorScan], std: Array
) -> tuple[NDArray[np.bool_], NDArray[np.int64], Array, Array, Array]:
    """Of all measurements whether they lack nothing, anchor, value, deviations (M, 3) and amplitude."""
    scan, std = whole_of(scans), np.minimum(std, WIDEST)
    return scan.whole, scan.label.astype(np.int64, copy=False), scan.value, std, scan.amplitude


@runtime.once_started
def _bearing() -> Any:
    """The kernel that says how much leftovers bear births out."""
    from gridslam.kernels.management.faint_births import bear_out

    return bear_out
