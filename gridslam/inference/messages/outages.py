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
"""Share of steps at which a radio or its recorder begins to hear nothing, whatever is there."""
SUREST = 1 - 1e-7
"""Existence of a surface at most."""


def is_outage(exchanges: Sequence[Exchange], before: State) -> bool:
    """Whether nothing at all was heard, though paths were believed in that hardly go unheard together.

    That all of them were missed is then less likely than that nobody listened, and nobody does until
    something is heard: the place that motion alone leads to expects ever less; docs/model.md, (M580).

    Parameters
    ----------
    exchanges : sequence of Exchange
        Of all anchors at one step.
    before : State
        As predicted for it.
    """
    if _heard(exchanges):
        return False
    return before.monitor.off > 0 or _missed(exchanges) < math.log(OUTAGE)


def through_outage(predicted: State, model: FilterModel) -> State:
    """The state after a step at which nobody listened: as predicted, and surfaces don't fade meanwhile."""
    bank, monitor = predicted.surfaces, predicted.monitor
    existence = np.minimum(bank.existence / model.settings.survival, SUREST)
    return replace(
        predicted, surfaces=replace(bank, existence=existence), monitor=replace(monitor, off=monitor.off + 1)
    )


def log_evidence(exchanges: Sequence[Exchange], after: State) -> float | None:
    """Log evidence of a step at which nothing was heard: all was missed, or nobody listened; else None.

    Once nobody does, it is as it was to be: or whoever knows most paths would lose most by a silence.

    Parameters
    ----------
    after : State
        Which says whether nobody listened, and for how long.
    """
    if _heard(exchanges):
        return None
    return 0.0 if after.monitor.off > 1 else float(np.logaddexp(_missed(exchanges), math.log(OUTAGE)))


def _heard(exchanges: Sequence[Exchange]) -> bool:
    return any(exchange.message.shape[2] for exchange in exchanges)


def _missed(exchanges: Sequence[Exchange]) -> float:
    """Log probability that whatever paths are believed in were missed."""
    return sum(exchange.log_evidence for exchange in exchanges)
