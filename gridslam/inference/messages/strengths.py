"""How far away an anchor is by how loud its line of sight is, where its clock doesn't tell; docs/model.md,
(M542). Ours.

Once clocks are known, distances tell it a hundred times better.
"""

from __future__ import annotations

import math

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.state import State
from gridslam.kernels import LIKELIER_THAN_NOT
from gridslam.kernels.primitives.tables import ANCHOR, BOUNCES
from gridslam.world.filter_model import FilterModel
from gridslam.world.radio import RadioModel

SYSTEMATIC = 0.12
"""Share of an amplitude by which the radio may not know itself, 1 dB."""
LOUD = 2.0
"""Times the threshold from which on detection doesn't bias an amplitude."""
SURPRISING = 3.0
"""Deviations beyond which something else must have weakened it."""
STRAIGHT = 0.5
"""Of the amplitude's deviation, what a length may be bent by how far the place may be off across: where no
direction tells, places lie on a ring, and a correction along one direction would choose one of them."""
LEAST_M = 1e-3
"""Length that slopes are taken at, at least."""


def correct_by_strengths(
    state: State, scan: AnchorScan, exchange: Exchange, radio: RadioModel, model: FilterModel,
    weakened: bool = False,
) -> State:  # fmt: skip
    """The belief corrected by lines of sight whose amplitude tells their length better than is known; (M542).

    Parameters
    ----------
    weakened : bool
        Lines of sight may be weaker than free space leaves them: amplitudes say how long they are at most.
    """
    if not state.belief.clocks or not len(scan):
        return state
    table, responsible = exchange.rays.table, exchange.responsible
    mean, covariance = state.belief.mean, state.belief.covariance
    for row in np.flatnonzero((table[:, BOUNCES] == 0) & (table[:, ANCHOR] < model.senders)):
        m = int(responsible[row].argmax())
        square = scan.amplitude[m] ** 2 * (1 - 0.25 / radio.samples) - 0.5  # without what noise adds
        faint = not square > (LOUD * radio.threshold) ** 2  # or not measured
        if faint or responsible[row, m] <= LIKELIER_THAN_NOT:
            continue
        heard_m = radio.amplitude_at_1m / math.sqrt(square)
        variance = heard_m**2 * (0.5 / square + 0.25 / radio.samples + SYSTEMATIC**2)
        x, y, _, height = model.places[table[row, ANCHOR], :4]
        away = mean[:2] - (x, y)
        length_m = max(math.sqrt(away @ away + height**2), LEAST_M)
        pushed = covariance[:, :2] @ away / length_m
        known = away @ pushed[:2] / length_m
        gap = heard_m - length_m
        across = covariance[0, 0] + covariance[1, 1] - known
        straight = (0.5 * across / length_m) ** 2 < STRAIGHT**2 * variance
        likely = gap**2 < SURPRISING**2 * (known + variance) and not (weakened and gap > 0)
        if variance < known and likely and straight:
            mean = mean + pushed * gap / (known + variance)
            covariance = covariance - np.outer(pushed, pushed) / (known + variance)
    if mean is state.belief.mean:
        return state
    return replace(state, belief=replace(state.belief, mean=mean, covariance=covariance))
