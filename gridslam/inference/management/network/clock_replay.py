"""The steps of a search for clocks are taken again once a clock is set; docs/model.md, section 13.

While an anchor's clock is open, its paths bear no surfaces, and some are taken for another anchor's over
walls that aren't there. Told the clock from the first step on, and then roughly the walls that come out,
they fall into place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.beliefs.belief import append
from gridslam.inference.management.step_info import comparable
from gridslam.inference.messages.network.clock_candidates import SURE_SURFACE
from gridslam.inference.messages.network.clock_setting import (
    loosened,
    tells_no_departure,
    witnessed_surfaces,
)
from gridslam.inference.state.network.belief import NetworkBelief
from gridslam.inference.state.network.clock_search import SET_VARIANCE
from gridslam.inference.state.network.state import ClockSteps, NetworkState
from gridslam.inference.state.surface_bank import FRESH_SINGLE
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan

Step = Callable[[NetworkState, NetworkScan, NetworkModel, Any], tuple[NetworkState, Any]]
MOST_STEPS = 40
"""That are taken again; of a longer search the latest, this many at most."""
WALL_M, WALL_RAD, WALL_SEEN = 0.3, np.radians(3.0), 3
"""Deviations within which walls are told, far wider than they are known by then; how often they were seen."""


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
    unlabelled = not state.labelled and state.clocks.anchors > 1 and not state.clocks.framed
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
    """A search's steps once more, with clocks that are set after them set from the first, about their modes.

    And once more with the surfaces that come out, of which births of other labels are none then.

    Returns
    -------
    (state, info, steps) or None
        State and info of the last. None where what was heard is less likely so, or a clock didn't stay set.
    """
    walked = model.clocks.walk_m**2 * (steps.scans[-1].time_s - steps.scans[0].time_s)
    start, clocks = with_clocks_of(after, steps.before, SET_VARIANCE + walked), after.clocks
    state, info, total = _from(start, steps.scans, model, works, step)
    if (state.clocks.unset & ~clocks.unset).any() or total < steps.log_evidence:
        return None
    given = with_walls_of(state, start)
    if len(given.surfaces) > len(start.surfaces):
        mapped, mapped_info, explained = _from(given, steps.scans, model, works, step)
        if (mapped.clocks.unset == state.clocks.unset).all() and explained >= total:
            # walls that are told say nothing of clocks that are still searched for
            state, info = loosened(replace(mapped, clocks=state.clocks)), mapped_info
    return state, info, ClockSteps(start, steps.scans, total)


def _from(
    state: NetworkState,
    scans: Sequence[NetworkScan],
    model: NetworkModel,
    works: Sequence[Workspace],
    step: Step,
) -> tuple[NetworkState, Any, float]:
    """State and info after some steps, and the log evidence of all."""
    info, total = None, 0.0
    for scan in scans:
        state, info = step(state, scan, model, works)
        total += evidence(state, info, model)
    return state, info, total


def with_walls_of(after: NetworkState, before: NetworkState) -> NetworkState:
    """The state of before with the new surfaces of after that two links hear, each roughly where it is."""
    bank, lines = after.surfaces, after.belief.lines
    new = (bank.identity >= before.next_identity) & (bank.existence > SURE_SURFACE)
    surfaces, belief, count = before.surfaces, before.belief, len(before.surfaces)
    rows = np.flatnonzero(new & witnessed_surfaces(after)).tolist()
    for number, row in enumerate(rows):
        foot = float(bank.foot[row])
        surfaces = surfaces.add(
            before.next_identity + number, float(bank.existence[row]), bank.reflection[row], foot,
            (0, -1, -1), seen=WALL_SEEN,
        )  # fmt: skip
        tilted = WALL_RAD**2 * np.array([[1.0, foot], [foot, foot**2]])
        belief = cast(NetworkBelief, append(belief, lines[row], tilted + np.diag([0.0, WALL_M**2])))
    single = surfaces.single.copy()
    single[:, count:] = FRESH_SINGLE
    return replace(
        before, surfaces=replace(surfaces, single=single), belief=belief,
        next_identity=before.next_identity + len(rows),
    )  # fmt: skip


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
