"""Steps at which a radio was off: nothing is heard of anything, so that nothing was missed. Ours."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.state import State
from gridslam.world.filter_model import FilterModel

OUTAGE = 1e-3
"""Share of steps at which a radio or its recorder hears nothing whatever is there."""
SUREST = 1 - 1e-7
"""Existence of a surface at most."""


def is_outage(exchanges: Sequence[Exchange]) -> bool:
    """Whether nothing at all was heard, though paths were believed in that hardly go unheard together.

    That all of them were missed is then less likely than that nobody listened; docs/model.md, (M580).

    Parameters
    ----------
    exchanges : sequence of Exchange
        Of all anchors at one step.
    """
    if any(exchange.message.shape[2] for exchange in exchanges):
        return False
    return sum(exchange.log_evidence for exchange in exchanges) < math.log(OUTAGE)


def through_outage(predicted: State, model: FilterModel) -> State:
    """The state after a step at which nobody listened: as predicted, and surfaces don't fade meanwhile."""
    bank = predicted.surfaces
    existence = np.minimum(bank.existence / model.settings.survival, SUREST)
    return replace(predicted, surfaces=replace(bank, existence=existence))
