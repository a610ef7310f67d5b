"""The level of clutter, learned from quiet measurements by what known paths explain of them, and likelihood
ratios against it; docs/model.md, (M46), (M579)."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.state import State
from gridslam.world.filter_model import FilterModel
from gridslam.world.radio import RadioModel

SILENT_WEIGHT = 0.1
"""Steps of listening that a scan without amplitudes is worth."""


def learn_clutter(
    state: State, scan: AnchorScan, ratios: LikelihoodRatios, radio: RadioModel, model: FilterModel
) -> tuple[State, LikelihoodRatios, RadioModel]:
    """Take in how much clutter an anchor's scan holds, before its association; docs/model.md, (M46). Ours.

    Parameters
    ----------
    scan : AnchorScan
        What the ratios are of.
    radio : RadioModel
        By which the ratios were evaluated.

    Returns
    -------
    (state, ratios, radio)
        With the level that is believed now.
    """
    weight = told_of_clutter(scan)
    calibration = state.calibration.with_clutter(scan.anchor, ratios.clutter, model.radio, weight)
    level = calibration.clutter_level(scan.anchor, model.radio.false_alarms)
    if level != radio.false_alarms:
        ratios = ratios.against(level / radio.false_alarms)
        radio = replace(radio, false_alarms=level)
    return replace(state, calibration=calibration), ratios, radio


def told_of_clutter(scan: AnchorScan) -> float:
    """How many steps of listening a scan is worth: the share of it that has amplitudes, (M579).

    Where none says so, paths of walls that are still to be born are as quiet as clutter. Taken for it at full
    weight, they would never be born.
    """
    if not len(scan):
        return 1.0
    return max(1 - float(np.isnan(scan.amplitude).mean()), SILENT_WEIGHT)
