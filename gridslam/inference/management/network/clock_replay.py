"""The steps of a search for clocks are taken again once a clock is set; docs/model.md, section 13.

While an anchor's clock is open, its paths bear no surfaces, and some are taken for another anchor's over
walls that aren't there. Told the clock from the first step on, they fall into place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.management.hypotheses import comparable
from gridslam.inference.messages.network.clock_setting import tells_no_departure
from gridslam.inference.state.network.clock_search import SET_VARIANCE
from gridslam.inference.state.network.state import ClockSteps, NetworkState
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan

Step = Callable[[NetworkState, NetworkScan, NetworkModel, Any], tuple[NetworkState, Any]]
MOST_STEPS = 40
"""That are taken again; of a longer search the latest, this many at most."""


def stepped(
    before: NetworkState, scan: NetworkScan, model: NetworkModel, works: Sequence[Workspace], step: Step
) -> tuple[NetworkState, Any]:
    """One step of one hypothesis, and all since its clocks were searched for again if one was set by it.

    Parameters
    ----------
    step : callable
        The system's, of one state.
    """
    after, info = step(before, scan, model, works)
    if not (before.clocks.unset.any() and mistakable(after, scan)):
        return after if after.search is None else replace(after, search=None), info
    steps = _with_this(before, scan, evidence(after, info, model))
    if len(steps.scans) > 1 and (before.clocks.unset & ~after.clocks.unset).any():
        again = taken_again(steps, after, model, works, step)
        if again is not None:
            after, info, steps = again
    return replace(after, search=steps if after.clocks.unset.any() else None), info


def mistakable(state: NetworkState, scan: NetworkScan) -> bool:
    """Whether an anchor's paths may be taken for another's, and one more set clock tells which are whose.

    Where departures aren't measured, rival modes are kept instead; of clocks with rates, nobody knows where
    they were some steps ago.
    """
    unlabelled = not state.labelled and len(state.clocks.unset) > 1
    return unlabelled and not state.belief.rates and not tells_no_departure(scan.scans)


def _with_this(before: NetworkState, scan: NetworkScan, log_evidence: float) -> ClockSteps:
    """The steps of the search with this one."""
    steps = before.search
    if steps is None or len(steps.scans) >= MOST_STEPS:
        steps = ClockSteps(replace(before, search=None), (), 0.0)
    return ClockSteps(steps.before, (*steps.scans, scan), steps.log_evidence + log_evidence)


def taken_again(
    steps: ClockSteps, after: NetworkState, model: NetworkModel, works: Sequence[Workspace], step: Step
) -> tuple[NetworkState, Any, ClockSteps] | None:
    """The same steps with the clocks that are set after them set from the first on, each about its mode.

    Returns
    -------
    (state, info, steps) or None
        State and info of the last. None where what was heard is less likely so, or a clock didn't stay set.
    """
    walked = model.clocks.walk_m**2 * (steps.scans[-1].time_s - steps.scans[0].time_s)
    state = start = with_clocks_of(after, steps.before, SET_VARIANCE + walked)
    info, total = None, 0.0
    for scan in steps.scans:
        state, info = step(state, scan, model, works)
        total += evidence(state, info, model)
    if (state.clocks.unset & ~after.clocks.unset).any() or total < steps.log_evidence:
        return None
    return state, info, ClockSteps(start, steps.scans, total)


def with_clocks_of(after: NetworkState, before: NetworkState, variance: float) -> NetworkState:
    """The state of before with its open clocks as they are believed after, if they are set there.

    Parameters
    ----------
    variance : float
        Of each, m^2: the mode is told, and no more.
    """
    belief, clocks, own = before.belief, before.clocks, after.belief.layout.devices
    for anchor in np.flatnonzero(before.clocks.unset & ~after.clocks.unset).tolist():
        entry, offset = int(belief.layout.devices[anchor]), float(after.belief.mean[own[anchor]])
        belief, clocks = belief.independent(entry, offset, variance), clocks.closed(anchor)
    return replace(before, belief=belief, clocks=clocks)


def evidence(state: NetworkState, info: Any, model: NetworkModel) -> float:
    """Log evidence of a step, of what all agents heard."""
    parts = zip(range(len(model.agents)), info.agents, model.agents, strict=True)
    return sum(comparable(own, state.part(agent), one) for agent, own, one in parts if own is not None)
