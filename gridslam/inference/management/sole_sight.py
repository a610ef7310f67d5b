"""The only anchor in sight, where nothing tells a departure; docs/model.md, (M514).

Distances and arrivals of one anchor stay the same when agent and walls turn about it together. Anchors that
are hidden are heard over walls, and over which nobody can tell while the turn is open: what they seem to say
of it is mostly wrong. So they wait until the line of sight of one of them is heard.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.health.sight_watch import Sight
from gridslam.inference.management.free_turn import turn_followed, with_turn
from gridslam.inference.messages.motion import predict_agent
from gridslam.inference.state.anchor_measurements import own_deviations, split_by_anchor, whole_of
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.scan import Scan

AGREE = 4.0
"""Deviations within which a line of sight has the distance and the arrival that follow from the pose."""
AS_LOUD = 0.75
"""Of its loudness: few walls reflect as much."""


def as_far_as_told(
    population: Population[State], scan: Scan, model: FilterModel, work: Workspace
) -> tuple[Population[State], Scan]:
    """The population before a scan with the turn held out or put back, and what of the scan it may use.

    With distances alone nothing waits: a place that one anchor tells alone is a ring, and others are needed.
    Of the scan that tells the turn those are lines of sight: what else is heard of other anchors means
    something from the next one on, once the turn is known.
    """
    state, departs = population.best, bool(np.isfinite(scan.aod_rad).any())
    if model.senders == 1:
        return turn_followed(population, departs, model), scan
    held, arrives = state.turn_variance is not None, bool(np.isfinite(scan.aoa_rad).any())
    may_begin = arrives and not departs and not state.next_identity
    if population.searching or state.samples is not None or not (held or may_begin):
        return population, scan
    seen = anchors_in_sight(state, scan, model, work)
    if not held and seen.sum() != 1:
        return population, scan
    anchor = state.turn_anchor if held else int(seen.argmax())
    seen[anchor] = False
    rows = scan.anchor == anchor
    told = departs or bool(seen.any()) or not rows.any()
    if not departs and rows.any():
        for other in np.flatnonzero(seen):
            rows[_loudest(scan, other)] = True
        scan = scan.only(rows)
    return turn_followed(population, told, model, anchor), scan


def _loudest(scan: Scan, anchor: np.intp) -> NDArray[np.intp]:
    """The row of an anchor that is loudest, as lines of sight are; all where amplitudes aren't measured."""
    own = np.flatnonzero(scan.anchor == anchor)
    loudness = scan.amplitude[own]
    return own if np.isnan(loudness).all() else own[[np.nanargmax(loudness)]]


def anchors_in_sight(state: State, scan: Scan, model: FilterModel, work: Workspace) -> NDArray[np.bool_]:
    """Of which anchors a scan holds what may be the line of sight to the agent, (J,)."""
    scans = work.once(split_by_anchor, scan, model)
    belief = with_turn(state, model).belief
    if state.time_s is not None:
        belief = predict_agent(belief, scan.time_s - state.time_s, model.settings)
    whole = whole_of(scans)
    sight = Sight.of(
        scans, work.once(own_deviations, scans, model.radio), belief, state.calibration.turned, model
    )
    off, table = np.abs(sight.off) / sight.std, whole.table
    at_place = (off[:, 0] < AGREE) & ((off[:, 2] < AGREE) | ~(table[:, 5] >= 0))
    expected = state.calibration.tuned(model.radio, 0).amplitude(sight.length, 1.0)
    loud = ~(table[:, 6] > 0) | (table[:, 6] > AS_LOUD * expected)
    seen = np.zeros(model.senders, bool)
    seen[whole.label[at_place & loud & whole.loud]] = True
    return seen
