"""The level of clutter, learned from quiet measurements by what known paths explain of them, and likelihood
ratios against it; docs/model.md, (M46)."""

from __future__ import annotations

from gridslam.arrays import replace
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.state.state import State
from gridslam.world.filter_model import FilterModel
from gridslam.world.radio import RadioModel


def learn_clutter(
    state: State, anchor: int, ratios: LikelihoodRatios, radio: RadioModel, model: FilterModel
) -> tuple[State, LikelihoodRatios, RadioModel]:
    """Take in how much clutter an anchor's scan holds, before its association; docs/model.md, (M46). Ours.

    Parameters
    ----------
    radio : RadioModel
        By which the ratios were evaluated.

    Returns
    -------
    (state, ratios, radio)
        With the level that is believed now.
    """
    calibration = state.calibration.with_clutter(anchor, ratios.clutter, model.radio)
    level = calibration.clutter_level(anchor, model.radio.false_alarms)
    if level != radio.false_alarms:
        ratios = ratios.against(level / radio.false_alarms)
        radio = replace(radio, false_alarms=level)
    return replace(state, calibration=calibration), ratios, radio
